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
_NAME = "liftgate-hil"  # of the folder
_RUNTIME = "/run/user/{}"  # of a user, made at login (pam_systemd(8))
_ELSEWHERE = "allowed: with XDG_RUNTIME_DIR, a folder of yours with mode 700 (for the run and for what attaches)"
_HEAD = struct.Struct("<I")  # header of a message: its length


def _places() -> list[Path]:
    """Return the folders for a user's sockets, with or without XDG_RUNTIME_DIR; runs take the first usable one."""
    given, own, runtime = os.environ.get("XDG_RUNTIME_DIR"), os.getuid(), Path(_RUNTIME.format(os.getuid()))
    found = [Path(given) / _NAME] if given and not _is_foreign(Path(given)) else []
    found += [runtime / _NAME] if not _objection(runtime) else []
    return list(dict.fromkeys([*found, Path(tempfile.gettempdir()) / f"{_NAME}-{own}"]))


def _is_foreign(path: Path) -> bool:
    """Whether a folder belongs to another user, as XDG_RUNTIME_DIR does after `sudo` or `su`."""
    try:
        return path.stat().st_uid != os.getuid()
    except OSError:
        return False


def _objection(path: Path) -> str:
    """Return why a folder cannot hold sockets, and the remedy; "": it is private, and this user's."""
    try:
        found = path.lstat()
    except OSError as error:
        return f"{path}: {error.strerror}; {_ELSEWHERE}"
    if not stat.S_ISDIR(found.st_mode):
        return f"{path}: not a folder; allowed: after it is removed, or {_ELSEWHERE.removeprefix('allowed: ')}"
    if found.st_uid != os.getuid():
        return f"{path}: not yours, it belongs to user {found.st_uid}; {_ELSEWHERE}"
    if found.st_mode & 0o077:
        return f"{path}: not private (mode {stat.S_IMODE(found.st_mode):o}); allowed after: chmod 700 {path}"
    return ""


def folder() -> Path:
    """Create, where missing, and return the private folder in which runs listen. Raises ConfigError."""
    issues = []
    for path in _places():
        with contextlib.suppress(OSError):  # the folder is looked at in any case
            path.mkdir(mode=0o700, parents=True, exist_ok=True)
        issue = _objection(path)
        if not issue:
            return path
        issues.append(issue)
    raise ConfigError("; ".join(issues))


def _folders() -> list[Path]:
    """Return the usable ones of the folders for this user's sockets."""
    return [path for path in _places() if not _objection(path)]


def unusable() -> str:
    """Return in parentheses why existing folders for this user's sockets are not usable; "": all are usable."""
    issues = [_objection(path) for path in _places() if os.path.lexists(path)]
    return f" ({'; '.join(filter(None, issues))})" if any(issues) else ""


def path_of(pid: int) -> Path:
    """Return the path of the socket of the run in process `pid`. Raises ConfigError."""
    return folder() / f"{pid}{SUFFIX}"


def sockets() -> dict[int, int]:
    """Return each socket's creation time [ns] by process id, sorted by id; killed runs leave their socket."""
    found: dict[int, int] = {}
    for place in _folders():
        with contextlib.suppress(OSError), os.scandir(place) as entries:
            for each in entries:
                stem = each.name.removesuffix(SUFFIX)
                if stem == each.name or not stem.isdecimal():
                    continue
                with contextlib.suppress(FileNotFoundError):
                    made_ns = each.stat(follow_symlinks=False).st_ctime_ns
                    found[int(stem)] = max(made_ns, found.get(int(stem), 0))
    return dict(sorted(found.items()))


def runs() -> list[int]:
    """Return the ids of the processes whose runs clients can attach to, in rising order."""
    return [pid for pid in sockets() if _is_heard(pid)]


def _is_heard(pid: int) -> bool:
    """Whether a process's run listens on its socket; a socket that a killed run has left is removed."""
    try:
        connected(pid).close()
    except OSError:
        if not Path(f"/proc/{pid}").exists():
            for place in _folders():
                (place / f"{pid}{SUFFIX}").unlink(missing_ok=True)
        return False
    return True


@contextlib.contextmanager
def _address(place: Path, pid: int) -> Iterator[str]:
    """Context with a short path of a run's socket in a folder: a socket's address holds only 107 bytes."""
    there = os.open(place, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{there}/{pid}{SUFFIX}"
    finally:
        os.close(there)


def connected(pid: int) -> socket.socket:
    """Return a connection to a run. Raises OSError."""
    failure: OSError = FileNotFoundError(f"no socket of {pid}")
    for place in _folders():
        try:
            return _connected_in(place, pid)
        except FileNotFoundError:
            continue
        except OSError as error:  # one that a killed run has left in this folder, perhaps
            failure = error
    raise failure


def _connected_in(place: Path, pid: int) -> socket.socket:
    """Return a connection to a run that listens in a folder. Raises OSError."""
    wire = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        wire.settimeout(_PATIENCE_S)  # a run that stands still accepts no connection
        with _address(place, pid) as address:
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
        with _address(path.parent, pid) as address:
            wire.bind(address)
        wire.listen(8)
        try:
            yield wire
        finally:
            with contextlib.suppress(OSError):
                path.unlink()


def packed(message: Any) -> bytes:
    """Return a message as bytes: its length in four bytes, then the message as JSON.

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
    """Buffer of the bytes received on a connection, which splits the bytes into messages, see `packed`."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def take(self, come: bytes) -> list[Any]:
        """Add received bytes, and return the complete messages. Raises ValueError for one too long or not JSON."""
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
