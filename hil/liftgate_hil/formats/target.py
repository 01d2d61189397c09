"""Files to write to: those that cannot be written are reported before anything is lost."""

from __future__ import annotations

import errno
import fcntl
import io
import os
import select
import stat
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from liftgate_hil.errors import ConfigError

_WORDS = {errno.ENXIO: "a pipe without a reader", errno.EISDIR: "is a folder"}


def is_special(path: Path) -> bool:
    """Whether a path is something other than a plain file: a pipe, a device, a folder. Raises OSError."""
    try:
        return not stat.S_ISREG(path.stat().st_mode)
    except FileNotFoundError:
        return False


def why(error: OSError) -> str:
    """Return the reason why a file could not be written."""
    return _WORDS.get(error.errno or 0) or error.strerror or str(error)


class PatientStream(io.RawIOBase):
    """Stream to a pipe or a device whose reader is waited for no longer than `patience` [s] without any progress.

    Writing raises TimeoutError then, and at once from then on.
    """

    def __init__(self, descriptor: int, patience: float) -> None:
        self._descriptor, self._patience = descriptor, patience
        self._has_given_up = False

    def writable(self) -> bool:
        """Whether it can be written to: yes."""
        return True

    def write(self, data: Any) -> int:
        """Write as many bytes as there is room for, at least one; return how many. Raises OSError."""
        while not self._has_given_up:
            with suppress(BlockingIOError):
                return os.write(self._descriptor, data)
            poll = select.poll()
            poll.register(self._descriptor, select.POLLOUT)
            self._has_given_up = not poll.poll(1000.0 * self._patience)
        raise TimeoutError(
            errno.ETIMEDOUT,
            f"nobody has read from it for {self._patience:g} s; what was not read, and all that follows, is lost",
        )

    def close(self) -> None:
        """Close the descriptor."""
        if not self.closed:
            super().close()
            os.close(self._descriptor)


def open_target(path: Path, patience: float | None = None) -> BinaryIO:
    """Open an empty file and lock it against other recorders until it is closed. Raises ConfigError.

    `patience` is how long [s] the reader of a pipe may read nothing before writing fails; None: without limit.
    """
    # Non-blocking: opening a pipe that nobody reads would block everything, signals included.
    flags = os.O_RDWR | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        if is_special(path):
            flags = os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC
        descriptor = os.open(path, flags, 0o666)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {why(error)}") from error
    try:
        _lock(descriptor, path)
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            os.ftruncate(descriptor, 0)
        elif patience is not None:
            return io.BufferedWriter(PatientStream(descriptor, patience))
        os.set_blocking(descriptor, True)
        return _named(descriptor, path)
    except BaseException:
        os.close(descriptor)
        raise


def open_salvage(path: Path) -> BinaryIO:
    """Create the text file beside a recording that keeps the content if the program is killed; see `salvage`.

    It is locked against other recorders. Raises ConfigError, also if the file exists: it is not overwritten.
    """
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    except FileExistsError as error:
        _check_free(path)
        raise ConfigError(
            f"{path}: already exists, left by a recording that was not completed; "
            "allowed: after it is moved or deleted"
        ) from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {why(error)}") from error
    _lock(descriptor, path)
    return _named(descriptor, path)


def _named(descriptor: int, path: Path) -> BinaryIO:
    """Return a stream for a descriptor that has the path as its name."""
    return open(path, "wb", opener=lambda *_: descriptor)  # Path.open has no opener


def _check_free(path: Path) -> None:
    """Raise ConfigError if another recorder writes to the file."""
    with suppress(OSError):  # if it cannot be opened, it counts as unlocked
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            _lock(descriptor, path)
        finally:
            os.close(descriptor)


def remove_targets(paths: Sequence[Path]) -> None:
    """Delete what an earlier run has left. Raises ConfigError if another recorder writes to one of them."""
    for path in paths:
        _check_free(path)
    for path in paths:
        path.unlink(missing_ok=True)


def aside_of(path: Path) -> Path:
    """Return the name under which a file is set aside: `run.previous.mf4` for `run.mf4`."""
    return path.with_name(f"{path.stem}.previous{path.suffix}")


def set_aside(path: Path) -> Path | None:
    """Rename a file that an earlier recording has left there, so that a new one does not replace it.

    It gets the name `aside_of` it; the previous one of that name is replaced. Return the new path; None: there was
    no regular file, or an empty one. Raises ConfigError.
    """
    try:
        if is_special(path) or not path.exists() or not path.stat().st_size:
            return None
        _check_free(path)
        return path.rename(aside_of(path))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be renamed: {why(error)}") from error


def _lock(descriptor: int, path: Path) -> None:
    """Lock a file. Raises ConfigError if another recorder has locked it."""
    # Regular files only: everybody may write to /dev/null. Some network file systems have no locks.
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ConfigError(
            f"{path}: another recording is being written to it; allowed: a different file"
        ) from error
    except OSError:
        pass
