"""The version of the installed package; the one place that looks it up."""

from __future__ import annotations

import functools


@functools.cache
def version() -> str:
    """The version in the installed package's metadata; "unknown" for sources that were never installed."""
    from importlib import metadata

    try:
        return metadata.version("liftgate-hil")
    except metadata.PackageNotFoundError:
        return "unknown"
