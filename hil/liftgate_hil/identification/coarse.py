"""A coarse problem with few rows for the start of the search, whose first steps are large and need not be exact.

Samples and steps are as far apart as the model's steps may be. Inputs that change seldom keep the times of their
changes; inputs that change at every row, such as a measured voltage, are averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.identification.data import Data, Decimation, Floats
from liftgate_hil.identification.problem import Problem
from liftgate_plant.rows import AT

Rows = NDArray[np.intp]

_SPACING = 5e-3  # s, the longest step that the models tolerate
_LEAST_STEPS = 5000  # steps of a simulation below which there is nothing to save
_SAVES = 2.5  # factor by which the steps shall be reduced, at least
_FLAGS = (AT.left_coast, AT.right_coast, AT.latch_released)


def coarse_of(problem: Problem) -> tuple[Problem, list[int]] | None:
    """Return (the problem with few rows and the same unknowns, indices of outputs kept); None: it saves little.

    That is where the problem has few rows already, or where too few steps would be saved.
    """
    steps = _steps(problem.data, problem.longest)
    if steps < _LEAST_STEPS:
        return None
    data = [_coarse(each, changes) for each, changes in zip(problem.data, problem.changes, strict=True)]
    if _SAVES * _steps(data, _SPACING) > steps:
        return None
    coarse = problem.on(data, longest=_SPACING)
    return coarse, coarse.leave_out_few()


def _steps(data: Sequence[Data], longest: float) -> float:
    """Return the number of steps of a simulation of all experiments, each at most `longest` [s]."""
    return sum(max(float(len(each.rows)), float(np.ptp(each.rows)) / longest) for each in data)


def _coarse(data: Data, changes: Rows) -> Data:
    """Return an experiment's data at the coarse spacing; inputs keep rows `changes` if few, else are averaged."""
    rows = data.rows
    kept = _apart(rows, np.arange(len(rows)))
    places = {
        name: _apart(data.times, np.flatnonzero(np.isfinite(values))) for name, values in data.outputs.items()
    }
    shown = np.unique(np.concatenate([[0, len(data.times) - 1], *places.values()]))
    outputs = {name: np.full(len(shown), np.nan) for name in places}
    for name, own in places.items():
        outputs[name][np.searchsorted(shown, own)] = data.outputs[name][own]
    if len(changes) <= len(kept):
        kept = np.union1d(kept, changes)
        inputs = data.inputs[kept]
    else:
        inputs = np.add.reduceat(data.inputs, kept) / np.diff(kept, append=len(rows))[:, None]
        inputs[:, _FLAGS] = np.rint(inputs[:, _FLAGS])
    times = data.times[shown]
    return replace(
        data, times=times, inputs=inputs, outputs=outputs, decimation=Decimation(rows[kept], times), whole=None
    )


def _apart(times: Floats, places: Rows) -> Rows:
    """Return the indices `places` into `times`, thinned to the coarse spacing, always with the last one."""
    if len(places) < 2:
        return places
    usual = float(np.median(np.diff(times[places])))
    every = max(1, round(_SPACING / usual))
    return np.append(places[:-1:every], places[-1])
