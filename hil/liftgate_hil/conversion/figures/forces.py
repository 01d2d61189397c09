"""Figure of the torques on a resting gate over its angle, and of the torque that its drives can deliver."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.conversion.figures.subject import Drawn, FigureSubject
from liftgate_hil.conversion.sheet import finish, legend_above, sheet
from liftgate_hil.conversion.table import Floats
from liftgate_hil.report.drawing import DRIVES, FINAL, GRID, INITIAL, INK, MARK, PURPLE, SKY
from liftgate_plant import friction, gate, statics
from liftgate_plant.statics import CLOSING, OPENING, Balance, Rest, SteadyTurning

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_POINTS = 401
_NEAR = 4.0  # the panel near closed is this many times as wide as the seal acts
_PARTS: dict[str, tuple[str, str, Any, float]] = {
    "weight": ("weight", PURPLE, (0, (6, 2)), 2.0),
    "left_spring": ("left spring", *DRIVES["left"]),
    "right_spring": ("right spring", *DRIVES["right"]),
    "seal": ("seal", MARK, (0, (5, 1, 1, 1)), 1.8),
    "latch": ("latch", INITIAL, (0, (4, 1, 1, 1, 1, 1)), 1.6),
    "around": ("snow, wind, hand", SKY, (0, (1, 1)), 2.0),
    "net": ("sum of all", INK, "-", 1.6),
}


def draw(subject: FigureSubject) -> Drawn:
    """Draw the torques on the resting gate over its angle, enlarged where the seal acts. Raises ConfigError."""
    rest = statics.rest_of(subject.car())
    link = rest.plant.link
    travel = math.degrees(gate.angle_of_extension(link, link.stroke))
    near = _near_closed(rest, travel)
    stalled, rated = statics.turning(rest, 1.0), statics.most_efficient(rest)
    caption = f"Vehicle: {subject.vehicle_name}. {_caption(rest, stalled, rated)}"
    with sheet(8.6, subject.title, is_spaced=True) as figure:
        spans = [near, travel] if near else [travel]
        grid: Any = figure.subplots(
            2, len(spans), sharex="col", sharey="row", squeeze=False,
            width_ratios=(1.0, 2.6) if near else (1.0,), height_ratios=(1.35, 1.0),
        )  # fmt: skip
        for (above, below), span in zip(grid.T, spans, strict=True):
            angles = np.linspace(0.0, span, _POINTS)
            balance = statics.balance_over(rest, np.radians(angles))
            _draw_balance(above, angles, balance)
            _draw_drives(below, angles, rest, balance, stalled, rated)
            below.set_xlabel("gate angle [deg]" if span == travel else "gate angle near closed [deg]")
            above.set_xlim(0.0, span)
        grid[0, 0].set_ylabel("torque on the gate [N m]")
        grid[1, 0].set_ylabel("torque of the drives\non the gate [N m]")
        for row, title in zip(grid, ("what acts on it", "what the drives give"), strict=True):
            row[0].set_title(f"{title}\n", loc="left")  # the second line is for that of the legend
            legend_above(row[-1], columns=4).set_in_layout(False)
        finish(figure, caption)
    return Drawn(figure, caption)


def _near_closed(rest: Rest, travel: float) -> float:
    """Return the width [deg] of the panel near closed for the seal; 0: no seal, or half the travel or wider."""
    rubber, link = rest.plant.seal, rest.plant.link
    if rubber.force == 0.0 or rubber.stiffness == 0.0:
        return 0.0
    free = rubber.force / rubber.stiffness  # m, where it is free
    wide = _NEAR * math.degrees(gate.angle_of_extension(link, min(free, link.stroke)))
    return wide if wide < 0.5 * travel else 0.0


def _draw_balance(axis: Axes, angles: Floats, balance: Balance) -> None:
    """Draw each torque on the gate, their sum, and the band in which friction holds the gate."""
    axis.fill_between(
        angles, -balance.held_closing, balance.held_opening,
        facecolor="#eceff2", edgecolor="#b4bac2", hatch="///", linewidth=0.8, label="friction holds the sum",
    )  # fmt: skip
    for name, (label, colour, dashes, width) in _PARTS.items():
        values = getattr(balance, name)
        if np.any(values) or name == "net":
            (drawn,) = axis.plot(angles, values, color=colour, linestyle=dashes, linewidth=width, label=label)
            if name == "net":
                drawn.set(marker="o", markevery=_POINTS // 8, markersize=5)
    axis.axhline(0.0, color=GRID, linewidth=1.0, zorder=0)


def _draw_drives(
    axis: Axes, angles: Floats, rest: Rest, balance: Balance, stalled: SteadyTurning, rated: SteadyTurning
) -> None:
    """Draw the drives' torque on the gate, stalled and rated, less their friction, and what the gate needs."""
    for along, word, colour in ((OPENING, "opening", FINAL), (CLOSING, "closing", INITIAL)):
        for turning, how, dashes, width in ((stalled, "stalled", "-", 1.8), (rated, "rated", (0, (5, 2)), 1.8)):
            own = (along * turning.torques[0], along * turning.torques[1])
            values = [
                statics.drives_torque(rest, own, angle, along, turning.speed) for angle in balance.angles.tolist()
            ]
            label = f"{word}, {how}"
            marker = "^" if along == OPENING else "v"
            axis.plot(
                angles, values, color=colour, linestyle=dashes, linewidth=width, label=label,
                marker=marker, markevery=_POINTS // 8, markersize=5,
            )  # fmt: skip
    axis.plot(angles, -balance.net, color=INK, linestyle=(0, (1, 1)), linewidth=2.0, label="to balance the sum")
    axis.axhline(0.0, color=GRID, linewidth=1.0, zorder=0)


def _caption(rest: Rest, stalled: SteadyTurning, rated: SteadyTurning) -> str:
    load, hinge = rest.load, friction.level(rest.plant.hinge, 0.0)
    drives = "both drives" if rest.plant.right.active else "the drive"
    return (
        f"At rest, latch released, slope {math.degrees(load.road_slope):g} deg, {load.ambient_temperature:g} °C, "
        f"supply {load.supply_voltage:g} V; positive opens. Where the sum is inside the hatched band, the "
        f"friction of {drives}{' and hinge' if hinge else ''} holds the gate without current; above it the gate "
        f"opens by itself, below it closes. What the drives give is less their own friction: stalled with "
        f"{stalled.currents[0]:.1f} A per motor; rated, where they are most efficient, as the vehicle file names "
        f"no rated current, with {rated.currents[0]:.1f} A at {rated.speed:.0f} rev/s. They start the gate where "
        f"they are beyond the dotted line{' by the friction of the hinge' if hinge else ''}."
    )
