"""Opening of output files: input files are refused, existing files set aside, errors reported."""

from __future__ import annotations

import errno
import io
import itertools
import os
import select
import stat
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from liftgate_compiler.files import close, lock, rename_new
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.ours import is_ours

_WORDS = {errno.ENXIO: "a pipe without a reader", errno.EISDIR: "is a folder"}


def is_special(path: Path) -> bool:
    """Whether a path is a pipe, a device or a folder; False: a regular file, or missing. Raises OSError."""
    try:
        return not stat.S_ISREG(path.stat().st_mode)
    except FileNotFoundError:
        return False


def why(error: OSError) -> str:
    """Return as text why a file could not be written, from the error."""
    return _WORDS.get(error.errno or 0) or error.strerror or str(error)


class PatientStream(io.RawIOBase):
    """Stream to a pipe or device that fails if its reader makes no progress for `patience` [s].

    Writing then raises TimeoutError, and does so at once from then on.
    """

    def __init__(self, descriptor: int, patience: float) -> None:
        self._descriptor, self._patience = descriptor, patience
        self._has_given_up = False

    def writable(self) -> bool:
        """Whether the stream can be written to: always true."""
        return True

    def write(self, data: Any) -> int:
        """Write as many bytes as fit, at least one; return the number. Raises OSError."""
        while not self._has_given_up:
            with suppress(BlockingIOError):
                return os.write(self._descriptor, data)
            poll = select.poll()
            poll.register(self._descriptor, select.POLLOUT)
            self._has_given_up = not poll.poll(1000.0 * self._patience)
        raise TimeoutError(
            errno.ETIMEDOUT,
            f"its reader stalled for {self._patience:g} s: unread and later rows or frames are lost",
        )

    def close(self) -> None:
        """Close the file descriptor."""
        if not self.closed:
            super().close()
            os.close(self._descriptor)


def is_one_of(path: Path, others: Iterable[Path]) -> bool:
    """Whether a path leads to one of several files, by whatever name or link."""
    with suppress(OSError, ValueError):  # ValueError: a NUL in the name
        own = path.stat()
        if stat.S_ISREG(own.st_mode):
            return any(_is_same(own, each) for each in others)
    return False


def _is_same(own: os.stat_result, other: Path) -> bool:
    with suppress(OSError, ValueError):
        return os.path.samestat(own, other.stat())
    return False


def check_no_input(path: Path, inputs: Iterable[Path]) -> None:
    """Raise ConfigError if an output file is one of the inputs, by whatever name or link."""
    if is_one_of(path, inputs):
        raise ConfigError(f"{path}: is an input file; allowed: another file")


def open_free(
    path: Path,
    inputs: Iterable[Path],
    say: Callable[[str], None],
    known: Callable[[Path], bool] = is_ours,
    patience: float | None = None,
) -> BinaryIO:
    """Open an empty file for a recording, locked against other recorders; an existing file is set aside.

    For setting aside, which is reported, see `set_aside`; for `patience`, `open_target`. Raises ConfigError,
    also for one of the `inputs`.
    """
    inputs = list(inputs)
    check_no_input(path, inputs)
    aside = set_aside(path, known, inputs)
    if aside is not None:
        say(set_aside_text(path, aside))
    return open_target(path, patience)


def open_target(path: Path, patience: float | None = None) -> BinaryIO:
    """Open an output file, locked until closed. Raises ConfigError, also where a file has content or is locked.

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
        found = os.fstat(descriptor)
        is_file = stat.S_ISREG(found.st_mode)
        if is_file and found.st_size:  # that another program has written meanwhile
            raise _taken(path)
        if not is_file and patience is not None:
            return io.BufferedWriter(PatientStream(descriptor, patience))
        os.set_blocking(descriptor, True)
        return _named(descriptor, path)
    except BaseException:
        close(descriptor)
        raise


def open_salvage(path: Path) -> BinaryIO:
    """Create the text file beside a recording whose format a kill would corrupt; see `rotation`.

    It is locked against other recorders. Raises ConfigError, also if the file exists: it is not overwritten.
    """
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    except FileExistsError as error:
        check_free(path)
        raise ConfigError(
            f"{path}: already exists, left by a recording that was not completed; "
            "allowed: after it is moved or deleted"
        ) from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {why(error)}") from error
    _lock(descriptor, path)
    return _named(descriptor, path)


def _named(descriptor: int, path: Path) -> BinaryIO:
    """Return a stream for a file descriptor, with the path as its name."""
    return open(path, "wb", opener=lambda *_: descriptor)  # Path.open has no opener


def check_free(path: Path) -> None:
    """Raise ConfigError if another recorder writes to the file."""
    with suppress(OSError):  # if it cannot be opened, it counts as unlocked
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            _lock(descriptor, path)
        finally:
            os.close(descriptor)


def aside_of(path: Path) -> Path:
    """Return the name for a file that is set aside: `run.previous.mf4` for `run.mf4`."""
    return path.with_name(f"{path.stem}.previous{path.suffix}")


def set_aside_text(path: Path, aside: Path) -> str:
    """Return a text for the user on an existing file that was set aside, with its new name."""
    return f"{path}: the recording that was there is now {aside}"


def nothing(path: Path) -> bool:
    """Recognize no file as this program's: the default of `known`."""
    return False


def set_aside(path: Path, known: Callable[[Path], bool] = nothing, kept: Iterable[Path] = ()) -> Path | None:
    """Rename an existing file at a path, so that a new one does not replace it; of a link, its target.

    The new name is `aside_of` the old one, numbered where that is taken. A file that is `known` to be ours takes
    the place of an earlier one that is, unless that is among the `kept` ones: one is kept. Return the new path;
    None: there was no regular file, or an empty one. Raises ConfigError.
    """
    place = Path(os.path.realpath(path)) if path.is_symlink() else path
    try:
        if is_special(place) or not place.exists() or not place.stat().st_size:
            return None
        check_free(place)
        return _renamed(place, known if known(place) else nothing, kept)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be renamed: {why(error)}") from error


def _renamed(place: Path, is_replaced: Callable[[Path], bool], kept: Iterable[Path]) -> Path:
    """Rename a file to its first aside name that is free or `is_replaced`; return that name. Raises OSError."""
    aside = first = aside_of(place)
    for number in itertools.count(2):
        if os.path.lexists(aside):
            if not aside.is_symlink() and is_replaced(aside) and not is_one_of(aside, kept):
                if place.samefile(aside):  # two names of one file: renaming would leave both
                    place.unlink()
                else:
                    place.rename(aside)
                return aside
        else:
            with suppress(FileExistsError):  # it has come meanwhile
                rename_new(place, aside)
                return aside
        aside = first.with_name(f"{first.stem}.{number}{first.suffix}")
    raise AssertionError


def _lock(descriptor: int, path: Path) -> None:
    """Lock a file. Raises ConfigError if another recorder has locked it."""
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):  # everybody may write to /dev/null
        return
    try:
        lock(descriptor)
    except BlockingIOError as error:
        raise _taken(path) from error


def _taken(path: Path) -> ConfigError:
    """Return the ConfigError for a file to which another recorder writes."""
    return ConfigError(f"{path}: another recording is being written to it; allowed: a different file")
