"""Figure of a gate at rest over the road's slope: where it holds by itself, and which supply voltage moves it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.conversion.figures.subject import Drawn, FigureSubject
from liftgate_hil.conversion.sheet import FONT, finish, legend_above, sheet
from liftgate_hil.conversion.table import Floats
from liftgate_hil.report.drawing import FINAL, INITIAL, INK, MEASURED
from liftgate_plant import gate, statics
from liftgate_plant.statics import Rest, StaticMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SLOPE, _VOLTAGE = 20.0, 16.0  # deg and V, to where the map reaches at least
_POINTS = 81  # along slopes and voltages
_MOST = 1e9  # N m, more than any margin
# Areas: meaning, colour, hatch.
_ALONE: tuple[tuple[str, str, str], ...] = (
    ("stays where it is left", "#ffffff", ""),
    ("opens by itself", "#cfe4f3", "///"),
    ("closes by itself", "#f8dcc6", "\\\\\\"),
)
_DRIVEN: tuple[tuple[str, str, str], ...] = (
    ("starts opening and closing", "#d3eee4", ""),
    ("starts opening only", "#cfe4f3", "///"),
    ("starts closing only", "#f8dcc6", "\\\\\\"),
    ("starts neither", "#e4e6e9", "xx"),
)


def draw(subject: FigureSubject) -> Drawn:
    """Draw where the gate at rest moves alone (slope, angle), and driven (slope, supply). Raises ConfigError."""
    rest = statics.rest_of(subject.car())
    found = map_of(rest)
    caption = f"Vehicle: {subject.vehicle_name}. {_caption(rest)}"
    with sheet(8.8, subject.title) as figure:
        alone, driven = figure.subplots(2, 1, sharex=True)
        slopes = np.degrees(found.slopes)
        _draw_areas(alone, slopes, np.degrees(found.angles), (found.opens, found.closes), _ALONE, (1, 2, 0, 0))
        _draw_areas(
            driven, slopes, found.voltages, (found.starts_opening, found.starts_closing), _DRIVEN, (1, 2, 0, 3)
        )
        alone.set_ylabel("gate angle [deg]")
        alone.set_title("left alone, without current", loc="left")
        driven.set_ylabel("supply voltage [V]")
        driven.set_title("driven at full duty", loc="left")
        driven.set_xlabel("slope of the road [deg], positive with the rear raised")
        for margins, word, side in (
            (found.starts_opening, "open", "left"),
            (found.starts_closing, "close", "right"),
        ):
            _name_least(driven, slopes, found.voltages, margins, f"least supply to {word}", side)
        slope, supply = math.degrees(rest.load.road_slope), rest.load.supply_voltage
        driven.plot([slope], [supply], "o", color=INK, markersize=8, fillstyle="none", mew=1.8, zorder=6)
        driven.annotate(
            f"the vehicle: {slope:g} deg, {supply:g} V", (slope, supply), (10, 6),
            textcoords="offset points", fontsize=FONT, bbox=_PAPER, zorder=6,
        )  # fmt: skip
        finish(figure, caption)
    return Drawn(figure, caption)


_PAPER: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 1.5, "alpha": 0.9}


def map_of(rest: Rest) -> StaticMap:
    """Return the static map to draw: over slopes, angles (dense near closed) and supply voltages."""
    link = rest.plant.link
    travel = gate.angle_of_extension(link, link.stroke)
    slope = max(math.radians(_SLOPE), 1.1 * abs(rest.load.road_slope))
    near = min(math.radians(2.0), 0.5 * travel)
    angles = np.concatenate([np.linspace(0.0, near, 41), np.linspace(near, travel, _POINTS)[1:]])
    voltages = np.linspace(0.0, max(_VOLTAGE, 1.25 * rest.load.supply_voltage), _POINTS)
    return statics.map_over(rest, np.linspace(-slope, slope, _POINTS), angles, voltages)


def _draw_areas(
    axis: Axes,
    across: Floats,
    up: Floats,
    margins: tuple[Floats, Floats],
    looks: tuple[tuple[str, str, str], ...],
    which: tuple[int, int, int, int],
) -> None:
    """Fill the areas of the signs of two margins (across, up) with colour and hatch, and draw their borders.

    `which` are the indices in `looks` where the first alone, the second alone, both, and none are positive.
    """
    from matplotlib.patches import Patch

    first, second = margins
    only_first, only_second, both, none = which
    _fill(axis, across, up, np.ones_like(first), looks[none])
    _fill(axis, across, up, np.minimum(first, -second), looks[only_first])
    _fill(axis, across, up, np.minimum(second, -first), looks[only_second])
    _fill(axis, across, up, np.minimum(first, second), looks[both])
    for margin, colour, dashes in ((first, FINAL, "-"), (second, INITIAL, "--")):
        axis.contour(across, up, margin.T, levels=[0.0], colors=colour, linestyles=dashes, linewidths=1.6)
    axis.set_axisbelow(False)  # the grid over the areas
    axis.grid(visible=True, alpha=0.8)
    handles = [
        Patch(facecolor=colour, hatch=hatch, edgecolor=MEASURED, label=label) for label, colour, hatch in looks
    ]
    legend_above(axis, handles)


def _name_least(axis: Axes, slopes: Floats, voltages: Floats, margins: Floats, text: str, end: str) -> None:
    """Label the line on which a margin over (slopes, voltages) is 0, at its left or right end, if it exists."""
    column = len(slopes) // 16 if end == "left" else len(slopes) - 1 - len(slopes) // 16
    above = np.flatnonzero(margins[column] > 0.0)
    if len(above) and above[0] > 0:
        place = slopes[column], voltages[above[0]]
        axis.annotate(
            text, place, (0, 4), textcoords="offset points", fontsize=FONT, bbox=_PAPER, zorder=6, ha=end
        )


def _fill(axis: Axes, across: Floats, up: Floats, margin: Floats, look: tuple[str, str, str]) -> None:
    """Fill the area in which a margin over (across, up) is positive; `look`: meaning, colour, hatch."""
    _, colour, hatch = look
    areas = axis.contourf(across, up, margin.T, levels=[0.0, _MOST], colors=[colour], hatches=[hatch])
    areas.set_edgecolor(MEASURED)
    areas.set_linewidth(0.0)


def _caption(rest: Rest) -> str:
    return (
        f"From rest, latch released, {rest.load.ambient_temperature:g} °C. The gate opens (closes) by itself "
        "where springs, weight and seal exceed what the friction of drives and hinge holds at rest; the strip at "
        "0 deg is the seal's. Driven, it starts where the stalled drives exceed both at every angle from closed "
        "to open."
    )
