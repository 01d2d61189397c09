"""Figure of columns over time, related ones in one panel; also of two recordings and their difference."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.config.drafting.words import concepts_in, words_of
from liftgate_hil.conversion.figures.subject import Columns, Drawn, FigureSubject
from liftgate_hil.conversion.held_values import differences_of
from liftgate_hil.conversion.partners import nearest, ns_of
from liftgate_hil.conversion.sheet import HEIGHT, SMALL, WIDTH, finish, legend_above, sheet
from liftgate_hil.conversion.table import Floats, chosen, columns_in, ours_in
from liftgate_hil.errors import ConfigError, with_unit
from liftgate_hil.formats.recording import COMMAND, Recording
from liftgate_hil.report.drawing import FINAL, GRID, INK, MARK, MEASURED, ORANGE, line
from liftgate_hil.report.numbers import axis_label, clean, significant
from liftgate_hil.signals import COLUMNS, INPUT_SIGNALS, SENSED_PREFIX

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_OF_MESSAGES = {"msg", "message", "frame", "botschaft"}  # words in the names of their counters
MOST = 8  # most panels of a plot
_USUAL = (
    "gate_angle_deg",
    "left_current_a",
    "right_current_a",
    "left_speed_rps",
    "right_speed_rps",
    "pinch_force_n",
    "terminal_voltage_v",
)
_MOST_MARKS = 20  # that the caption lists
_LABEL = 0.03  # of the width: marks that are nearer to each other share a label
# A wide line under a narrow, dashed one shows that there are two, also in grey.
_LOOKS: Sequence[tuple[str, Any, float]] = (
    (FINAL, "-", 2.6),
    (ORANGE, (0, (3, 2)), 1.3),
    (MARK, "-", 0.9),
    (MEASURED, (0, (1, 1)), 1.3),
    (INK, (0, (5, 1, 1, 1)), 0.9),
)
_DIFFERENCE = "#a8246e"
# What distinguishes the columns of a panel: the drive, and whether it is a sensor's value.
_SIDES = re.compile(r"^sensed_|left_?|right_?", re.IGNORECASE)


def usual_columns(table: Recording, rig: str | None = None) -> list[str]:
    """Return the columns plotted by default: those that matter for a gate, or the first few.

    In a bus log that is decoded by a rig, the signals of these columns come first. Counters and checksums of
    messages are not among them, unless there is nothing else.
    """
    names = [name for name in _USUAL if name in table.signals]
    others = [name for name in table.signals if name != "time_s"]
    telling = [name for name in others if not _is_protection(name)]
    if names:
        return names
    wired = {} if rig is None else ours_in(rig, others)
    first = [wired[SENSED_PREFIX + name] for name in _USUAL if SENSED_PREFIX + name in wired]
    ordered = list(dict.fromkeys([*first, *(telling or others)]))
    shown = list(dict.fromkeys(_panel_of(name, table) for name in ordered))[:MOST]
    return [name for name in ordered if _panel_of(name, table) in shown]


def _is_protection(name: str) -> bool:
    """Whether a column is an alive counter (not e.g. `TurnCounter`) or a checksum, by its name."""
    message, _, signal = name.rpartition(".")
    own = [word for word in words_of(signal) if word not in words_of(message)]
    if "checksum" in concepts_in("_".join(own)):
        return True
    return bool(own) and all(word in _OF_MESSAGES or "counter" in concepts_in(word) for word in own)


def panels_of(names: Sequence[str], table: Recording) -> list[list[str]]:
    """Return columns by panel; both drives' and sensed ones share one. Raises ConfigError for too many panels."""
    panels: dict[tuple[str, str], list[str]] = {}
    for name in names:
        panels.setdefault(_panel_of(name, table), []).append(name)
    found = list(panels.values())
    if len(found) > MOST:
        raise ConfigError(f"`columns`: {len(found)} panels; allowed: up to {MOST}")
    return found


def _panel_of(name: str, table: Recording) -> tuple[str, str]:
    """Return the key of a column's panel: the name without the drive and the prefix `sensed_`, and the unit."""
    return _SIDES.sub("", name), table.signals[name].unit


