"""The versions of the installed packages; the one place that looks them up."""

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
)  # a run rests on


@functools.cache
def version(package: str = "liftgate-hil") -> str:
    """The version in an installed package's metadata; "unknown" for what was never installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return UNKNOWN


def versions() -> dict[str, str]:
    """By name: this package's, Python's, and those of `PACKAGES`."""
    return {
        "liftgate-hil": version(),
        "python": platform.python_version(),
        **{name: version(name) for name in PACKAGES},
    }
