"""Setup of a recorded run, from the recording's provenance: vehicle, rig, scenario and its parameters."""

from __future__ import annotations

import contextlib
import math
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from liftgate_hil.config.rig import Rig, load_rig
from liftgate_hil.config.scenario import Scenario, load_scenario
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.sources import sources_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.open import open_file
from liftgate_hil.formats.suffixes import FORMATS
from liftgate_plant.vehicle import Vehicle


@dataclass(frozen=True)
class RecordedSetup:
    """Provenance of a recorded run; empty where no file of the run states any."""

    path: Path = Path()
    content: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def vehicle(self) -> Vehicle | None:
        """The recorded run's vehicle, with all settings; None: not stated, or with other parameters."""
        with contextlib.suppress(TypeError, ValueError, KeyError, AttributeError):
            found = _built(Vehicle, self.content["vehicle"])
            return found if isinstance(found, Vehicle) else None
        return None

    @property
    def vehicle_name(self) -> str:
        """Name of the recorded vehicle's file, without suffix; "as recorded" where none is stated."""
        return Path(self._file("vehicle").get("path", "as recorded")).stem

    @cached_property
    def rig(self) -> Rig | None:
        """The rig of the recorded run; None: not stated, or its files are missing or have changed since."""
        own = self._file("rig")
        name = own.get("path", "")
        for path in (Path(name), *_shipped(Path(name).stem)) if name else ():
            with contextlib.suppress(ConfigError):
                rig = load_rig(path)
                now = sources_of({"rig": path, "dbc": rig.database})
                if all(now[each].sha256 == self._file(each).get("sha256") for each in now):
                    return rig
        return None

    @cached_property
    def scenario(self) -> Scenario | None:
        """The scenario with its recorded parameters; None: not stated, or files are missing or changed since."""
        path = self._file("scenario").get("path", "")
        with contextlib.suppress(ConfigError):
            found = load_scenario(Path(path), self.parameters) if path else None
            paths = () if found is None else (path, *found.included)
            stated = {each.get("path"): each.get("sha256") for each in self._files.values()}
            now = sources_of({name: Path(name) for name in paths})
            if paths and all(name in now and now[name].sha256 == stated.get(name) for name in paths):
                return found
        return None

    @property
    def states_rig(self) -> bool:
        """Whether the provenance states a rig."""
        return bool(self._file("rig"))

    @property
    def parameters(self) -> Mapping[str, float]:
        """The recorded parameters of the scenario, by name."""
        found = self.content.get("parameters")
        return found if isinstance(found, dict) else {}

    @property
    def _files(self) -> Mapping[str, Mapping[str, str]]:
        """The recorded run's files, by purpose: path, SHA-256 and text."""
        files = self.content.get("files")
        files = files if isinstance(files, dict) else {}
        return {name: each for name, each in files.items() if isinstance(each, dict)}

    def _file(self, purpose: str) -> Mapping[str, str]:
        return self._files.get(purpose, {})


def recorded_setup(paths: Sequence[Path]) -> RecordedSetup:
    """Return the setup from the first of a run's files with a provenance; an unreadable file has none."""
    for path in paths:
        form = FORMATS.get(path.suffix.lower())
        if form is None or not form.holds_about:
            continue
        with contextlib.suppress(ConfigError):  # reported by its reader
            if content := open_file(path).provenance:
                return RecordedSetup(path, content)
    return RecordedSetup()


def _shipped(name: str) -> list[Path]:
    with contextlib.suppress(ConfigError):
        return [find_config("rigs", name)]
    return []


def _built(kind: Any, value: Any) -> Any:
    """Convert a JSON value to a NamedTuple of this kind, with nested ones. Raises TypeError for other fields."""
    if hasattr(kind, "_fields"):
        if {*value} != {*kind._fields}:
            raise TypeError
        hints = typing.get_type_hints(kind)
        return kind(**{name: _built(hints[name], value[name]) for name in kind._fields})
    if isinstance(value, list):
        return tuple(_built(None, each) for each in value)
    if value in ("inf", "-inf", "nan"):
        return math.inf if value == "inf" else -math.inf if value == "-inf" else math.nan
    return value