def one_of_each(names: Sequence[str]) -> list[str]:
    """Return the columns in order, but of those that differ only in drive or prefix `sensed_` only the first."""
    found: dict[str, str] = {}
    for name in names:
        found.setdefault(_SIDES.sub("", name), name)
    return list(found.values())


def run_picture(
    title: str,
    columns: Columns,
    panels: Sequence[Sequence[str]],
    units: Mapping[str, str],
    marks: Sequence[tuple[float, str]] = (),
) -> Figure:
    """Return a figure of one recording's columns over time, a panel below the other; marks: (time [s], text)."""
    with sheet(HEIGHT * len(panels) + 0.6, title) as figure:
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axis, names in zip(axes, panels, strict=True):
            for name, looks in zip(names, _looks_for(len(names)), strict=True):
                _draw(axis, columns["time_s"], columns[name], looks, _short(name), name in INPUT_SIGNALS)
            axis.set_ylabel(_label(names[0] if len(names) == 1 else _common(names), units[names[0]]))
            if len(names) > 1:
                legend_above(axis)
        axes[-1].set_xlabel("time [s]")
        finish(figure, _draw_marks(axes.tolist(), marks))
    return figure


def _draw_marks(axes: Sequence[Axes], marks: Sequence[tuple[float, str]]) -> str:
    """Draw numbered lines at an operator's marks, and return their texts as a caption; "": there are none."""
    for time, text in marks:
        dashes: Any = (0, (1, 4)) if text.startswith(COMMAND) else ":"
        for axis in axes:
            axis.axvline(time, color=INK, linewidth=0.9, linestyle=dashes)
    low, high = axes[0].get_xlim()
    numbers: list[tuple[float, int, int]] = []  # time [s] of a label, its first and last number
    for number, (time, _) in enumerate(marks, 1):
        if numbers and time - numbers[-1][0] < _LABEL * (high - low):
            numbers[-1] = (numbers[-1][0], numbers[-1][1], number)
        else:
            numbers.append((time, number, number))
    for time, first, last in numbers:
        axes[0].annotate(
            str(first) if first == last else f"{first}–{last}", (time, 1.0), (0, 2), ("data", "axes fraction"),
            "offset points", ha="center", fontsize=SMALL,
        )  # fmt: skip
    texts = [f"{number}: {time:.3f} s, {text}" for number, (time, text) in enumerate(marks, 1)]
    more = f"; and {len(texts) - _MOST_MARKS} more" if len(texts) > _MOST_MARKS else ""
    return f"Marks: {'; '.join(texts[:_MOST_MARKS])}{more}." if texts else ""


