"""Storage of machine code: a folder for each entry point, with a file for each combination of argument kinds.

Beside these are the durations of the last compilations, so that a wait can be announced in advance.

Nothing that another user could have written is read, since it would be executed.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from liftgate_compiler.files import lock, remove_leftovers, write_whole
from liftgate_compiler.kinds import Kind, from_plain, plain

SUFFIX = ".code"
_DIGEST_BYTES = hashlib.sha256().digest_size
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


class NotOursError(OSError):
    """Raised for a file or folder that other users could have written to."""


class Stored(NamedTuple):
    """Content of a stored file: machine code, and the kind of its result."""

    code: bytes
    result: Kind


def root() -> Path:
    """Return the folder with all stored machine code of this user."""
    return Path(os.environ.get("XDG_CACHE_HOME") or _home() / ".cache") / "liftgate-hil"


def _home() -> Path:
    """Return the user's home folder; /dev/null where there is none."""
    try:
        return Path.home()
    except RuntimeError:  # a user without a home, as in containers: nothing can be stored
        return Path(os.devnull)


def path_of(folder: Path, kinds: str) -> Path:
    """Return the path of the stored file for arguments of these kinds."""
    return folder / (hashlib.sha256(kinds.encode()).hexdigest()[:16] + SUFFIX)


def read(path: Path) -> Stored | None:
    """Return the content of a stored file; None if no complete file exists. Raises OSError, incl. NotOursError."""
    try:
        check_ours(path.parent.parent)
        check_ours(path.parent)
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return None
    with os.fdopen(descriptor, "rb") as stream:
        _check(os.fstat(descriptor), path)
        content = stream.read()
    digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if _digest_of(path, content) != digest:
        return None
    head, _, code = content.partition(b"\n")
    with contextlib.suppress(ValueError, LookupError, ImportError, AttributeError):
        return Stored(code, from_plain(json.loads(head)))
    return None


def keep(path: Path, stored: Stored) -> None:
    """Store machine code and the kind of its result in a file atomically. Raises OSError."""
    content = json.dumps(plain(stored.result)).encode() + b"\n" + stored.code
    write_whole(path, _digest_of(path, content) + content, mode=0o600)
    remove_leftovers(path.parent)


def _digest_of(path: Path, content: bytes) -> bytes:
    """Return a digest of a stored file's path and content.

    The path is included because code of another entry point would be called with arguments it does not take.
    """
    return hashlib.sha256(f"{path.parent.name}/{path.name}\n".encode() + content).digest()


def check_ours(folder: Path) -> None:
    """Check that other users cannot write to a folder. Raises NotOursError, FileNotFoundError."""
    _check(folder.stat(), folder)


def _check(status: os.stat_result, path: Path) -> None:
    """Raise NotOursError if the file or folder with this status belongs to others, or they may write to it."""
    if status.st_uid != os.geteuid():
        raise NotOursError(f"{path} belongs to another user")
    if status.st_mode & _OTHERS_WRITE:
        raise NotOursError(f"others may write to {path}")


@contextlib.contextmanager
def turn(folder: Path) -> Iterator[Turn]:
    """Context with the Turn of an entry point's folder, by which one process at a time compiles. Raises OSError.

    Other processes wait, and read what that process has stored.
    """
    root().mkdir(parents=True, exist_ok=True, mode=0o700)
    folder.mkdir(exist_ok=True, mode=0o700)
    check_ours(folder.parent)
    check_ours(folder)
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
    descriptor = os.open(folder / "lock", flags, 0o600)
    try:
        yield Turn(descriptor)
    finally:
        os.close(descriptor)


class Turn:
    """Lock by which processes take turns in compiling."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def taken(self) -> bool:
        """Return whether this process holds the lock, after trying to take it.

        On a file system without locks the result is always true: several processes may then compile the same.
        """
        try:
            lock(self._descriptor)
        except BlockingIOError:
            return False
        return True


_DURATIONS = "durations.json"
_LONGEST_S = 24 * 3600.0  # s; longer values are ignored as implausible


def expected_s(name: str) -> float | None:
    """Return how long compiling an entry point took the last time [s]; None: unknown."""
    value = _durations().get(name)
    return value if value is not None and 0.0 < value < _LONGEST_S else None


def note_duration(name: str, seconds: float) -> None:
    """Store how long compiling the entry point `name` took [s]; failures to store are ignored."""
    found = {**_durations(), name: round(seconds, 1)}
    with contextlib.suppress(OSError):
        check_ours(root())
        write_whole(root() / _DURATIONS, json.dumps(found).encode(), mode=0o600)


def _durations() -> dict[str, float]:
    """Return the durations [s] of the last compilations by entry point; {}: none, or not readable."""
    try:
        found = json.loads((root() / _DURATIONS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    if not isinstance(found, dict):
        return {}
    return {
        str(name): float(value)
        for name, value in found.items()
        if isinstance(value, int | float) and math.isfinite(value)
    }
