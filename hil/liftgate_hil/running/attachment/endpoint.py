"""Sockets through which clients attach to a user's runs: one per run, named after the process id."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import orjson

from liftgate_hil.errors import ConfigError

SUFFIX = ".socket"
LONGEST = 1_000_000  # bytes of a message, either way
_PATIENCE_S = 1.0
_HEAD = struct.Struct("<I")  # header of a message: its length


def folder() -> Path:
    """Return the folder of the sockets, which no other user can read; create it if needed. Raises ConfigError."""
    given = os.environ.get("XDG_RUNTIME_DIR")
    path = Path(given) / "liftgate-hil" if given else _in_temporary()
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.lstat()
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; allowed: a folder that you own (XDG_RUNTIME_DIR)") from error
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise ConfigError(
            f"{path}: not a private folder of yours; allowed: a folder that you own (XDG_RUNTIME_DIR), mode 700"
        )
    return path


def _in_temporary() -> Path:
    return Path(tempfile.gettempdir()) / f"liftgate-hil-{os.getuid()}"


def path_of(pid: int) -> Path:
    """Return the socket of a run. Raises ConfigError."""
    return folder() / f"{pid}{SUFFIX}"


def sockets() -> dict[int, int]:
    """Return the ids of the processes with a socket, in rising order, and when each was made [ns since 1970].

    A run that was killed leaves its socket. Raises ConfigError.
    """
    found = {}
    for path in folder().glob(f"*{SUFFIX}"):
        with contextlib.suppress(FileNotFoundError):
            if path.stem.isdecimal():
                found[int(path.stem)] = path.lstat().st_ctime_ns
    return dict(sorted(found.items()))


def runs() -> list[int]:
    """Return the ids of the processes whose runs clients can attach to, in rising order. Raises ConfigError."""
    return [pid for pid in sockets() if _is_heard(pid)]


def _is_heard(pid: int) -> bool:
    """Whether a run listens on its socket; a socket that a killed run has left is removed."""
    try:
        connected(pid).close()
    except OSError:
        if not Path(f"/proc/{pid}").exists():
            path_of(pid).unlink(missing_ok=True)
        return False
    return True


@contextlib.contextmanager
def _address(pid: int) -> Iterator[str]:
    """Context with a short path of a run's socket: a socket's address holds only 107 bytes."""
    there = os.open(folder(), os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{there}/{pid}{SUFFIX}"
    finally:
        os.close(there)


def connected(pid: int) -> socket.socket:
    """Return a connection to a run. Raises OSError."""
    wire = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        wire.settimeout(_PATIENCE_S)  # a run that stands still accepts no connection
        with _address(pid) as address:
            wire.connect(address)
    except BaseException:
        wire.close()
        raise
    return wire


@contextlib.contextmanager
def listening(pid: int) -> Iterator[socket.socket]:
    """Context with a socket that accepts connections to this run. Raises OSError, ConfigError."""
    path = path_of(pid)
    with contextlib.suppress(FileNotFoundError):  # left by a process that had this id before
        path.unlink()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as wire:
        with _address(pid) as address:
            wire.bind(address)
        wire.listen(8)
        try:
            yield wire
        finally:
            with contextlib.suppress(OSError):
                path.unlink()


def packed(message: Any) -> bytes:
    """Return the bytes of a message: its length in four bytes, then the message as JSON.

    Raises ConfigError where it is longer than LONGEST, nested too deeply, or nothing that JSON can represent.
    """
    try:
        text = orjson.dumps(message)
    except TypeError as error:
        raise ConfigError(f"{error}; allowed: values that JSON can represent") from error
    if len(text) > LONGEST:
        raise ConfigError(f"{len(text)} bytes; allowed: up to {LONGEST}")
    return _HEAD.pack(len(text)) + text


class Arrivals:
    """Buffer of the bytes received on a connection, which splits them into messages, see `packed`."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def take(self, come: bytes) -> list[Any]:
        """Add bytes, and return the messages that are complete.

        Raises ValueError for one that is not JSON, or too long.
        """
        self._bytes += come
        found = []
        while len(self._bytes) >= _HEAD.size:
            (length,) = _HEAD.unpack_from(self._bytes)
            if length > LONGEST:
                raise ValueError(f"{length} bytes")
            end = _HEAD.size + length
            if len(self._bytes) < end:
                break
            found.append(orjson.loads(self._bytes[_HEAD.size : end]))
            del self._bytes[:end]
        return found
