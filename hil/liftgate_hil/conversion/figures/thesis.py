"""Figure of a run, arranged like the figures of the thesis.

Voltage and current are in one plot (figure 4.5), below it motor speed and position (figures 4.6 to 4.10), and what
the thesis's model computes besides: gate angle and drive force.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.conversion.figures.subject import Columns, Drawn, FigureSubject, taken
from liftgate_hil.conversion.sheet import finish, legend_above, sheet
from liftgate_hil.report.drawing import DRIVES, GRID, INK, MARK, MEASURED, line
from liftgate_hil.report.run_plot import hall_speed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ENDINGS = ("_voltage_v", "_current_a", "_hall_count", "_force_n")
_VOLTAGES: dict[str, tuple[str, Any, float]] = {
    "left": (MEASURED, "-", 2.2), "right": (INK, (0, (1, 1.5)), 1.2),
}  # fmt: skip
_CAPTION = (
    "After F. Boberg, Linköping 2008: figure 4.5 (voltage and current), figures 4.6 to 4.10 (current, speed, "
    "position below one another); gate angle and drive force are outputs of the same model. The speed is that of "
    "the Hall counts over 50 ms, as an ECU measures it. Positive opens."
)


def draw(subject: FigureSubject) -> Drawn:
    """Draw voltage, current, Hall speed, Hall count, gate angle and drive force over time. Raises ConfigError."""
    wanted = ["gate_angle_deg", *(f"left{ending}" for ending in _ENDINGS)]
    columns, remark = taken(subject, wanted, [f"right{ending}" for ending in _ENDINGS])
    speeds = {
        f"{side}_hall_speed": hall_speed(columns["time_s"], columns[f"{side}_hall_count"])
        for side in DRIVES
        if f"{side}_hall_count" in columns
    }
    columns = {**columns, **speeds}
    caption = f"{_CAPTION} {remark}".strip()
    with sheet(11.0, subject.title) as figure:
        axes = figure.subplots(5, 1, sharex=True, height_ratios=(1.7, 1.0, 1.0, 1.0, 1.0))
        electric, speed, position, angle, force = axes
        _draw_electric(electric, columns)
        for axis, ending, label in (
            (speed, "_hall_speed", "motor speed\n[Hall counts/s]"),
            (position, "_hall_count", "motor position\n[Hall counts]"),
            (force, "_force_n", "drive force\n[N]"),
        ):
            _draw_drives(axis, columns, ending, DRIVES)
            axis.set_ylabel(label)
            legend_above(axis)
        line(angle, columns["time_s"], columns["gate_angle_deg"], MARK, linewidth=1.6)
        angle.set_ylabel("gate angle\n[deg]")
        force.set_xlabel("time [s]")
        finish(figure, caption)
    return Drawn(figure, caption)


def _draw_electric(axis: Axes, columns: Columns) -> None:
    """Draw currents, and voltages on a second scale, with both zeros at the same height."""
    beside = axis.twinx()
    beside.set_zorder(axis.get_zorder() - 1.0)  # voltages lie under the currents
    axis.patch.set_visible(False)
    _draw_drives(axis, columns, "_current_a", DRIVES, "current, ")
    _draw_drives(beside, columns, "_voltage_v", _VOLTAGES, "voltage, ")
    beside.grid(visible=False)
    beside.spines.right.set_visible(True)
    axis.set_ylabel("motor current\n[A]")
    beside.set_ylabel("motor voltage\n[V]")
    bounds = [_bounds(columns, ending) for ending in ("_current_a", "_voltage_v")]
    below = max(low / high for low, high in bounds)
    for each, (low, high) in zip((axis, beside), bounds, strict=True):
        top = 1.06 * max(high, low / below if below > 0.0 else 0.0)
        each.set_ylim(-max(below, 0.06) * top, top)
    handles = [*axis.get_legend_handles_labels()[0], *beside.get_legend_handles_labels()[0]]
    legend_above(axis, handles)


def _bounds(columns: Columns, ending: str) -> tuple[float, float]:
    """Return how far the drives' columns with an ending reach below zero (0 or more) and above it (at least 1)."""
    values = np.concatenate([columns[f"{side}{ending}"] for side in DRIVES if f"{side}{ending}" in columns])
    known = values[np.abs(values) < 1e30]
    if not len(known):
        return 0.0, 1.0
    return max(0.0, -float(known.min())), max(1.0, float(known.max()))


def _draw_drives(
    axis: Axes, columns: Columns, ending: str, looks: dict[str, tuple[str, Any, float]], before: str = ""
) -> None:
    """Draw a quantity of each existing drive, with its own colour and line style."""
    for side, (colour, dashes, width) in looks.items():
        if side + ending in columns:
            values = columns[side + ending]
            own = {"linestyle": dashes, "linewidth": width, "label": before + side}
            line(axis, columns["time_s"], values, colour, **own)
    axis.axhline(0.0, color=GRID, linewidth=1.0, zorder=0)