def two_pictures(
    titles: tuple[str, str],
    both: tuple[Columns, Columns],
    names: Sequence[str],
    units: Mapping[str, str],
    time_tolerance: float,
) -> Figure:
    """Return a figure of two recordings' columns over each other, and beside them the second minus the first.

    The difference is that to the nearest row of the second recording, within `time_tolerance` [s].
    """
    first, second = both
    here, there = nearest(ns_of(first["time_s"]), ns_of(second["time_s"]), round(1e9 * time_tolerance))
    times = first["time_s"][here]
    with sheet(HEIGHT * len(names) + 0.8, "", WIDTH + 2.0) as figure:
        grid = figure.subplots(len(names), 2, sharex=True, squeeze=False, width_ratios=(1.5, 1.0))
        for (over, beside), name in zip(grid, names, strict=True):
            for columns, looks, title in zip(both, _LOOKS, titles, strict=False):
                _draw(over, columns["time_s"], columns[name], looks, clean(title, 40), name in INPUT_SIGNALS)
            over.set_ylabel(_label(name, units[name]))
            difference = differences_of(first[name][here], second[name][there])
            _draw_difference(beside, times, difference, units[name])
        grid[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
        grid[0, 1].set_title(f"{clean(titles[1], 40)} minus {clean(titles[0], 40)}", loc="left")
        for axis in grid[-1]:
            axis.set_xlabel("time [s]")
        finish(figure)
    return figure


def _looks_for(count: int) -> list[tuple[str, Any, float]]:
    """Return colour, line style and width for each of `count` columns in a panel, repeated after the last look."""
    if count == 1:
        return [(FINAL, "-", 1.4)]
    return [_LOOKS[k % len(_LOOKS)] for k in range(count)]


def _draw(
    axis: Axes, times: Floats, values: Floats, looks: tuple[str, Any, float], label: str, is_held: bool
) -> None:
    """Draw values over time; an input is held constant from its sample until the next one."""
    colour, dashes, width = looks
    how = "steps-post" if is_held else "default"
    line(axis, times, values, colour, linestyle=dashes, linewidth=width, label=label, drawstyle=how)


def _draw_difference(axis: Axes, times: Floats, difference: Floats, unit: str) -> None:
    """Draw a difference over time, labelled with its largest value, the unit and the time of it."""
    axis.axhline(0.0, color=GRID, linewidth=1.0, zorder=0)
    line(axis, times, difference, _DIFFERENCE, linewidth=1.2)
    known = np.flatnonzero(np.isfinite(difference))
    if not len(known) or not np.any(difference[known]):
        axis.text(0.5, 0.55, "equal", transform=axis.transAxes, ha="center", color=INK)
        axis.set_yticks([])
        return
    at = known[int(np.argmax(np.abs(difference[known])))]
    axis.plot([times[at]], [difference[at]], "o", color=_DIFFERENCE, markersize=5)
    largest = with_unit(significant(float(difference[at])), clean(unit, 12))
    caption = f"largest {largest} at {times[at]:.3f} s"
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.22 * (high - low))  # room for the text
    axis.text(0.99, 0.97, caption, transform=axis.transAxes, ha="right", va="top", color=INK)


def _label(name: str, unit: str) -> str:
    """Return the axis label for one or several columns, on two lines if it is long."""
    caption = axis_label(name)
    if "[" not in caption and unit:
        caption = f"{caption} [{clean(unit, 12)}]"
    words, bracket, rest = caption.partition(" [")
    if len(words) > 20:
        words = words.replace(".", ".\n", 1)
        caption = f"{words}{bracket}{rest}"
    return f"{words}\n[{rest}" if len(caption) > 20 and bracket else caption


def _common(names: Sequence[str]) -> str:
    """Return a name for both drives' columns: the common part of their names."""
    name = _SIDES.sub("", _SIDES.sub("", names[0]))
    return name if names[0] in COLUMNS else name.strip("._") or names[0]


def _short(name: str) -> str:
    """Return a short label that distinguishes a column from the others in its panel."""
    words = [word for word in ("sensed", "left", "right") if word in name.lower()]
    return " ".join(words) or clean(name, 40)


def draw(subject: FigureSubject) -> Drawn:
    """Draw the requested columns, or the usual ones without those that are constant. Raises ConfigError."""
    table = subject.recording()
    names = chosen(table, subject.columns) or usual_columns(table, subject.rig)
    if not names:
        raise ConfigError(f"{table.path}: no column besides time_s; allowed: a recording with one")
    columns = columns_in(table, names, subject.window)
    still = [] if subject.columns else [name for name in names if _is_constant(columns[name])]
    if len(still) < len(names):
        names = [name for name in names if name not in still]
    else:
        still = []
    panels = panels_of(names, table)
    units = {name: table.signals[name].unit for name in names}
    low, high = columns["time_s"][0], columns["time_s"][-1]
    marks = [(time, text) for time, text in table.marks if low <= time <= high]
    left_out = 0 if subject.columns else len(table.signals) - 1 - len(names) - len(still)
    notes = [f"not drawn, as they do not change: {', '.join(still)}"] if still else []
    notes += (
        [f"not drawn: {left_out} more column{'s' * (left_out > 1)}, which --columns NAME,… draws"]
        if left_out
        else []
    )
    drawn = run_picture(subject.title, columns, panels, units, marks)
    return Drawn(drawn, ", ".join(names), "\n".join(notes))


def _is_constant(values: Floats) -> bool:
    there = values[np.isfinite(values)]
    return not len(there) or bool(there.max() == there.min())
