"""Versions of the installed packages, for all other modules."""

from __future__ import annotations

import functools
import platform
from importlib import metadata

UNKNOWN = "unknown"
PACKAGES = (
    "numba",
    "llvmlite",
    "numpy",
    "scipy",
    "python-can",
    "cantools",
    "pyserial",
)  # packages that a run needs


@functools.cache
def version(package: str = "liftgate-hil") -> str:
    """Return the version of an installed package; "unknown" if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return UNKNOWN


def versions() -> dict[str, str]:
    """Return the versions of this package, of Python and of `PACKAGES`, by name."""
    return {
        "liftgate-hil": version(),
        "python": platform.python_version(),
        **{name: version(name) for name in PACKAGES},
    }
