"""Common functions of a page's data sources (run, recording, none), and `NoSource`, which shows nothing."""

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
    """Data source of a page that shows neither a run nor a recording yet."""

    def about(self) -> AboutSource:
        """Return the description of the empty source: neither a run nor a recording."""
        return {"kind": "none", "columns": [], "units": {}, "meanings": {}}

    def geometry(self) -> GateGeometry:
        """Return an empty geometry."""
        return {}

    def state(self, time: float | None = None) -> PageState:
        """Return the state with the phase `idle`, and without values."""
        return nothing_known("idle")

    def plot(self, columns: Sequence[str], begin: float, end: float, points: int) -> Curves:
        """Return no curves."""
        return {"time_s": [], "low": {}, "high": {}}


def nothing_known(phase: str) -> PageState:
    """Return a state with a given phase and no values; it lacks `number`, `started` and keys of streams."""
    return {
        "phase": phase, "end": None, "time_s": None,
        "truth": {}, "sensed": {}, "command": {}, "loop": {}, "bus": {}, "in_force": {}, "acting": {},
        "histograms": {}, "verdicts": [], "messages": [], "log": [], "alarms": [],
    }  # fmt: skip


def places_of(wanted: Sequence[str], names: list[str]) -> list[int]:
    """Return the indices of the wanted columns in `names`. Raises ConfigError for an unknown column."""
    unknown = [name[:80] for name in wanted if name not in names]
    if unknown:
        raise ConfigError(f"columns {', '.join(unknown)}: no such columns; allowed: those of /api/about")
    return [names.index(name) for name in wanted]


def curves_of(wanted: Sequence[str], times: Floats, low: Floats, high: Floats, most: int) -> Curves:
    """Return curves of columns, each of at most `most` points, from their `low` and `high` values (n, wanted)."""
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
    """Split a row into true and sensed values, both by the true ones' names; those of the bench are left out."""
    truth, sensed = {}, {}
    for name, value in zip(names, values, strict=True):
        if name.startswith(SENSED_PREFIX):
            sensed[name.removeprefix(SENSED_PREFIX)] = value
        elif name not in Bench._fields:
            truth[name] = value
    return truth, sensed


def units_of(names: list[str]) -> dict[str, str]:
    """Return the units of columns, as in the catalogue; "" for unknown columns."""
    return {name: COLUMNS[name].unit if name in COLUMNS else "" for name in names}


def meanings_of(names: list[str]) -> dict[str, str]:
    """Return the meanings of columns, as in the catalogue; unknown columns are left out."""
    return {name: COLUMNS[name].meaning for name in names if name in COLUMNS}


def times_of(figures: Quantiles) -> Numbers | None:
    """Return the quantiles of a distribution of durations [µs] as a dict; None: no durations."""
    return figures._asdict() if figures.count else None
