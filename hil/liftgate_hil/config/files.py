"""Read files that a user names, and report errors in doing so."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from liftgate_hil.errors import ConfigError

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def issue_with(path: Path) -> str:
    """Return as text why a path is no readable file, the end of a message; "" if it is one.

    Opens nothing, as opening a pipe would block.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return "a link to no file; allowed: a file" if path.is_symlink() else "no such file"
    except OSError as error:  # e.g. no permission for a folder above it, a loop of links, a name too long
        return f"cannot be read: {error.strerror}"
    except ValueError:  # a null character, or others that no file name can hold
        return "no such file"
    kind = next((words for is_kind, words in _KINDS if is_kind(mode)), "")
    if kind:
        return f"is {kind}; allowed: a file"
    return "" if os.access(path, os.R_OK) else "cannot be read: Permission denied"


def is_there(path: Path) -> bool:
    """Whether a path exists, even if it cannot be read."""
    return issue_with(path) != "no such file"


def check_file(path: Path, called: str = "") -> None:
    """Raise ConfigError if a path is no readable file; messages call it `called`, else by its path."""
    issue = issue_with(path)
    if issue:
        raise ConfigError(f"{called or path}: {issue}")


def read_bytes(path: Path, most: int | None = None, called: str = "") -> bytes:
    """Return the bytes of a file; `called` as in `check_file`. Raises ConfigError, also for more than `most`."""
    check_file(path, called)
    try:
        size = path.stat().st_size
        if most is not None and size > most:
            raise ConfigError(f"{called or path}: {size} bytes; allowed: up to {most}")
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{called or path}: cannot be read: {error.strerror}") from error
