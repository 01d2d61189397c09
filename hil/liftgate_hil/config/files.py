"""Files that a user names: what is wrong with one that cannot be read."""

from __future__ import annotations

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
        return "no such file"
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    except ValueError:  # a null character
        return "no such file"
    return next((f"is {kind}; allowed: a file" for is_kind, kind in _KINDS if is_kind(mode)), "")


def is_there(path: Path) -> bool:
    """Whether there is anything of that name, even what cannot be read."""
    return issue_with(path) != "no such file"


def read_bytes(path: Path, most: int | None = None) -> bytes:
    """A file's content, of up to `most` bytes. Raises ConfigError."""
    issue = issue_with(path)
    if issue:
        raise ConfigError(f"{path}: {issue}")
    try:
        size = path.stat().st_size
        if most is not None and size > most:
            raise ConfigError(f"{path}: {size} bytes; allowed: up to {most}")
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error


def write_text(path: Path, text: str) -> None:
    """A new file. Raises ConfigError."""
    try:
        with path.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
