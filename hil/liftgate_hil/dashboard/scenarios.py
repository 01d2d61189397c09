"""Scenario files of a folder, as a page lists them: name, description and requirements of each."""

from __future__ import annotations

import contextlib
import os
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from liftgate_hil.config.scenario import ScenarioFile, read_scenario
from liftgate_hil.dashboard.page_state import JsonObject
from liftgate_hil.errors import ConfigError

_MOST = 1000  # files that are listed
_MOST_ENTRIES = 20_000  # of folders that are looked at: some 0.1 s; a folder of 100,000 files had taken 13 s
_MOST_BYTES = 1_000_000  # of a file that is read: shipped scenarios have 3 kB
_LONGEST = 1000  # characters of a description or an issue

_Stamp = tuple[tuple[int, int], ...]  # of each file: time of the last change [ns], and size


@dataclass(frozen=True)
class _Known:
    """A scenario file as it was read, with the files that it includes."""

    paths: tuple[Path, ...]
    stamp: _Stamp
    about: JsonObject


class Scenarios:
    """Scenario files of a folder and those below it, the nearest first; hidden ones are left out.

    Listing reads folders and files: it is for a thread of its own, not for the server's event loop.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[str, _Known] = {}

    def names(self) -> tuple[list[str], bool]:
        """Return the sorted names of the files, and whether these are all.

        A large folder is not looked at to its end.
        """
        found: list[str] = []
        looked, waiting = 0, deque([""])
        while waiting:
            place = waiting.popleft()
            with contextlib.suppress(OSError), os.scandir(self.folder / place) as entries:
                for each in entries:
                    looked += 1
                    if looked > _MOST_ENTRIES or len(found) == _MOST:
                        return sorted(found), False
                    name = f"{place}{each.name}"
                    if each.name.startswith(".") or not name.isprintable():
                        continue
                    if each.is_dir(follow_symlinks=False):
                        waiting.append(f"{name}/")
                    elif each.name.endswith(".toml") and each.is_file():
                        found.append(name)
        return sorted(found), True

    def listed(self) -> tuple[list[JsonObject], bool]:
        """Return `name`, `description`, `requirement` and `issue` of each file, and whether these are all."""
        names, is_all = self.names()
        self._known = {name: self._read(name) for name in names}
        return [{"name": name, **each.about} for name, each in self._known.items()], is_all

    def _read(self, name: str) -> _Known:
        """Return a file as it was read before, if neither it nor what it includes has changed since."""
        known = self._known.get(name)
        if known is not None and _stamp_of(known.paths) == known.stamp:
            return known
        path = self.folder / name
        try:
            if path.stat().st_size > _MOST_BYTES:
                raise ConfigError(f"{path}: longer than {_MOST_BYTES} bytes; allowed: a scenario")
            file = read_scenario(path)
        except (ConfigError, OSError) as error:
            issue = error.issues[0] if isinstance(error, ConfigError) else f"{path}: {error.strerror}"
            return _Known((path,), _stamp_of([path]), _about(issue=issue))
        paths = tuple(part.path for part in file.parts)
        return _Known(paths, _stamp_of(paths), _about(file))


def _about(file: ScenarioFile | None = None, issue: str = "") -> JsonObject:
    description = "" if file is None else " ".join(str(file.stated("description", "")).split())
    given = [] if file is None else file.stated("requirement", [])
    requirement = [str(each) for each in (given if isinstance(given, list) else [given])]
    return {"description": description[:_LONGEST], "requirement": requirement, "issue": issue[:_LONGEST]}


def _stamp_of(paths: Iterable[Path]) -> _Stamp:
    found = []
    for path in paths:
        try:
            state = path.stat()
        except OSError:  # it is gone
            return ()
        found.append((state.st_mtime_ns, state.st_size))
    return tuple(found)
