"""Scenario files: which ones paths and folders stand for, and whether a TOML file is a scenario."""

from __future__ import annotations

import contextlib
import difflib
import os
import re
from collections.abc import Sequence
from pathlib import Path

from liftgate_hil.config.described import fields_of
from liftgate_hil.config.files import is_there
from liftgate_hil.config.scenario_schema import ScenarioTable
from liftgate_hil.config.shipped import find_config, shipped_folder
from liftgate_hil.config.toml import read_toml
from liftgate_hil.errors import ConfigError
from liftgate_hil.judging.expectation import KINDS

_EXPECT = re.compile(rb"^[ \t]*\[\[?[ \t]*expect", re.MULTILINE)  # a header of [[expect]], or an attempt at one
# Keys that scenarios have, and hardly another file.
_OURS = {"request", "obstacle", "profile", "fault", "precondition"}
_MOST_FILES = 100  # files that include each other
# A line of a scenario that other tools' files do not have.
_LIKE_ONE = re.compile(
    rb"^[ \t]*((precondition|requirement|duration)[ \t]*=|\[\[(request|obstacle|fault|profile)\]\])", re.M
)
_KNOWN = {key.name for key in fields_of(ScenarioTable)}


def scenario_files(paths: Sequence[str]) -> list[Path]:
    """Return the scenario files that paths and shipped names (such as the shipped folder `pack`) stand for.

    A folder stands for all scenarios with [[expect]] in it and below. Raises ConfigError.
    """
    found: list[Path] = []
    for name in paths:
        if not name:
            raise ConfigError("empty path; allowed: files, folders, shipped names")
        path = Path(name)
        if not is_there(path):
            path = shipped_folder("scenarios", name) or path
        if path.is_dir():
            inside = sorted(each for each in path.rglob("*.toml") if may_be_scenario(each, _is_test(each)))
            if not inside:
                raise ConfigError(f"{path}: no scenario with [[expect]]; allowed: a folder with scenarios")
            found += inside
        else:
            found.append(path if is_there(path) else find_config("scenarios", name, "PATH"))
    kept: dict[Path, Path] = {}
    for path in found:
        kept.setdefault(Path(os.path.realpath(path)), path)
    return list(kept.values())


def unreadable_files(paths: Sequence[str]) -> list[str]:
    """Return why TOML files in folders cannot be read and are left out, each reason with its file's path."""
    found: list[str] = []
    for folder in filter(Path.is_dir, map(Path, paths)):
        for path in sorted(folder.rglob("*.toml")):
            try:
                read_toml(path)
            except ConfigError as error:
                found += [] if may_be_scenario(path, _is_test(path)) else error.issues[:1]
    return found


def _is_test(path: Path) -> bool:
    """Whether a file's name begins with `test_`, by which pytest recognizes tests."""
    return path.name.startswith("test_")


def may_be_scenario(path: Path, is_test: bool = False) -> bool:
    """Whether a TOML file is a scenario, or looks like one with an error that must be reported.

    The latter contains [[expect]] and cannot be read, misspells [[expect]], or is named as a test (`is_test`) and
    expects nothing: it would be missing without notice.
    """
    try:
        content = read_toml(path)
    except ConfigError:
        with contextlib.suppress(OSError):
            text = path.read_bytes()
            return _EXPECT.search(text) is not None or (is_test and _LIKE_ONE.search(text) is not None)
        return False
    if is_scenario(path):
        return True
    own = {*content} & _KNOWN - {"expect"}
    misspelt = [value for key, value in content.items() if _is_like_expect(key) and key not in _KNOWN]
    is_misspelt = any(is_test or isinstance(each, list) for each in misspelt)
    is_like_one = is_misspelt or (is_test and {*content} <= _KNOWN)
    return len(content) > 1 and bool(own) and is_like_one


def _is_like_expect(key: str) -> bool:
    """Whether a key is spelt like `expect` or `expectation`, exactly or nearly."""
    return bool(difflib.get_close_matches(key.lower()[:12], ("expect", "expectation"), 1, 0.75))


def is_scenario(path: Path) -> bool:
    """Whether a TOML file has expectations of a gate, itself or in a file that it includes.

    It has [[expect]], and either no key that a scenario does not have, or an expectation of one of our kinds. A
    file that cannot be read is not one, nor are other tools' files.
    """
    return _is_scenario(path, set())


def _is_scenario(path: Path, seen: set[Path]) -> bool:
    """Whether a TOML file is a scenario; `seen` are the files checked so far, to which it is added."""
    try:
        content = read_toml(path)
    except ConfigError:
        return False
    if path.resolve() in seen:
        return False
    seen.add(path.resolve())
    expected = content.get("expect")
    misspelt = expected is None and any(_is_like_expect(each) for each in content)
    if (misspelt or isinstance(expected, dict)) and _OURS & {*content}:
        return True  # its error shall be reported
    is_known = len(content) > 1 and {*content} <= _KNOWN
    if is_known and not expected:
        included = content.get("include", [])
        names = included if isinstance(included, list) else [included]
        files = [path.parent / each for each in names if isinstance(each, str)]
        return len(seen) < _MOST_FILES and any(_is_scenario(each, seen) for each in files)
    if not isinstance(expected, list) or not all(isinstance(each, dict) for each in expected):
        return False
    return bool(expected) and (is_known or any({*each} & {*KINDS} for each in expected))
