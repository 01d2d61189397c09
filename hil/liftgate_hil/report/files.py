"""Report files: their paths are checked before a long computation, and written after it."""

from __future__ import annotations

import contextlib
import errno
import os
import uuid
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from liftgate_hil.errors import ConfigError

_LONGEST = 180  # bytes of a name that a temporary one holds, beside two of 32: file systems allow 255
# Errors of replacing a file that may be written to: a folder without permission, or sticky; read-only, or mounted;
# an owner that a container does not know.
_NOT_REPLACED = (errno.EACCES, errno.EPERM, errno.EROFS, errno.EBUSY, errno.EINVAL)
# Suffixes of files that a report may replace.
_KINDS = {"--html": (".html", ".htm"), "--save-vehicle": (".toml",), "--result": (".json",)}


def check_targets(targets: Mapping[str, str | None], sources: Sequence[str]) -> None:
    """Raise ConfigError with all issues of the files that flags name, where they are given.

    No file may be written twice, and none may be one that is read (`sources`).
    """
    issues: list[str] = []
    taken = {_place(each): "is an input file" for each in sources}
    for flag, path in targets.items():
        if path is None:
            continue
        try:
            check_target(path, flag)
        except ConfigError as error:
            issues += error.issues
            continue
        kinds = _KINDS.get(flag)
        if kinds and Path(path).suffix.lower() not in kinds and Path(path).is_file():
            issues.append(
                f"{flag} {path}: is a file of another kind; allowed: a new file, or a {kinds[0]} to replace"
            )
        if _place(path) in taken:
            issues.append(f"{flag} {path}: {taken[_place(path)]}; allowed: a separate file")
        taken.setdefault(_place(path), f"{flag} writes it")
    if issues:
        raise ConfigError(issues)


def _place(path: str) -> str:
    return os.path.realpath(path)


def check_target(path: str, flag: str) -> None:
    """Raise ConfigError where `flag` names a file that could not be written."""
    target = Path(path)
    if "\0" in path:
        raise ConfigError(f"{flag} {path!r}: allowed: a name without a NUL")
    try:
        if not path or target.is_dir():
            raise ConfigError(f"{flag} {path}: is a folder; allowed: the name of a file")
        if not target.parent.is_dir():
            raise ConfigError(f"{flag} {path}: no folder {target.parent}; allowed: an existing folder")
        exists = target.exists()
    except OSError as error:  # for example a name that is too long
        raise ConfigError(f"{flag} {path}: {error.strerror}") from error
    if not os.access(target if exists else target.parent, os.W_OK):
        what = "it" if exists else f"folder {target.parent}"
        raise ConfigError(f"{flag} {path}: no permission to write {what}")


def write_report(path: str, flag: str, text: str) -> None:
    """Write a text file; raise ConfigError where that fails."""
    try:
        write_whole(Path(path), text.encode())
    except OSError as error:
        raise ConfigError(f"{flag} {path}: cannot be written: {error.strerror}") from error


def write_whole(path: Path, content: bytes, owner: str = "") -> None:
    """Write a file beside its place and rename it: it is there whole, or as it was before. Raises OSError.

    The name of the temporary file tells its `owner`, see `name_beside`. What is no regular file with a name, as a
    pipe, or cannot be replaced, for want of permission, is written to directly.
    """
    place = Path(os.path.realpath(path))  # of a link, what it leads to
    if path.exists() and not (path.is_file() and place.exists() and path.samefile(place)):
        path.write_bytes(content)
        return
    try:
        _replace(place, content, owner)
    except OSError as error:
        if error.errno not in _NOT_REPLACED or not place.exists():
            raise
        place.write_bytes(content)


def _replace(place: Path, content: bytes, owner: str) -> None:
    """Replace a file, or make it, with the owner and the permissions that it had. Raises OSError."""
    beside = place.with_name(name_beside(place.name, owner))
    try:
        with beside.open("wb") as stream:
            if place.exists():
                before, own = place.stat(), os.fstat(stream.fileno())
                if (before.st_uid, before.st_gid) != (own.st_uid, own.st_gid):
                    os.fchown(stream.fileno(), before.st_uid, before.st_gid)
                os.fchmod(stream.fileno(), before.st_mode)
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())  # else a power cut may leave a renamed file that is empty
        beside.replace(place)
    except BaseException:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise


def name_beside(name: str, owner: str = "") -> str:
    """Return the name of a temporary file for the content of another one; `owner` is a token without dots."""
    begin = os.fsencode(name)[:_LONGEST].decode(errors="ignore")
    return ".".join(["", begin, *([owner] if owner else []), uuid.uuid4().hex])


def is_beside(name: str, owners: Collection[str]) -> bool:
    """Whether a file is a temporary one of `name_beside`, and of one of these owners."""
    parts = name.split(".")
    return len(parts) > 3 and not parts[0] and parts[-2] in owners
