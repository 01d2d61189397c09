"""A recording as a page's source: its columns, decimated, with the lowest and highest values in between."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from liftgate_hil.conversion.ours import ours_in
from liftgate_hil.conversion.table import open_table
from liftgate_hil.dashboard.source import JsonObject, split
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.recording import Recording
from liftgate_hil.signals import Bench

_MOST_ROWS = 20_000  # rows that are kept


class RecordingSource:
    """Data source of a page for a recording.

    Raises ConfigError where the file cannot be read, or holds no rows.
    """

    def __init__(self, path: Path, rig: str | None = None) -> None:
        table = open_table(path, rig)
        self._path = path
        self._names = ["time_s", *(each for each in table.signals if each != "time_s")]
        self._units = {name: table.signals[name].unit for name in self._names}
        self._ours = {} if rig is None else ours_in(rig, self._names)
        self._every = max(1, -(-_count(table) // _MOST_ROWS))
        self._last, self._low, self._high = self._thinned(table)
        if not len(self._last):
            raise ConfigError(f"{path}: no rows; allowed: a recording with rows")
        if not (np.diff(self._last[:, 0]) >= 0.0).all() or not np.isfinite(self._last[:, 0]).all():
            raise ConfigError(f"{path}: time_s: falls or is not finite; allowed: finite times in order")

    def _thinned(self, table: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the last row of each `every` rows, and the lowest and highest values in these."""
        rest = np.zeros((0, len(self._names)))
        kept: list[list[np.ndarray]] = [[], [], []]
        for block in table.rows(self._names):
            rows = np.concatenate([rest, block])
            whole = len(rows) // self._every * self._every
            rest = rows[whole:]
            _keep(kept, rows[:whole], self._every)
        _keep(kept, rest, max(1, len(rest)))
        last, low, high = (np.concatenate([rest[:0], *each]) for each in kept)
        return last, low, high

    def about(self) -> JsonObject:
        """Return the file, its columns and their units, the decimation, and its first and last time."""
        return {
            "kind": "recording",
            "file": str(self._path),
            "columns": self._names,
            "units": self._units,
            "every": self._every,
            "ours": self._ours,
            "begin_s": float(self._last[0, 0]),
            "end_s": float(self._last[-1, 0]),
        }

    def state(self, time: float | None = None) -> JsonObject:
        """Return the state at a time [s]; None: at the end."""
        times = self._last[:, 0]
        place = len(times) - 1
        if time is not None:
            place = min(max(int(np.searchsorted(times, time, side="right")) - 1, 0), place)
        row = self._last[place].tolist()
        truth, sensed = split(self._names, row)
        own = dict(zip(self._names, row, strict=True))
        return {
            "state": "recorded",
            "time_s": row[0],
            "truth": truth,
            "sensed": sensed,
            "loop": {name: own[name] for name in Bench._fields if name in own},
            "bus": {},
            "in_force": {},
            "log": [],
            "messages": [],
        }

    def plot(self) -> JsonObject:
        """Return `time_s`, `low` and `high` of the whole recording."""
        low, high = self._low.T.tolist(), self._high.T.tolist()
        return {
            "time_s": self._last[:, 0].tolist(),
            "low": dict(zip(self._names, low, strict=True)),
            "high": dict(zip(self._names, high, strict=True)),
        }


def _count(table: Recording) -> int:
    return sum(len(rows) for rows in table.rows(["time_s"]))


def _keep(kept: list[list[np.ndarray]], rows: np.ndarray, every: int) -> None:
    if not len(rows):
        return
    parts = rows.reshape(-1, every, rows.shape[1])
    with np.errstate(all="ignore"):
        for own, each in zip(
            kept, (parts[:, -1], np.fmin.reduce(parts, axis=1), np.fmax.reduce(parts, axis=1)), strict=True
        ):
            own.append(each)
