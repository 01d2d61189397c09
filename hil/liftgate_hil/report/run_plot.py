"""Plot of a run, with its pinch event beside it on a larger scale."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.report.drawing import DRIVES, FINAL, GRID, INITIAL, INK, MARK, line, new_figure, png, style
from liftgate_hil.report.files import put_report
from liftgate_hil.report.pinch import LIMITS, PinchEvent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]

_FONT, _SMALL = 11.0, 10.0
_SIZE = (13.0, 9.5)  # inch
_DPI = 100
_WINDOW = 0.05  # s, interval over which Hall counts are differenced
_PAPER = {"facecolor": "white", "edgecolor": "none", "pad": 0.0, "alpha": 0.8}  # behind a text on lines
_ZOOM = (0.12, 0.40)  # s before the first touch, and after the largest force
FORCE = "#a8246e"


class DrawnObstacle(NamedTuple):
    """An obstacle in a plot: its angle [deg], and the times [s] between which it is present."""

    angle_deg: float
    start: float
    end: float


@dataclass(frozen=True)
class RunPicture:
    """Data of a plot: rows of a run, the pinch event in them, obstacles, marks (time [s], text)."""

    title: str
    columns: Columns
    event: PinchEvent | None
    obstacles: Sequence[DrawnObstacle] = ()
    marks: Sequence[tuple[float, str]] = ()

    def between(self, low: float, high: float) -> RunPicture:
        """Return the plot's data with only the rows between two times [s]."""
        times = self.columns["time_s"]
        rows = slice(*np.searchsorted(times, (low, high)).tolist())
        columns = {name: values[rows] for name, values in self.columns.items()}
        return RunPicture(self.title, columns, self.event, self.obstacles, self.marks)


def hall_speed(times: Floats, counts: Floats) -> Floats:
    """Return the Hall counts per second (n,), each over the last 0.05 s, as an ECU would measure them."""
    rows = max(1, round(_WINDOW / float(np.median(np.diff(times)))))
    speed = np.zeros(len(counts))
    speed[rows:] = (counts[rows:] - counts[:-rows]) / (times[rows:] - times[:-rows])
    return speed


def plot_run(path: Path, picture: RunPicture, say: Say = silent) -> None:
    """Draw a run into a PNG file, over an earlier one of this program. Raises OSError, ConfigError."""
    put_report(path, png(run_figure(picture), _DPI), say)


def run_figure(picture: RunPicture) -> Figure:
    """Return the figure of angle, motor currents, Hall speed and pinch force over time, beside any pinch event."""
    columns = dict(picture.columns)
    for side in DRIVES:
        counts = columns.pop(f"{side}_hall_count", None)
        if counts is not None:
            columns[f"{side}_hall_speed"] = hall_speed(columns["time_s"], counts)
    whole = RunPicture(picture.title, columns, picture.event, picture.obstacles, picture.marks)
    with style():
        import matplotlib
        from matplotlib.axes import Axes

        matplotlib.rcParams.update(
            {"font.size": _FONT, "axes.labelsize": _FONT, "axes.titlesize": _FONT + 1.0, "legend.fontsize": _SMALL}
        )
        figure = new_figure(_SIZE[1], _SIZE[0])
        figure.suptitle(picture.title, fontsize=_FONT + 3.0)
        if picture.event is None:
            _draw_whole(figure.subplots(4, 1, sharex=True), whole)
        else:
            parts: Any = figure.subfigures(1, 2, width_ratios=(1.35, 1.0))
            left, right = parts
            _draw_whole(left.subplots(4, 1, sharex=True), whole)
            _draw_event(right.subplots(3, 1, sharex=True, height_ratios=(2.1, 1.0, 1.0)), whole)
            left.align_ylabels()
            right.align_ylabels()
        for axis in figure.findobj(Axes):
            axis.tick_params(labelsize=_SMALL)  # the labels are created when they are drawn
    return figure


