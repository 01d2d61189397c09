"""Files written atomically: as temporary files, locked, and renamed when complete.

The standard library only; the machine code's cache, recordings, reports and campaigns share it.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

_LONGEST = 200  # bytes of a name that a temporary one holds: file systems allow 255
_BESIDE = re.compile(r"\.(.+)\.liftgate-[0-9a-f]{32}", re.DOTALL)
# Errors of replacing a file that may be written to: a folder without permission, or sticky; read-only, or mounted;
# an owner that a container does not know.
_NOT_REPLACED = (errno.EACCES, errno.EPERM, errno.EROFS, errno.EBUSY, errno.EINVAL)
# Errors of a file system that reserves no room (posix_fallocate(3)).
_NO_ROOM_KNOWN = (errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)
# Errors of a file system that has no hard links (link(2)).
_NO_LINKS = (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EINVAL)


def lock(descriptor: int) -> bool:
    """Lock an open file until all its descriptors are closed; False: no locks here. Raises BlockingIOError.

    False is returned on file systems without locks (ENOSYS, ENOLCK of Lustre, EOPNOTSUPP of some network ones).
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


def close(descriptor: int) -> None:
    """Close a file whose content is on disk or not needed, ignoring errors, which would hide earlier ones."""
    with contextlib.suppress(OSError):
        os.close(descriptor)


def write_whole(path: Path, content: bytes, is_new: bool = False, mode: int | None = None) -> None:
    """Write a file's content atomically, as `whole_file` does. Raises OSError, which names the file."""
    with _naming(path), whole_file(path, is_new, mode) as stream:
        stream.write(content)


@contextlib.contextmanager
def whole_file(
    path: Path, is_new: bool = False, mode: int | None = None, make_way: Callable[[], object] | None = None
) -> Iterator[BinaryIO]:
    """Context with a stream for a file's new content, which replaces the file only if complete.

    The content goes to a file beside its place, to the disk, and is then renamed. A file that is replaced keeps
    its owner and permissions, unless the permissions are given by `mode`; a link leads to the same place. Where
    the file `is_new` and something is there, FileExistsError is raised. What is no regular file with a name, as a
    pipe, is written to directly. What cannot be replaced, for want of permission, gets the whole content in place,
    once there is room for it. The stream may be closed inside. `make_way` is called before the file takes its
    place, and may set aside what is there; then only a pipe is written to directly. Raises OSError, and what
    `make_way` raises.
    """
    with _naming(path):
        place = _place_of(path)
    if is_new and path.exists():
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
    if path.exists() and not (path.is_file() and place.exists() and path.samefile(place)):
        with path.open("wb") as stream:
            yield stream
        return
    try:
        with _naming(path):
            descriptor, beside = _created(place, mode)
    except OSError as error:
        if make_way is not None or error.errno not in _NOT_REPLACED or not place.exists():
            raise
        with tempfile.TemporaryFile() as spool:
            with _stream_of(os.dup(spool.fileno()), place) as stream:
                yield stream
            _copy(spool, place)
        return
    try:
        with _stream_of(os.dup(descriptor), beside) as stream:
            yield stream
        with _naming(path):
            os.fsync(descriptor)  # else a power cut may leave a renamed file that is empty
            if make_way is not None:
                make_way()
                beside.replace(place)
            elif is_new:
                rename_new(beside, place)
            else:
                _replace(beside, place)
    except _HalfCopiedError:
        raise
    except BaseException:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise
    finally:
        close(descriptor)


def _place_of(path: Path) -> Path:
    """Return the target of a path's links. Raises OSError for an unreadable link, which would be replaced."""
    try:
        return Path(os.path.realpath(path, strict=True))
    except FileNotFoundError:
        return Path(os.path.realpath(path))


