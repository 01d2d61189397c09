"""Key figures of a variant's run (forces, times, currents): columns of a campaign's results."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.described_result import Shown
from liftgate_hil.report.pinch import pinch_event
from liftgate_hil.signals import COLUMN_PLACE


class Figures(NamedTuple):
    """Key figures of a run; NaN: undefined, e.g. where nothing was pinched or the gate did not reverse.

    Figures of a pinch are of the contact with the largest force; see `report.pinch`.
    """

    peak_pinch_force_n: Annotated[float, Shown("N, largest pinch force; 0: nothing was pinched")]
    reversal_time_s: Annotated[float, Shown("s, from the first touch to where the gate turned; null: it did not")]
    reversal_distance_deg: Annotated[float, Shown("deg, by which the gate went on after the first touch")]
    peak_current_a: Annotated[float, Shown("A, largest current of either motor")]
    contact_angle_deg: Annotated[float, Shown("deg, gate angle at the first touch")]
    current_rise_a: Annotated[float, Shown("A, rise of a motor's current from the first touch to the turn")]
    pinch_impulse_ns: Annotated[float, Shown("N s, impulse of the last contact")]
    over_limit_s: Annotated[float, Shown("s, longest time of a contact above the vehicle's gate.pinch_limit")]


NO_FIGURES = Figures(*(math.nan,) * len(Figures._fields))
_KEPT = (
    "time_s",
    "gate_angle_deg",
    "gate_rate_degps",
    "pinch_force_n",
    "left_current_a",
    "right_current_a",
    "pinch_impulse_ns",
    "pinch_over_limit_s",
)
_PLACES = [COLUMN_PLACE[name] for name in _KEPT]


class FigureSink:
    """Sink of a run's rows that keeps the columns for its figures, in memory reused by the next run."""

    def __init__(self) -> None:
        self._columns = np.empty((len(_KEPT), 0))
        self._count = 0  # of the rows so far

    def begins_anew(self) -> None:
        """Discard all rows before the next run."""
        self._count = 0

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Append the columns that the figures need, from rows (n, ROW_WIDTH), to those so far; skip frames."""
        first, last = self._count, self._count + len(rows)
        if last > self._columns.shape[1]:
            larger = np.empty((len(_KEPT), 2 * last))
            larger[:, :first] = self._columns[:, :first]
            self._columns = larger
        for column, place in zip(self._columns, _PLACES, strict=True):
            column[first:last] = rows[:, place]
        self._count = last

    def figures(self) -> Figures:
        """Return the key figures of the run, from all rows so far."""
        return figures_of(dict(zip(_KEPT, self._columns[:, : self._count], strict=True)))


def figures_of(columns: Mapping[str, NDArray[np.float64]]) -> Figures:
    """Compute the key figures of a run from its columns, (n,) each."""
    if not len(columns["time_s"]):
        return NO_FIGURES
    currents = np.abs(np.stack([columns["left_current_a"], columns["right_current_a"]]))
    peak = float(columns["pinch_force_n"].max())
    event = pinch_event(columns) if peak > 0.0 else None
    if event is None:
        return NO_FIGURES._replace(
            peak_pinch_force_n=peak, peak_current_a=float(currents.max()), pinch_impulse_ns=0.0, over_limit_s=0.0
        )
    until = event.time_s if math.isnan(event.turn_s) else event.turn_s
    first, last = np.searchsorted(columns["time_s"], (event.start_s, until))
    pinched = currents[:, first : max(last, first) + 1]
    return Figures(
        peak_pinch_force_n=event.force_n,
        reversal_time_s=event.reversal_time_s,
        reversal_distance_deg=event.further_deg,
        peak_current_a=float(currents.max()),
        contact_angle_deg=event.start_deg,
        current_rise_a=float((pinched.max(axis=1) - pinched[:, 0]).max()),
        pinch_impulse_ns=float(columns["pinch_impulse_ns"].max()),
        over_limit_s=float(columns["pinch_over_limit_s"].max()),
    )
