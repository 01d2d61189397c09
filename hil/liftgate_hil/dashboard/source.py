"""Data sources of a page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError
from liftgate_hil.loop.histogram import Quantiles
from liftgate_hil.signals import COLUMNS, SENSED_PREFIX, Bench

JsonObject = dict[str, Any]  # a JSON object
MOST_POINTS = 4000  # of a curve
MOST_LINES = 200  # of the log that are kept for a viewer
# What a state of a run holds.
STATE = {
    "phase": "`compiling`, `ready` (before time 0), `running`, `late` (ticks were missed in the last two seconds, "
    "or the run stands still), `ended`; of a recording `recorded`, without a run `idle`",
    "end": "how the run has ended: `verdict`, `ending`, `reason`, `expectations`, `exit_code`, its largest pinch "
    "force; null: it has not",
    "time_s": "model time [s]",
    "truth": "true values of the columns",
    "sensed": "what the ECU's sensors report, by the same names",
    "command": "the ECU's last command: `value` or its label, `unit` and `signal` of each quantity in the rig",
    "loop": "clock, rate, ticks done and missed; lateness, execution time and command delay [µs] as quantiles",
    "bus": "channel, load, frames sent, received, accepted, rejected, foreign, dropped; age of the last command",
    "in_force": "what was commanded and has not been cleared, in the form of commands",
    "acting": "what acts on the gate, from the scenario, a panel or commands; of a recording the obstacle that "
    "the gate presses against, at its edge, without `meets`; empty: not known",
    "verdicts": "of each expectation the verdict so far (`pending`: undecided), margin and times; the bench's "
    "lateness may still change it",
    "messages": "the last frame of each message on the bus, decoded; in the stream five times a second",
    "histograms": "lateness, execution time and command delay as bars: from, to [µs], count; in the stream alike",
    "log": "lines: number, Unix time, text; in the stream those that are new",
    "alarms": "of these lines the latest that nobody may miss: the link is lost, or back; a recording has ended "
    "before its run",
    "number": "counts the runs that the page has shown: another one begins with another number",
}


class PageSource(Protocol):
    """Data source of a page: a run, a recording, or none."""

    def about(self) -> JsonObject:
        """Return what the source is, its columns with their units, and what can be commanded."""

    def geometry(self) -> JsonObject:
        """Return the vehicle's geometry, see `geometry_of`; empty where it is not known."""

    def state(self, time: float | None = None) -> JsonObject:
        """Return the latest state, or that at a time [s] of a recording: see `GET /api/state`."""

    def plot(self, columns: Sequence[str], begin: float, end: float, points: int) -> JsonObject:
        """Return curves of columns between two times [s], in at most that many stretches.

        `time_s` holds the stretches' ends, `low` and `high` by column the lowest and highest value in each. Raises
        ConfigError for a column that there is not.
        """


class NoSource:
    """Data source of a page that shows nothing yet."""

    def about(self) -> JsonObject:
        """Return that there is neither a run nor a recording."""
        return {"kind": "none", "columns": [], "units": {}, "meanings": {}}

    def geometry(self) -> JsonObject:
        """Return none."""
        return {}

    def state(self, time: float | None = None) -> JsonObject:
        """Return the phase `idle`, and nothing else."""
        return nothing_known("idle")

    def plot(self, columns: Sequence[str], begin: float, end: float, points: int) -> JsonObject:
        """Return no curves."""
        return {"time_s": [], "low": {}, "high": {}}


def nothing_known(phase: str) -> JsonObject:
    """Return a state of which no more than the phase is known, with the keys of STATE but `number`."""
    tables = ("truth", "sensed", "command", "loop", "bus", "in_force", "acting", "histograms")
    return {
        "phase": phase,
        "end": None,
        "time_s": None,
        **{name: {} for name in tables},
        **{name: [] for name in ("verdicts", "messages", "log", "alarms")},
    }


def check_columns(wanted: Sequence[str], known: Sequence[str]) -> None:
    """Raise ConfigError unless all of these columns are known."""
    unknown = [name[:80] for name in wanted if name not in known]
    if unknown:
        raise ConfigError(f"columns {', '.join(unknown)}: no such columns; allowed: those of /api/about")


def in_stretches(
    times: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], most: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return at most so many stretches of rows: their ends (m,), lowest and highest values (m, columns)."""
    every = max(1, -(-len(times) // most))
    starts = np.arange(0, len(times), every)
    if every == 1 or not len(times):
        return times, low, high
    ends = np.append(starts[1:] - 1, len(times) - 1)
    with np.errstate(all="ignore"):
        return times[ends], np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def split(names: list[str], values: list[float]) -> tuple[JsonObject, JsonObject]:
    """Return a row's true and sensed values, by the same names."""
    truth, sensed = {}, {}
    for name, value in zip(names, values, strict=True):
        if name.startswith(SENSED_PREFIX):
            sensed[name.removeprefix(SENSED_PREFIX)] = value
        elif name not in Bench._fields:
            truth[name] = value
    return truth, sensed


def units_of(names: list[str]) -> dict[str, str]:
    """Return the unit of each column of the catalogue."""
    return {name: COLUMNS[name].unit if name in COLUMNS else "" for name in names}


def meanings_of(names: list[str]) -> dict[str, str]:
    """Return what each column of the catalogue means; other columns are left out."""
    return {name: COLUMNS[name].meaning for name in names if name in COLUMNS}


def times_of(figures: Quantiles) -> JsonObject | None:
    """Return a distribution of durations [µs]; None: there are none."""
    return figures._asdict() if figures.count else None
