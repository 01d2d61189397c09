"""Report files: check their paths before a long computation, and write them after it.

A report of this program, told by what it holds, is replaced; whatever else is at its place is set aside.
"""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from liftgate_compiler.files import remove_leftovers, whole_file
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.formats.target import is_one_of, set_aside
from liftgate_hil.report.page import GENERATOR

SOFTWARE = "liftgate-hil"  # what pictures name as the program that made them
JUNIT = "<!-- JUnit XML of liftgate-hil -->"  # before JUnit's root element, which has no attributes
_HEAD = 2000  # bytes in which these stand, but for a PDF's
_MARKS = (GENERATOR, JUNIT, f"Software\0{SOFTWARE}", f"<dc:title>{SOFTWARE}</dc:title>")
_PDF = f"/Creator ({SOFTWARE})"


def is_ours(path: Path) -> bool:
    """Whether a file is a report or a picture that this program wrote; False if that cannot be determined."""
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
            if head.startswith(b"%PDF"):
                return _PDF.encode() in head + stream.read()
            if head.lstrip().startswith(b"{"):
                return _is_our_json(head + stream.read())
    except OSError:
        return False
    return any(mark.encode() in head for mark in _MARKS)


_BEGINS = {".html": b"<!doctype", ".xml": b"<?xml", ".json": b"{"}  # how reports of ours begin, by suffix


def holds_form(path: Path, suffix: str) -> bool:
    """Whether a file begins as a report with this `suffix` (.html, .xml, .json) does; True for other suffixes."""
    with path.open("rb") as stream:
        return stream.read(_HEAD).lstrip().lower().startswith(_BEGINS.get(suffix, b""))


def _is_our_json(content: bytes) -> bool:
    """Whether JSON content has a provenance with a version of this program."""
    try:
        return "liftgate-hil" in json.loads(content)["provenance"]["versions"]
    except (ValueError, LookupError, TypeError, RecursionError):
        return False


# Suffixes of the files that a report may take the place of.
_KINDS = {
    "html": (".html", ".htm"), "junit": (".xml",), "json": (".json",), "result": (".json",),
    "save_vehicle": (".toml",),
}  # fmt: skip


def is_of_another_kind(path: Path, kind: str) -> bool:
    """Whether a file exists that a report of a kind (html, junit, json, result, save_vehicle) must not replace.

    That is a report of ours of another form, or what is not ours and has another suffix.
    """
    if kind not in _KINDS or not path.is_file() or not path.stat().st_size:
        return False
    if is_ours(path):
        return not holds_form(path, _KINDS[kind][0])
    return path.suffix.lower() not in _KINDS[kind]


def check_targets(targets: Mapping[str, str | Path | None], sources: Iterable[str | Path]) -> None:
    """Raise ConfigError with all issues of output files, `targets` by their arguments' names; None: not requested.

    No file may be written twice, and none may be one that is read (`sources`). What killed processes have left
    beside them is removed.
    """
    issues: list[str] = []
    taken, inputs = dict[str, str](), [Path(each) for each in sources]
    for name, target in targets.items():
        if target is None:
            continue
        path = str(target)
        try:
            check_target(path, name)
        except ConfigError as error:
            issues += error.issues
            continue
        place = os.path.realpath(path)
        if is_one_of(Path(path), inputs):
            issues.append(f"`{name}` {path}: is an input file; allowed: a separate file")
        elif is_of_another_kind(Path(path), name):
            issues.append(
                f"`{name}` {path}: is a file of another kind; allowed: a new file, or a {_KINDS[name][0]} to "
                "replace"
            )
        elif place in taken:
            issues.append(f"`{name}` {path}: {taken[place]}; allowed: a separate file")
        else:
            remove_leftovers(Path(path).parent, Path(path).name)
        taken.setdefault(place, f"`{name}` writes it")
    if issues:
        raise ConfigError(issues)


def check_target(path: str, name: str) -> None:
    """Raise ConfigError if the file that the argument `name` gives cannot be written."""
    target = Path(path)
    if "\0" in path:
        raise ConfigError(f"`{name}` {path!r}: allowed: a name without a NUL")
    try:
        if not path or target.is_dir():
            raise ConfigError(f"`{name}` {path}: is a folder; allowed: the name of a file")
        if not target.parent.is_dir():
            raise ConfigError(f"`{name}` {path}: no folder {target.parent}; allowed: an existing folder")
        exists = target.exists()
    except OSError as error:  # for example a name that is too long
        raise ConfigError(f"`{name}` {path}: {error.strerror}") from error
    if not os.access(target if exists else target.parent, os.W_OK):
        what = "it" if exists else f"folder {target.parent}"
        raise ConfigError(f"`{name}` {path}: no permission to write {what}")


def put_report(path: Path, content: bytes, say: Say = silent) -> None:
    """Write a report over an earlier one of this program; another file is renamed, and `say` called with a text.

    Raises OSError, ConfigError.
    """
    if path.is_file() and path.stat().st_size == len(content) and path.read_bytes() == content:
        return
    is_foreign = path.is_file() and path.stat().st_size > 0 and not is_ours(path)
    with whole_file(path, make_way=functools.partial(make_way, path, say) if is_foreign else None) as stream:
        stream.write(content)


def make_way(path: Path, say: Say = silent) -> None:
    """Rename a file at a report's path unless it is a report of this program. Raises ConfigError."""
    if path.is_file() and not is_ours(path) and (aside := set_aside(path)) is not None:
        say(f"{path}: the file that was there is now {aside}")


def write_report(path: str, name: str, text: str, say: Say = silent) -> None:
    """Write a text report as `put_report` does; raise ConfigError if that fails."""
    try:
        put_report(Path(path), text.encode(), say)
    except OSError as error:
        raise ConfigError(f"`{name}` {path}: cannot be written: {error.strerror}") from error