def _draw_whole(axes: Iterable[Axes], picture: RunPicture) -> None:
    angle, current, speed, force = axes
    angle.set_title("the whole run", loc="left")
    draw_angle(angle, picture)
    angle.legend(loc="upper right")
    draw_drives(current, picture, "_current_a", "motor current [A]")
    _mark_command_reversal(current, picture)
    draw_drives(speed, picture, "_hall_speed", "Hall speed [counts/s]")
    draw_force(force, picture)
    event = picture.event
    for axis in (angle, current, speed, force):
        for time, _ in picture.marks:
            axis.axvline(time, color=INK, linewidth=1.0, linestyle=":")
    for time, text in picture.marks:
        angle.annotate(text, (time, 0.0), (4, 4), textcoords="offset points", fontsize=_SMALL)
    if event is not None:
        _annotate(force, (event.time_s, event.force_n), f"{event.force_n:.1f} N", (10, -4))
    force.set_xlabel("time [s]")


def _draw_event(axes: Iterable[Axes], whole: RunPicture) -> None:
    event = whole.event
    assert event is not None
    low, high = window_of(event)
    picture = whole.between(low, high)
    force, angle, current = axes
    force.set_title(f"{high - low:.2f} s around the pinch; limits from other doors", loc="left")
    draw_force(force, picture)
    top = max(event.force_n, *(limit.force for limit in LIMITS))
    force.set_ylim(0.0, 1.12 * top)
    for limit in LIMITS:
        dashes = ("--" if limit.longest else "-") if limit.is_judged else ":"  # dashed: for a time, as on the page
        length = f" for {limit.longest:g} s" if limit.longest else ""
        force.axhline(limit.force, color=INITIAL, linewidth=1.3, linestyle=dashes)
        force.annotate(
            f"{limit.force:.0f} N{length}: {limit.source}{'' if limit.is_judged else ' (not judged)'}",
            (1.0, limit.force),
            (-2, 4),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            ha="right",
            fontsize=_SMALL,
            color=INITIAL,
            bbox=_PAPER,
        )
    _draw_margin(force, event, (low, high))
    draw_angle(angle, picture)
    draw_drives(current, picture, "_current_a", "motor current [A]")
    _mark_command_reversal(current, picture)
    for name, time in (("first touch", event.start_s), ("turned", event.turn_s)):
        if np.isfinite(time):
            for axis in (force, angle, current):
                axis.axvline(time, color=INK, linewidth=0.9, linestyle=":")
            height = 0.5 * (event.force_n + LIMITS[0].force)  # beside the margin
            force.text(time, height, name, rotation=90, ha="right", va="center", fontsize=_SMALL, bbox=_PAPER)
    draw_reversal(angle, event)
    current.set_xlim(low, high)
    current.set_xlabel("time [s]")


def window_of(event: PinchEvent) -> tuple[float, float]:
    """Return the times [s] between which a pinch event is drawn."""
    return event.start_s - _ZOOM[0], max(event.time_s + _ZOOM[1], event.end_s + 0.05)


def _draw_margin(axis: Axes, event: PinchEvent, span: tuple[float, float]) -> None:
    """Draw the peak pinch force with its margins in words, and an arrow from it to the first of LIMITS."""
    limit, text = LIMITS[0], f"peak {event.force_n:.1f} N\nat {event.time_s:.3f} s, {event.angle_deg:.2f} deg"
    for each in LIMITS:
        if not each.longest:
            margin = each.force - event.force_n
            text += f"\n{abs(margin):.1f} N {'below' if margin >= 0.0 else 'above'} {each.force:.0f} N"
    axis.annotate(
        "",
        (event.time_s, limit.force),
        (event.time_s, event.force_n),
        arrowprops={"arrowstyle": "<->", "color": INK, "shrinkA": 4, "shrinkB": 1},
    )
    axis.plot([event.time_s], [event.force_n], "o", color=FORCE, markersize=7, zorder=5)
    place = (event.time_s + 0.03 * (span[1] - span[0]), 0.5 * (event.force_n + limit.force))
    axis.text(*place, text, va="center", fontsize=_FONT)


