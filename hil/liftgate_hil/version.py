"""Versions of the installed packages; all other modules take them from here."""

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
    """Return the version in a package's metadata; "unknown" for a package that is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return UNKNOWN


def versions() -> dict[str, str]:
    """Return the versions of this package, Python and `PACKAGES` by name."""
    return {
        "liftgate-hil": version(),
        "python": platform.python_version(),
        **{name: version(name) for name in PACKAGES},
    }
