"""Files that a user names: what is wrong with one that cannot be read."""

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
    """Why this is no file to read, as a message's end; "" where it is one. Opens nothing: a pipe would wait."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return "a link to no file; allowed: a file" if path.is_symlink() else "no such file"
    except OSError as error:  # no permission on the way, a loop of links, a name too long
        return f"cannot be read: {error.strerror}"
    except ValueError:  # a null character, or what no file's name can hold
        return "no such file"
    kind = next((said for is_kind, said in _KINDS if is_kind(mode)), "")
    if kind:
        return f"is {kind}; allowed: a file"
    return "" if os.access(path, os.R_OK) else "cannot be read: Permission denied"


def is_there(path: Path) -> bool:
    """Whether there is anything of that name, even what cannot be read."""
    return issue_with(path) != "no such file"


def check_file(path: Path, called: str = "") -> None:
    """Raise ConfigError where this is no file to read; `called` is what messages call it, else its name."""
    issue = issue_with(path)
    if issue:
        raise ConfigError(f"{called or path}: {issue}")


def read_bytes(path: Path, most: int | None = None, called: str = "") -> bytes:
    """A file's content, of up to `most` bytes; `called` see `check_file`. Raises ConfigError."""
    check_file(path, called)
    try:
        size = path.stat().st_size
        if most is not None and size > most:
            raise ConfigError(f"{called or path}: {size} bytes; allowed: up to {most}")
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{called or path}: cannot be read: {error.strerror}") from error


def write_text(path: Path, text: str) -> None:
    """A new file. Raises ConfigError."""
    try:
        with path.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
