"""Files that are read: what keeps one from it is told truly, whoever asks and whatever its name is."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from liftgate_hil.errors import ConfigError

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def fault_of(path: Path) -> str:
    """What keeps a file from being read, and what is allowed; "" where nothing does. Nothing is opened, so that no
    FIFO holds anybody up.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return "a link to no file; allowed: a file" if path.is_symlink() else "no such file"
    except OSError as error:  # no permission on the way, a loop of links, a name too long
        return f"cannot be read: {error.strerror}"
    except ValueError as error:  # a NUL, or what is no text
        return f"no name of a file: {error}"
    kind = next((said for is_such, said in _KINDS if is_such(mode)), "")
    if kind:
        return f"is {kind}; allowed: a file"
    return "" if os.access(path, os.R_OK) else "cannot be read: Permission denied"


def check_input(path: Path, called: str = "") -> None:
    """Raise ConfigError where a file could not be read; `called` is what messages call it, else its name."""
    fault = fault_of(path)
    if fault:
        raise ConfigError(f"{called or path}: {fault}")


def read_input(path: Path, called: str = "") -> bytes:
    """All of a file. Raises ConfigError, see `check_input`."""
    check_input(path, called)
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{called or path}: cannot be read: {error.strerror}") from error
