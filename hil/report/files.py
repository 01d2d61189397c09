"""Where reports go: looked at before the long computation, written after it."""

from __future__ import annotations

import os
from pathlib import Path

from hil.errors import ConfigError


def check_target(path: str, flag: str) -> None:
    """Raise ConfigError where `flag` names a file that could not be written."""
    target = Path(path)
    if "\0" in path:
        raise ConfigError(f"{flag} {path!r}: allowed: a name without a NUL")
    try:
        if not path or target.is_dir():
            raise ConfigError(f"{flag} {path}: is a folder; allowed: the name of a file")
        if not target.parent.is_dir():
            raise ConfigError(f"{flag} {path}: no folder {target.parent}; allowed: one that exists")
        exists = target.exists()
    except OSError as error:  # a name too long
        raise ConfigError(f"{flag} {path}: {error.strerror}") from error
    if not os.access(target if exists else target.parent, os.W_OK):
        what = "it" if exists else f"folder {target.parent}"
        raise ConfigError(f"{flag} {path}: no permission to write {what}")


def write_report(path: str, flag: str, text: str) -> None:
    """Write a text file; raise ConfigError where that fails."""
    try:
        Path(path).write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise ConfigError(f"{flag} {path}: cannot be written: {error.strerror}") from error
