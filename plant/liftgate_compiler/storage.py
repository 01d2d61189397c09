"""Machine code on disk: a file for each entry point and kinds of its arguments, in the entry point's own folder.

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
    """Raised where other users could have written to a file or folder."""


class Stored(NamedTuple):
    """Contents of a file: machine code, and the kind of its result."""

    code: bytes
    result: Kind


def root() -> Path:
    """Return the folder in which machine code of this user is stored."""
    return Path(os.environ.get("XDG_CACHE_HOME") or _home() / ".cache") / "liftgate-hil"


def _home() -> Path:
    try:
        return Path.home()
    except RuntimeError:  # a user without a home, as in containers: nothing can be stored
        return Path(os.devnull)


def path_of(folder: Path, kinds: str) -> Path:
    """Return the file for arguments of these kinds."""
    return folder / (hashlib.sha256(kinds.encode()).hexdigest()[:16] + SUFFIX)


def read(path: Path) -> Stored | None:
    """Return the stored contents; None where no complete file exists. Raises OSError, including NotOursError."""
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
    """Store machine code and the kind of its result in a file, completely or not at all. Raises OSError."""
    content = json.dumps(plain(stored.result)).encode() + b"\n" + stored.code
    write_whole(path, _digest_of(path, content) + content, mode=0o600)
    remove_leftovers(path.parent)


def _digest_of(path: Path, content: bytes) -> bytes:
    """Return a digest of path and content.

    The path is included because code of another entry point would be called with arguments it does not take.
    """
    return hashlib.sha256(f"{path.parent.name}/{path.name}\n".encode() + content).digest()


def check_ours(folder: Path) -> None:
    """Check that other users cannot write to a folder. Raises NotOursError, FileNotFoundError."""
    _check(folder.stat(), folder)


def _check(status: os.stat_result, path: Path) -> None:
    if status.st_uid != os.geteuid():
        raise NotOursError(f"{path} belongs to another user")
    if status.st_mode & _OTHERS_WRITE:
        raise NotOursError(f"others may write to {path}")


@contextlib.contextmanager
def turn(folder: Path) -> Iterator[Turn]:
    """Provide a lock with which one process at a time compiles. Raises OSError.

    Others wait, and read what it has stored.
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
    """Lock that gives a process its turn to compile."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def taken(self) -> bool:
        """Whether it is this process's turn now; takes the lock if it is free.

        On a file system without locks it always is: several processes may then compile the same.
        """
        try:
            lock(self._descriptor)
        except BlockingIOError:
            return False
        return True


_DURATIONS = "durations.json"
_LONGEST_S = 24 * 3600.0  # s; longer values are ignored as implausible


def expected_s(name: str) -> float | None:
    """Return how long an entry point took to compile the last time [s]; None: unknown."""
    value = _durations().get(name)
    return value if value is not None and 0.0 < value < _LONGEST_S else None


def note_duration(name: str, seconds: float) -> None:
    """Store how long the entry point `name` took to compile [s]; a failure to store it is ignored."""
    found = {**_durations(), name: round(seconds, 1)}
    with contextlib.suppress(OSError):
        check_ours(root())
        write_whole(root() / _DURATIONS, json.dumps(found).encode(), mode=0o600)


def _durations() -> dict[str, float]:
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
