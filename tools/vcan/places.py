"""Locations of programs: installed, or unpacked without root into a folder of our own."""

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

_ADMIN_FOLDERS = ("/usr/sbin", "/sbin")


def unpacked_root() -> Path:
    """Return the folder for packages that could only be unpacked, not installed."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "liftgate-hil" / "machines"


def search_path(path: str) -> str:
    """Return a PATH that ends with the folders of `ip` and of unpacked programs."""
    root = unpacked_root()
    ours = [root / folder for folder in ("usr/bin", "bin", "usr/sbin", "sbin")]
    more = [*_ADMIN_FOLDERS, *(str(folder) for folder in ours if folder.is_dir())]
    return ":".join([path or "/usr/bin:/bin", *more])


def environment(base: Mapping[str, str]) -> dict[str, str]:
    """Return the command's environment: the caller's, extended to find unpacked programs and libraries."""
    found = {**base, "PATH": search_path(base.get("PATH", ""))}
    libraries = [str(folder) for folder in sorted(unpacked_root().glob("usr/lib/*-linux-gnu*"))]
    libraries += [str(folder) for folder in sorted(unpacked_root().glob("lib/*-linux-gnu*"))]
    if libraries:
        earlier = [base["LD_LIBRARY_PATH"]] if base.get("LD_LIBRARY_PATH") else []
        found["LD_LIBRARY_PATH"] = ":".join([*earlier, *libraries])
    return found


def find_program(name: str) -> str | None:
    """Return the path of a program, None if it is not found."""
    return shutil.which(name, path=search_path(os.environ.get("PATH", "")))
