"""Figure of a run's phase portrait: gate rate over gate angle, opening and closing distinguished."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.conversion.figures.subject import Columns, Drawn, FigureSubject, complete, taken
from liftgate_hil.conversion.sheet import FONT, finish, legend_above, sheet
from liftgate_hil.conversion.table import Floats
from liftgate_hil.errors import ConfigError
from liftgate_hil.report.drawing import FINAL, INITIAL, INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NEEDED = ("gate_angle_deg", "gate_rate_degps")
_MOST = 4000  # points of the curve
_SAME = 0.02  # share of an axis within which start and end coincide
_PAPER = {"facecolor": "white", "edgecolor": "none", "pad": 1.0, "alpha": 0.8}
_CAPTION = (
    "Each point is an instant. Above zero the gate opens and the point moves to the right, below zero it closes "
    "and moves to the left; on the line it stands still."
)


def draw(subject: FigureSubject) -> Drawn:
    """Draw the gate's rate over its angle, with start and end of the time window marked. Raises ConfigError."""
    found, remark = taken(subject, _NEEDED)
    columns = complete(found, _NEEDED)
    if not len(columns["time_s"]):
        raise ConfigError(f"{subject.recording().path}: {', '.join(_NEEDED)}: no values; allowed: numbers")
    columns = _thinned(columns)
    times, angles, rates = (columns[name] for name in ("time_s", *_NEEDED))
    caption = f"{_CAPTION} {remark}".strip()
    with sheet(7.0, subject.title) as figure:
        axis = figure.subplots()
        axis.axhline(0.0, color=INK, linewidth=0.8, zorder=1)
        _draw_part(axis, angles, rates, rates > 0.0, "opening", FINAL, "-")
        _draw_part(axis, angles, rates, rates < 0.0, "closing", INITIAL, (0, (4, 2)))
        _mark(axis, (angles[0], rates[0]), (angles[-1], rates[-1]), (times[0], times[-1]))
        axis.set_xlabel("gate angle [deg]")
        axis.set_ylabel("gate rate [deg/s]")
        legend_above(axis)
        finish(figure, caption)
    return Drawn(figure, caption)


def _thinned(columns: Columns) -> Columns:
    """Return at most _MOST rows, evenly spaced along the path, as most rows are of the gate at rest."""
    angles, rates = (columns[name] for name in _NEEDED)
    if len(angles) <= _MOST:
        return columns
    shares = [np.diff(each) / (np.ptp(each) or 1.0) for each in (angles, rates)]
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*shares))])
    places = np.floor(way / (way[-1] or 1.0) * (_MOST - 2))
    kept = np.append(np.diff(places) > 0.0, True)
    kept[0] = True
    return {name: values[kept] for name, values in columns.items()}


def _draw_part(
    axis: Axes, angles: Floats, rates: Floats, moves: NDArray[np.bool_], label: str, colour: str, dashes: object
) -> None:
    """Draw the rows in which the gate moves in one direction, and the rows just before and after."""
    shown = moves.copy()
    shown[1:] |= moves[:-1]
    shown[:-1] |= moves[1:]
    values = np.where(shown, rates, np.nan)
    axis.plot(angles, values, color=colour, linestyle=dashes, linewidth=1.8, label=label)


def _mark(axis: Axes, start: tuple[float, float], end: tuple[float, float], times: tuple[float, float]) -> None:
    """Mark and label start and end of the path; a ring around a square shows both where they coincide."""
    looks: dict[str, Any] = {"color": INK, "linestyle": "none", "zorder": 5}
    axis.plot(*([each] for each in start), marker="o", markersize=11, fillstyle="none", mew=1.8, **looks)
    axis.plot(*([each] for each in end), marker="s", markersize=5, **looks)
    axis.margins(0.07, 0.12)
    spans = (np.ptp(axis.get_xlim()), np.ptp(axis.get_ylim()))
    is_same = all(abs(a - b) < _SAME * span for a, b, span in zip(start, end, spans, strict=True))
    begin, stop = f"start, {times[0]:.3g} s", f"end, {times[1]:.3g} s"
    for place, text, up in ((start, begin, 12.0), (end, stop, -22.0)):
        both = f"{begin}; {stop}" if is_same and place is start else text
        if is_same and place is end:
            break
        axis.annotate(both, place, (10.0, up), textcoords="offset points", fontsize=FONT, bbox=_PAPER, zorder=6)
