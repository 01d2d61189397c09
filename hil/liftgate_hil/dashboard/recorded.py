"""Data source of a page for a recording: its rows, decimated with lowest and highest values if it is long."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from liftgate_hil.conversion.table import open_whole, ours_in
from liftgate_hil.dashboard.page_state import (
    AboutRecording,
    ActingState,
    Curves,
    GateGeometry,
    JsonObject,
    PageState,
    ShownLoop,
)
from liftgate_hil.dashboard.source import curves_of, meanings_of, nothing_known, places_of, split
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.recording import AS_IT_IS, ReadOptions, Recording
from liftgate_hil.operate.attachment.description import expectations_of, limits_of
from liftgate_hil.operate.attachment.drawing import geometry_of
from liftgate_hil.plan.fault_columns import INJECTED
from liftgate_hil.plan.recorded_setup import RecordedSetup
from liftgate_hil.plan.setup import vehicle_from
from liftgate_hil.signals import Bench
from liftgate_plant.signals import SIDES

_MOST_VALUES = 30_000_000  # that are kept, 240 MB
_TOUCH_N = 1.0  # N of pinch force above which there is a contact
_APART_S = 0.5  # s without contact between two of them
_MOST_CONTACTS, _MOST_MARKS = 100, 500


class RecordingSource:
    """Data source of a page for a recording; a given `vehicle` is shown in place of the one that the file names.

    Raises ConfigError where the file cannot be read, or holds no rows.
    """

    def __init__(
        self, path: Path, rig: str | None = None, vehicle: str | None = None, how: ReadOptions = AS_IT_IS
    ) -> None:
        table = open_whole(path, rig, how)
        self._path = path
        self._names = ["time_s", *(each for each in table.signals if each != "time_s")]
        self._units = {name: table.signals[name].unit for name in self._names}
        marks = table.marks[:_MOST_MARKS]
        self._marks: list[JsonObject] = [{"time_s": time, "text": text} for time, text in marks]
        if len(table.marks) > _MOST_MARKS:
            more = f"and {len(table.marks) - _MOST_MARKS} more marks"
            self._marks.append({"time_s": table.marks[_MOST_MARKS][0], "text": more})
        self._ours = {} if rig is None else ours_in(rig, self._names)
        ends = [
            self._names[0],
            *self._names[1:][-1:],
        ]  # signals of frames, which have rows of their own, come last
        count = sum(len(rows) for rows in table.rows(ends))
        self._every = max(1, -(-count * len(self._names) // _MOST_VALUES))
        self._last, self._low, self._high = self._thinned(table)
        if not len(self._last):
            raise ConfigError(f"{path}: no rows; allowed: a recording with rows")
        if not (np.diff(self._last[:, 0]) >= 0.0).all() or not np.isfinite(self._last[:, 0]).all():
            raise ConfigError(f"{path}: time_s: falls or is not finite; allowed: finite times in order")
        self._springs = _spring_faults_in(table.provenance)
        self._expected = _expected_in(path, table.provenance)
        self._geometry = _geometry_in(table.about) if vehicle is None else _geometry_of(vehicle_from(vehicle))

    def _thinned(self, table: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return last, lowest and highest values of each `every` successive rows: three arrays (n, columns)."""
        if self._every == 1:
            whole = np.concatenate([np.zeros((0, len(self._names))), *table.rows(self._names)])
            return whole, whole, whole
        rest = np.zeros((0, len(self._names)))
        kept: list[list[np.ndarray]] = [[], [], []]
        for block in table.rows(self._names):
            rows = np.concatenate([rest, block])
            count = len(rows) // self._every * self._every
            rest = rows[count:]
            _append_thinned(kept, rows[:count], self._every)
        _append_thinned(kept, rest, max(1, len(rest)))
        last, low, high = (np.concatenate([rest[:0], *each]) for each in kept)
        return last, low, high

    def about(self) -> AboutRecording:
        """Return the recording's columns, units, decimation, time range, contacts, marks and expectations."""
        return {
            "kind": "recording",
            "file": str(self._path),
            "columns": self._names,
            "units": self._units,
            "meanings": meanings_of(self._names),
            "every": self._every,
            "ours": self._ours,
            "begin_s": float(self._last[0, 0]),
            "end_s": float(self._last[-1, 0]),
            "contacts": self._contacts(),
            "marks": self._marks,
            **self._expected,
        }

    def geometry(self) -> GateGeometry:
        """Return the geometry of the given vehicle, else of that in the file's provenance; {}: unknown."""
        return self._geometry

    def _contacts(self) -> list[JsonObject] | None:
        """Return the first 100 contacts with an obstacle (above 1 N); None: the recording holds no pinch force."""
        name = next(
            (each for each in self._names if self._ours.get("pinch_force_n", "pinch_force_n") == each), None
        )
        if name is None:
            return None
        force, times = self._high[:, self._names.index(name)], self._last[:, 0]
        touched = np.flatnonzero(force > _TOUCH_N)
        parts = np.split(touched, np.flatnonzero(np.diff(times[touched]) > _APART_S) + 1) if len(touched) else []
        return [
            {
                "begin_s": float(times[rows[0]]),
                "end_s": float(times[rows[-1]]),
                "peak_n": float(force[rows].max()),
                "peak_s": float(times[rows[int(force[rows].argmax())]]),
            }
            for rows in parts[:_MOST_CONTACTS]
        ]

    def state(self, time: float | None = None) -> PageState:
        """Return the state at a time [s]; None: at the end."""
        times = self._last[:, 0]
        place = len(times) - 1
        if time is not None:
            place = min(max(int(np.searchsorted(times, time, side="right")) - 1, 0), place)
        row = self._last[place].tolist()
        truth, sensed = split(self._names, row)
        own = dict(zip(self._names, row, strict=True))
        found = nothing_known("recorded")
        found["time_s"], found["truth"], found["sensed"] = row[0], truth, sensed
        found["loop"] = cast(ShownLoop, {name: own[name] for name in Bench._fields if name in own})
        found["acting"] = self._acting(own)
        return found

    def _acting(self, row: Mapping[str, float]) -> ActingState:
        """Return the recorded obstacle while the gate presses against it, and the health of the springs."""
        angle = row.get("pinch_contact_deg", math.nan)
        is_there = math.isfinite(angle) and self._geometry and row.get("pinch_force_n", 0.0) > _TOUCH_N
        rod = {"angle_deg": angle, "distance": self._geometry["length_m"]} if is_there else None
        if row.get(INJECTED, 0.0) > 0.0:  # by other faults than the scenario's: nobody knows the springs' state
            return {"obstacle": rod, "spring_health": dict.fromkeys(SIDES)}
        springs: dict[str, float] = {}
        for name, (sides, factor) in self._springs.items():
            if row.get(name, 0.0) > 0.0:
                springs |= {side: factor * springs.get(side, 1.0) for side in sides}
        return {"obstacle": rod, "spring_health": springs}

    def plot(self, columns: Sequence[str], begin: float, end: float, points: int) -> Curves:
        """Return curves between two times [s], see `curves_of`, with one more row on either side."""
        places, times = places_of(columns, self._names), self._last[:, 0]
        first, last = int(np.searchsorted(times, begin)), int(np.searchsorted(times, end, side="right"))
        rows = slice(max(0, first - 1), last + 1)
        return curves_of(columns, times[rows], self._low[rows][:, places], self._high[rows][:, places], points)