def draw_reversal(axis: Axes, event: PinchEvent) -> None:
    """Mark time and angle at which the gate reversed, with the reversal in words, or that it did not reverse."""
    if not np.isfinite(event.turn_s):
        text, place = "did not reverse", (event.start_s, event.start_deg)
    else:
        text = (
            f"turned {1e3 * event.reversal_time_s:.0f} ms after the first touch,\n"
            f"{event.further_deg:.2f} deg further; moved back by {event.back_deg:.1f} deg"
        )
        place = (event.turn_s, event.turn_deg)
        axis.plot(*([value] for value in place), "o", color=FINAL, markersize=6, zorder=5)
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.5 * (high - low))  # room for the text
    axis.text(0.99, 0.98, text, transform=axis.transAxes, ha="right", va="top", fontsize=_SMALL)


def draw_angle(axis: Axes, picture: RunPicture) -> None:
    """Draw the gate's angle, and each obstacle at its angle while it can be touched."""
    times = picture.columns["time_s"]
    line(axis, times, picture.columns["gate_angle_deg"], FINAL, label="gate")
    for each in picture.obstacles:
        span = np.clip((_acts_from(picture.columns, each), each.end), times[0], times[-1])
        if span[1] > span[0]:
            name = f"obstacle at {each.angle_deg:g} deg"
            axis.plot(span, [each.angle_deg] * 2, color=MARK, linewidth=2.4, label=name)
    axis.set_ylabel("gate angle [deg]")


def _acts_from(columns: Columns, obstacle: DrawnObstacle) -> float:
    """Return the time [s] from which an obstacle can be touched: once the gate is beyond it, else its start."""
    times = columns["time_s"]
    is_clear = (times >= obstacle.start) & (columns["gate_angle_deg"] > obstacle.angle_deg)
    return float(times[np.argmax(is_clear)]) if is_clear.any() else obstacle.start


def command_reversal(columns: Columns, event: PinchEvent) -> tuple[float, float] | None:
    """Return the spike of a motor's current when the ECU reverses in a contact: its time [s] and the current [A].

    It is the largest current from the first command in the other direction until the gate turns. None: the ECU
    does not reverse, or the columns do not show it.
    """
    times = columns["time_s"]
    first, last = np.searchsorted(times, (event.start_s, window_of(event)[1])).tolist()
    for side in DRIVES:
        duty, current = (columns.get(f"{side}_{name}") for name in ("duty", "current_a"))
        if duty is None or current is None or first == 0:
            continue
        back = np.flatnonzero(duty[first:last] * duty[first - 1] < 0.0)
        if len(back):
            at = first + int(back[0])
            until = max(at + 1, int(np.searchsorted(times, np.nan_to_num(event.turn_s, nan=times[at]))))
            peak = at + int(np.argmax(np.abs(current[at:until])))
            return float(times[peak]), float(current[peak])
    return None


def _mark_command_reversal(axis: Axes, picture: RunPicture) -> None:
    """Label the spike of motor current with which the ECU reverses the motors."""
    if picture.event is not None and (found := command_reversal(picture.columns, picture.event)) is not None:
        _annotate(axis, found, "ECU reverses", (8, -6))


def draw_drives(axis: Axes, picture: RunPicture, ending: str, label: str) -> None:
    """Draw the column of each drive with this `ending`, with the drive's own colour and line style."""
    axis.set_ylabel(label)
    for side, (colour, dashes, width) in DRIVES.items():
        if side + ending in picture.columns:
            values = picture.columns[side + ending]
            looks = {"linestyle": dashes, "linewidth": width, "label": side}
            line(axis, picture.columns["time_s"], values, colour, **looks)
    axis.axhline(0.0, color=GRID, linewidth=1.0, zorder=0)
    axis.legend(loc="upper right", ncols=2)


def draw_force(axis: Axes, picture: RunPicture) -> None:
    """Draw the pinch force."""
    force = picture.columns["pinch_force_n"]
    line(axis, picture.columns["time_s"], force, FORCE)
    axis.set_ylabel("pinch force [N]")


def _annotate(axis: Axes, place: tuple[float, float], text: str, offset: tuple[int, int]) -> None:
    axis.annotate(text, place, offset, textcoords="offset points", fontsize=_FONT, bbox=_PAPER)