class _HalfCopiedError(OSError):
    """Raised if a file was replaced only in part; a temporary file with a name keeps the whole content."""


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Context in which an OSError names the target file instead of the temporary one."""
    try:
        yield
    except OSError as error:
        error.filename, error.filename2 = str(path), None
        raise


def _created(place: Path, mode: int | None) -> tuple[int, Path]:
    """Create and lock a temporary file for a target, with the owner and permissions of an existing target.

    Return its descriptor and path. Raises OSError.
    """
    while True:
        beside = place.with_name(name_beside(place.name))
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        descriptor = os.open(beside, flags, 0o666 if mode is None else mode)
        try:
            if _is_held(descriptor):
                if mode is None and place.exists():
                    _keep_owner(descriptor, place.stat())
                return descriptor, beside
        except BaseException:
            close(descriptor)
            with contextlib.suppress(OSError):
                beside.unlink()
            raise
        close(descriptor)


def _is_held(descriptor: int) -> bool:
    """Lock a temporary file, if possible; False: `remove_leftovers` elsewhere has locked or removed it."""
    try:
        lock(descriptor)
    except BlockingIOError:
        return False
    return os.fstat(descriptor).st_nlink > 0


def _keep_owner(descriptor: int, before: os.stat_result) -> None:
    """Give a file the owner and permissions of another one. Raises OSError."""
    own = os.fstat(descriptor)
    if (before.st_uid, before.st_gid) != (own.st_uid, own.st_gid):
        os.fchown(descriptor, before.st_uid, before.st_gid)
    os.fchmod(descriptor, before.st_mode)


def _stream_of(descriptor: int, path: Path) -> BinaryIO:
    """Return a stream for a file descriptor, with the path as its name."""
    return open(path, "wb", opener=lambda *_: descriptor)  # Path.open has no opener


def _replace(beside: Path, place: Path) -> None:
    """Rename a file to its target, or copy its content where the target cannot be replaced. Raises OSError."""
    try:
        beside.replace(place)
    except OSError as error:
        if error.errno not in _NOT_REPLACED or not place.exists():
            raise
        with beside.open("rb") as source:
            try:
                _copy(source, place)
            except _HalfCopiedError as half:
                half.strerror = f"{half.strerror}; the whole content is in {beside}"
                raise
        beside.unlink()


def _copy(source: BinaryIO, place: Path) -> None:
    """Copy a whole file into an existing one once there is room. Raises OSError, _HalfCopiedError."""
    size = source.seek(0, os.SEEK_END)
    source.seek(0)
    with place.open("r+b") as target:
        before = os.fstat(target.fileno()).st_size
        if size > before:
            try:
                os.posix_fallocate(target.fileno(), 0, size)
            except OSError as error:
                target.truncate(before)
                if error.errno not in _NO_ROOM_KNOWN:
                    raise
        try:
            shutil.copyfileobj(source, target)
            target.truncate(size)
            target.flush()
            os.fsync(target.fileno())
        except OSError as error:
            raise _HalfCopiedError(error.errno, error.strerror, str(place)) from error


def rename_new(path: Path, target: Path) -> None:
    """Rename a file to a free name. Raises OSError, FileExistsError if the name is taken."""
    try:
        os.link(path, target, follow_symlinks=False)
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        os.close(os.open(target, os.O_CREAT | os.O_EXCL))  # nobody else takes the name meanwhile
        try:
            path.rename(target)
        except OSError:
            target.unlink()
            raise
        return
    path.unlink()


def name_beside(name: str) -> str:
    """Return a name for the temporary file of another file, recognizable as this program's."""
    begin = os.fsencode(name)[:_LONGEST].decode(errors="ignore")
    return f".{begin}.liftgate-{uuid.uuid4().hex}"


def remove_leftovers(folder: Path, name: str | None = None) -> None:
    """Remove temporary files of killed processes from a folder, those for the file `name` or all.

    A process that writes one holds its lock; where there are no locks, all stay.
    """
    begin = None if name is None else os.fsencode(name)[:_LONGEST].decode(errors="ignore")
    with contextlib.suppress(OSError):
        for each in folder.iterdir():
            found = _BESIDE.fullmatch(each.name)
            if found is not None and begin in (None, found[1]):
                _remove_unlocked(each)


def _remove_unlocked(path: Path) -> None:
    """Remove a file unless a process holds its lock, or the file system has no locks."""
    with contextlib.suppress(OSError):
        descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            if lock(descriptor):
                path.unlink()
        finally:
            close(descriptor)
