"""Figure of the contact with the largest pinch force: force and limit, gate angle, motor currents."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.conversion.figures.subject import Columns, Drawn, FigureSubject, complete, taken
from liftgate_hil.conversion.sheet import FONT, finish, legend_above, sheet
from liftgate_hil.errors import ConfigError
from liftgate_hil.report.drawing import INITIAL, INK
from liftgate_hil.report.pinch import PinchEvent, pinch_event
from liftgate_hil.report.run_plot import (
    FORCE,
    RunPicture,
    draw_angle,
    draw_drives,
    draw_force,
    draw_reversal,
    window_of,
)
from liftgate_plant.pinch import NOT_PINCHED, Pinch, pressed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NEEDED = ("gate_angle_deg", "gate_rate_degps", "pinch_force_n")


def draw(subject: FigureSubject) -> Drawn:
    """Draw force, angle and currents around the largest contact, on one time axis. Raises ConfigError."""
    path, limit = subject.recording().path, subject.car().gate.pinch_limit
    found, remark = taken(subject, [*_NEEDED, "left_current_a"], ["right_current_a"])
    columns = complete(found, _NEEDED)
    event = pinch_event(columns) if len(columns["time_s"]) else None
    if event is None:
        raise ConfigError(f"{path}: pinch_force_n: nothing was pinched; allowed: a recording with a contact")
    contact = contact_of(columns, event, limit)
    picture = RunPicture(subject.title, columns, event).between(*window_of(event))
    caption = (
        f"The contact with the largest force. Limit: {limit:g} N, gate.pinch_limit of {subject.vehicle_name}; no "
        "regulation gives one for power lift gates (UN R21 has 100 N for windows). Impulse and time over the "
        f"limit are those of this contact, from its rows. {remark}"
    ).strip()
    with sheet(8.2, subject.title) as figure:
        force, angle, current = figure.subplots(3, 1, sharex=True, height_ratios=(1.8, 1.0, 1.0))
        _draw_force(force, picture, event, contact, limit)
        draw_angle(angle, picture)
        draw_reversal(angle, event)
        draw_drives(current, picture, "_current_a", "motor current [A]")
        legend_above(current)
        for axis in (force, angle, current):
            for time in (event.start_s, event.turn_s):
                if np.isfinite(time):
                    axis.axvline(time, color=INK, linewidth=0.9, linestyle=":")
        current.set_xlim(*window_of(event))
        current.set_xlabel("time [s]")
        finish(figure, caption)
    return Drawn(figure, caption)


def contact_of(columns: Columns, event: PinchEvent, limit: float) -> Pinch:
    """Return a contact's peak force, its impulse, and its time over a limit [N], summed over rows as in the plant.

    Between rows the force is taken as a straight line, also from the row before the first touch.
    """
    times, forces = columns["time_s"], columns["pinch_force_n"]
    first, last = np.searchsorted(times, (event.start_s, event.end_s)).tolist()
    contact = NOT_PINCHED
    for row in range(max(first, 1), last + 1):
        length = float(times[row] - times[row - 1])
        contact = pressed(contact, float(forces[row - 1]), float(forces[row]), 0.0, length, limit)
    return contact


def _draw_force(axis: Axes, picture: RunPicture, event: PinchEvent, contact: Pinch, limit: float) -> None:
    """Draw the pinch force with its limit, the excess over the limit, and the contact's numbers."""
    times, forces = picture.columns["time_s"], picture.columns["pinch_force_n"]
    draw_force(axis, picture)
    axis.fill_between(
        times, limit, forces, where=forces > limit, interpolate=True,
        facecolor="#f1d3e8", edgecolor=FORCE, hatch="///", linewidth=0.0,
    )  # fmt: skip
    axis.axhline(limit, color=INITIAL, linewidth=1.5, linestyle="--", label=f"limit {limit:g} N")
    axis.plot([event.time_s], [event.force_n], "o", color=FORCE, markersize=7, zorder=5)
    axis.set_ylim(0.0, 1.3 * max(event.force_n, limit))
    margin = limit - event.force_n
    side = "below" if margin >= 0.0 else "over"
    text = (
        f"peak {event.force_n:.1f} N at {event.time_s:.3f} s, {abs(margin):.1f} N {side} the limit\n"
        f"over the limit for {1e3 * contact.over:.0f} ms, impulse {contact.impulse:.2f} N s"
    )
    axis.text(0.99, 0.98, text, transform=axis.transAxes, ha="right", va="top", fontsize=FONT)
    beside: dict[str, Any] = {
        "transform": axis.get_xaxis_transform(),
        "rotation": 90,
        "ha": "right",
        "fontsize": FONT,
    }
    axis.text(event.start_s, 0.06, "first touch", va="bottom", **beside)
    if np.isfinite(event.turn_s):
        axis.text(event.turn_s, 0.98, "turned", va="top", **beside)
    legend_above(axis)
