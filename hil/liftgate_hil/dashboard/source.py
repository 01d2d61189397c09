"""Data sources of a page: `NoSource` below, a run and a recording have the same methods."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.dashboard.page_state import AboutSource, Curves, GateGeometry, Numbers, PageState
from liftgate_hil.errors import ConfigError
from liftgate_hil.loop.histogram import Quantiles
from liftgate_hil.signals import COLUMNS, SENSED_PREFIX, Bench

Floats = NDArray[np.float64]

MOST_POINTS = 4000  # of a curve
MOST_LINES = 200  # of the log that are kept for a viewer


class NoSource:
    """Data source of a page that shows nothing yet."""

    def about(self) -> AboutSource:
        """Return that there is neither a run nor a recording."""
        return {"kind": "none", "columns": [], "units": {}, "meanings": {}}

    def geometry(self) -> GateGeometry:
        """Return none."""
        return {}

    def state(self, time: float | None = None) -> PageState:
        """Return the phase `idle`, and nothing else."""
        return nothing_known("idle")

    def plot(self, columns: Sequence[str], begin: float, end: float, points: int) -> Curves:
        """Return no curves."""
        return {"time_s": [], "low": {}, "high": {}}


def nothing_known(phase: str) -> PageState:
    """Return a state of which no more than the phase is known, with all keys but `number`."""
    return {
        "phase": phase, "end": None, "time_s": None,
        "truth": {}, "sensed": {}, "command": {}, "loop": {}, "bus": {}, "in_force": {}, "acting": {},
        "histograms": {}, "verdicts": [], "messages": [], "log": [], "alarms": [],
    }  # fmt: skip


def places_of(wanted: Sequence[str], names: list[str]) -> list[int]:
    """Return the places of the wanted columns among `names`. Raises ConfigError for an unknown column."""
    unknown = [name[:80] for name in wanted if name not in names]
    if unknown:
        raise ConfigError(f"columns {', '.join(unknown)}: no such columns; allowed: those of /api/about")
    return [names.index(name) for name in wanted]


def curves_of(wanted: Sequence[str], times: Floats, low: Floats, high: Floats, most: int) -> Curves:
    """Return curves of the wanted columns, of which `low` and `high` have (n, wanted); `most` points at most."""
    every = max(1, -(-len(times) // most))
    if every > 1:
        starts = np.arange(0, len(times), every)
        with np.errstate(all="ignore"):
            low, high = np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)
        times = times[np.append(starts[1:] - 1, len(times) - 1)]
    return {
        "time_s": times.tolist(),
        "low": dict(zip(wanted, low.T.tolist(), strict=True)),
        "high": dict(zip(wanted, high.T.tolist(), strict=True)),
    }


def split(names: list[str], values: list[float]) -> tuple[Numbers, Numbers]:
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


def times_of(figures: Quantiles) -> Numbers | None:
    """Return a distribution of durations [µs]; None: there are none."""
    return figures._asdict() if figures.count else None