def _geometry_in(about: str) -> GateGeometry:
    """Return the geometry of the vehicle in a recording's provenance, a text in JSON; {}: it holds none."""
    if not about:
        return {}
    try:
        vehicle: Any = json.loads(about, object_hook=lambda table: SimpleNamespace(**table)).vehicle
        found = _geometry_of(vehicle)
    except (ValueError, AttributeError, TypeError):  # of a version with other keys
        return {}
    numbers = [found["length_m"], found["open_angle_deg"], *found["hinge"]]
    return found if all(isinstance(each, int | float) and math.isfinite(each) for each in numbers) else {}


def _geometry_of(vehicle: Any) -> GateGeometry:
    return cast(GateGeometry, geometry_of(vehicle))


def _expected_in(path: Path, provenance: Mapping[str, Any]) -> AboutRecording:
    """Return the expectations and force limits of a recording's scenario, if its files are unchanged."""
    setup = RecordedSetup(path, provenance)
    scenario, vehicle, rig = setup.scenario, setup.vehicle, setup.rig
    expected = {} if scenario is None else expectations_of(scenario)
    limits: Any = []
    if scenario is not None and vehicle is not None and rig is not None:
        limits = limits_of(scenario, vehicle, rig)
    return {"expectations": expected, "force_limits": limits}


def _spring_faults_in(provenance: Mapping[str, Any]) -> dict[str, tuple[Sequence[str], float]]:
    """Return the spring faults in a recording's provenance: for each fault's column its sides and factor."""
    found: dict[str, tuple[Sequence[str], float]] = {}
    with contextlib.suppress(ValueError, AttributeError, TypeError, KeyError):  # of a version with other keys
        for name, fault in provenance.get("faults", {}).items():
            if fault["kind"] in ("spring_lost", "spring_weak"):
                sides = SIDES if fault["where"] in (None, "both") else (fault["where"],)
                found[name] = sides, float(fault.get("factor", 0.0))
    return found


def _append_thinned(kept: list[list[np.ndarray]], rows: np.ndarray, every: int) -> None:
    """Append last, lowest and highest values of each `every` rows (no rest) to the lists `kept`."""
    if not len(rows):
        return
    parts = rows.reshape(-1, every, rows.shape[1])
    with np.errstate(all="ignore"):
        last, low, high = parts[:, -1], np.fmin.reduce(parts, axis=1), np.fmax.reduce(parts, axis=1)
    for own, each in zip(kept, (last, low, high), strict=True):
        own.append(each)
