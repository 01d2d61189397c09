"""Judging again, from recordings: the same rows and frames through the same judge."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil import session
from liftgate_hil.codec.frames import LOGGED, no_logged
from liftgate_hil.conditions import COLUMN
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.errors import ConfigError
from liftgate_hil.judging.judge import Expected, Judge
from liftgate_hil.judging.verdict import Verdict
from liftgate_hil.measurement.log_frames import read_frames
from liftgate_hil.measurement.read import BUS_LOGS, open_columns
from liftgate_hil.measurement.series import FRAME
from liftgate_hil.runs import tolerance_of
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH, Bench
from liftgate_hil.staging import expected_in
from liftgate_plant.vehicle import Vehicle

_BLOCK = 20_000  # rows that are made at a time
_LATEST = 1e6  # s; a stamp beyond it is a wall clock's
_RASTER = 1e-3  # s, of a log's rows where there is no table

Floats = NDArray[np.float64]


def judge(
    recordings: Sequence[str | Path],
    scenario: str | Path | Scenario,
    *,
    parameters: Mapping[str, float] | None = None,
    vehicle: str | Path | Vehicle | None = None,
    rig: str | Path | Rig | None = None,
    duration: float | None = None,
) -> dict[str, Verdict]:
    """The verdicts of a scenario's expectations, by their names, from the recordings of one run: a table (CSV,
    Parquet, MF4, MCAP), a bus log, or both. What was not recorded makes inconclusive. `duration` [s] is the run's
    end where it was not the scenario's. Stamps count from the run's start.

    Raises ConfigError.
    """
    setup = session.setup_of(scenario, parameters=parameters, vehicle=vehicle)
    chosen = session.rig_of(rig, setup.scenario)
    expected = expected_in(setup, chosen)
    if not expected.expectations:
        raise ConfigError(f"{setup.scenario.source}: expect: missing; allowed: [[expect]] tables")
    times, columns, frames = _content([Path(each) for each in recordings], expected, chosen)
    end = setup.scenario.duration if duration is None else duration
    last = float(times[-1])
    steps = np.diff(times)
    step = float(np.median(steps)) if len(steps) else _RASTER
    tolerance = tolerance_of(setup.scenario, chosen)
    found = Judge(expected, 1.0 / step, last if end is None else end, tolerance)
    for rows in _blocks(times, columns):
        found.take(rows, frames)
        frames = no_logged()
    gaps = [(float(times[k]), float(times[k + 1])) for k in np.flatnonzero(steps > 1.5 * step)]
    return {each.name: each for each in found.verdicts(gaps=gaps)}


def _content(
    paths: Sequence[Path], expected: Expected, rig: Rig
) -> tuple[Floats, dict[str, Floats], Any]:
    """Times and columns of the rows, and the frames."""
    wanted = {name for each in expected.conditions for name in each.names(COLUMN)} - {"time_s"}
    wanted |= {*Bench._fields, "pinch_force_n"}
    times: Floats | None = None
    columns: dict[str, Floats] = {}
    logs = []
    for path in paths:
        kind = path.suffix.lower()
        if kind not in BUS_LOGS:
            own, found, has_frames = _table(path, wanted)
            if own is not None:
                if times is not None:
                    raise ConfigError(f"{path}: a second table; allowed: one, and a bus log")
                times, columns = own, found
            if not has_frames:
                continue
        logs.append(_logged(path, expected, rig))
    frames = np.concatenate([no_logged(), *logs])
    if times is None:
        if not len(frames):
            raise ConfigError(f"{', '.join(map(str, paths))}: nothing of what is expected is in it")
        last = math.ceil(frames["time_ns"].max() * 1e-9 / _RASTER)
        times = np.arange(1, last + 1) * _RASTER
    return times, columns, frames


def _table(path: Path, wanted: set[str]) -> tuple[Floats | None, dict[str, Floats], bool]:
    """Times and columns of a table, None where it holds frames alone; and whether it holds any."""
    if path.suffix.lower() == ".parquet":
        return *_parquet(path, wanted), False
    file, issues = open_columns(path, (".csv", ".parquet", ".mf4", ".mcap", *BUS_LOGS)), list[str]()
    has_frames = FRAME in file.names
    there = [name for name in ("time_s", *sorted(wanted)) if name in file.names]
    if not there and has_frames:
        return None, {}, True
    series = file.read(there, issues)
    if issues:
        raise ConfigError(issues)
    first = next(iter(series.values()), None)
    times = series["time_s"].values if "time_s" in series else first.times if first else None
    if times is None or not len(times):
        raise ConfigError(f"{path}: time_s: missing; allowed: a recording with its times")
    return times, {name: each.values for name, each in series.items()}, has_frames


def _parquet(path: Path, wanted: set[str]) -> tuple[Floats, dict[str, Floats]]:
    try:
        from pyarrow import parquet
    except ImportError as error:
        raise ConfigError(
            f"{path}: Parquet needs pyarrow; allowed after: pip install 'liftgate-hil[parquet]'"
        ) from error
    try:
        names = parquet.read_schema(path).names
        there = [name for name in ("time_s", *sorted(wanted)) if name in names]
        table = parquet.read_table(path, columns=there)
        found = {name: np.array(table[name].to_numpy(), dtype=np.float64) for name in there}
    except Exception as error:  # pyarrow's readers raise errors of their own
        raise ConfigError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    if not len(found.get("time_s", ())):
        raise ConfigError(f"{path}: time_s: missing; allowed: a recording with its times")
    return found["time_s"], found


def _logged(path: Path, expected: Expected, rig: Rig) -> Any:
    """The frames of a log that the expectations speak of, as the loop notes them."""
    names = list(dict.fromkeys(name.partition(".")[0] for name in expected.signals))
    times, frames, _ = read_frames(path, names, rig)
    if len(times) and times.max() > _LATEST:
        raise ConfigError(
            f"{path}: stamps of a wall clock ({times.max():.0f} s); allowed: seconds since the run's start, as "
            "the clocks free and lockstep, and MF4 and MCAP, have them"
        )
    rows = np.zeros(len(times), dtype=LOGGED)
    rows["time_ns"] = np.round(times * 1e9).astype(np.int64)
    rows["identifier"] = frames.identifiers[: len(times)]
    rows["length"] = frames.lengths[: len(times)]
    rows["payload"] = frames.data[: len(times)]
    return rows


def _blocks(times: Floats, columns: Mapping[str, Floats]) -> Iterator[Floats]:
    """Rows (n, ROW_WIDTH), NaN where nothing was recorded."""
    for first in range(0, len(times), _BLOCK):
        part = slice(first, first + _BLOCK)
        rows = np.full((len(times[part]), ROW_WIDTH), math.nan)
        for name, values in columns.items():
            rows[:, COLUMN_PLACE[name]] = values[part]
        rows[:, COLUMN_PLACE["time_s"]] = times[part]
        yield rows
