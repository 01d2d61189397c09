"""Picture of an expectation: the signals that its condition and trigger compare, its window and its margin."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from liftgate_hil.judging.comparisons import Relation, Side
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.judging.trace_summary import Curve, EnvelopeView, TraceSummary
from liftgate_hil.judging.verdict import FAIL, PASS, Verdict, margin_text
from liftgate_hil.report.trace_plot import ConstantLine, Margin, Panel, Picture, SignalLine, trace_svg

MOST_PANELS = 6
_CLOSE = 3.0  # times as long as the margin's view: then that has a picture of its own
Names = Callable[[str], Mapping[float, str]]  # labels of the values of a column or a signal


def expectation_svgs(
    expectation: Expectation, verdict: Verdict, trace_summary: TraceSummary, names: Names
) -> list[str]:
    """Return SVG pictures of an expectation: of its window, and of its margin where the first is too coarse."""
    views = [trace_summary.view]
    if trace_summary.near is not None and _span(trace_summary.view) > _CLOSE * _span(trace_summary.near):
        views.append(trace_summary.near)
    found = []
    for place, view in enumerate(views):
        panels = _panels(trace_summary, view, names)[:MOST_PANELS]
        if not panels or not len(view.times):
            continue
        for panel in panels:
            panel.margin = _margin_on(panel, expectation, verdict, trace_summary, view)
        if place:
            panels = [panel for panel in panels if panel.margin is not None and _moves(panel)]
        opened = "triggered" if isinstance(expectation.after, str) else "window opens"
        instant = decided(expectation, verdict)
        picture = Picture(view.times, panels, verdict.window_s, opened, instant)
        if panels:
            found.append(trace_svg(picture, f"{expectation.name}: {verdict.verdict}"))
    return found


def left_out(trace_summary: TraceSummary, names: Names) -> int:
    """Return the number of an expectation's curves for which its picture has no room."""
    rest = _panels(trace_summary, trace_summary.view, names)[MOST_PANELS:]
    return trace_summary.left_out + sum(len(panel.lines) for panel in rest)


def _moves(panel: Panel) -> bool:
    """Whether any signal of a panel changes over time."""
    return any(bool(np.nanmin(line.low) < np.nanmax(line.high)) for line in panel.lines)


def _span(view: EnvelopeView) -> float:
    return float(view.times[-1] - view.times[0]) if len(view.times) else 0.0


def decided(expectation: Expectation, verdict: Verdict) -> tuple[float, str] | None:
    """Return (instant [s] that decided a verdict, its label in the picture); None: there is none."""
    if verdict.time_s is None or not math.isfinite(verdict.time_s):
        return None
    if expectation.kind == "dtc":
        return verdict.time_s, "reported"
    if verdict.verdict == PASS:
        return verdict.time_s, "closest" if expectation.is_always else "fulfilled"
    if verdict.verdict == FAIL:
        return verdict.time_s, "violated" if expectation.is_always else "closest"
    return None


def _panels(trace_summary: TraceSummary, view: EnvelopeView, names: Names) -> list[Panel]:
    """Return panels: one per compared signal and its counterpart, then panels of operands of calculated sides."""
    curves = {each.side.text: each for each in view.curves}
    panels: dict[str, Panel] = {}
    drawn = set()
    relations = [(each, False) for each in trace_summary.condition]
    relations += [(each, True) for each in trace_summary.opener]
    for comparison, is_trigger in relations:
        sides = [side for side in (comparison.left, comparison.right) if side.text in curves]
        if not sides:
            continue
        panel = _panel_with(panels, sides[0], names)
        for side in sides:
            _add_line(panel, curves[side.text])
            drawn.add(side.text)
        limit = comparison.limit
        if limit is not None:
            level = _level(limit[1], limit[2], comparison, is_trigger, panel)
            if level not in panel.levels:
                panel.levels.append(level)
    parts: dict[str, Panel] = {}
    for curve in view.curves:
        if curve.side.text not in drawn:
            unit = curve.side.unit
            _add_line(parts.setdefault(unit, Panel(curve.side.text, unit)), curve)
    found = [*panels.values(), *parts.values()]
    # Time over time shows nothing; it is left out where there is another panel.
    return [each for each in found if each.title != "time_s"] or found


def _panel_with(panels: dict[str, Panel], side: Side, names: Names) -> Panel:
    if side.text not in panels:
        own = side.names()
        named = names(own[0]) if len(side.ops) == 1 else {}
        panels[side.text] = Panel(side.text, side.unit, names=named)
    return panels[side.text]


def _add_line(panel: Panel, curve: Curve) -> None:
    if all(line.label != curve.side.text for line in panel.lines):
        panel.lines.append(SignalLine(curve.side.text, curve.low, curve.high))


def _level(sign: str, value: float, comparison: Relation, is_trigger: bool, panel: Panel) -> ConstantLine:
    unit = f" {comparison.left.unit}" if comparison.left.unit else ""
    named = panel.names.get(value)
    text = f"{sign} {value:.6g}{unit}" + (f" ({named})" if named else "")
    return ConstantLine(value, f"trigger: {text}" if is_trigger else text, is_trigger)


def _margin_on(
    panel: Panel, expectation: Expectation, verdict: Verdict, trace_summary: TraceSummary, view: EnvelopeView
) -> Margin | None:
    """Return the margin between a signal and its limit, or between two signals; None: not on this panel."""
    decider = next((each for each in trace_summary.condition if each.text == verdict.decided_by), None)
    if decider is None or verdict.margin is None or verdict.margin_time_s is None:
        return None
    labels = [line.label for line in panel.lines]
    side = decider.left if decider.left.constant is None else decider.right
    if side.text != panel.title or not math.isfinite(verdict.margin):
        return None
    bins = _bins_of_margin(view, expectation, verdict.margin_time_s)
    label = f"margin {margin_text(verdict)}"
    stretch = None
    if expectation.hold:
        stretch = verdict.margin_time_s - expectation.hold, verdict.margin_time_s
    line = panel.lines[labels.index(side.text)]
    limit = decider.limit
    if limit is not None:
        # A bin of the whole window may hold both values at the margin, so that the view around it decides.
        views = [each for each in (trace_summary.near, view) if each is not None]
        drawn = ((each, curve) for each in views for curve in each.curves if curve.side.text == side.text)
        finest, curve = next(drawn)
        near = _bins_of_margin(finest, expectation, verdict.margin_time_s)
        own = SignalLine(side.text, curve.low, curve.high)
        both = (limit[2] - abs(verdict.margin), limit[2] + abs(verdict.margin))
        value = min((_distance(own, near, each)[0], each) for each in both)[1]
        _, place = _distance(line, bins, value)
        is_one = bins.stop - bins.start == 1
        time = verdict.margin_time_s if is_one else float(view.times[bins][place])
        return Margin(time, limit[2], value, label, stretch)
    other = decider.right.text
    if other not in labels:
        return None
    lines = [panel.lines[labels.index(each)] for each in (other, side.text)]
    ends = [float(0.5 * (each.low[bins][-1] + each.high[bins][-1])) for each in lines]
    return Margin(verdict.margin_time_s, ends[0], ends[1], label, stretch)


def _bins_of_margin(view: EnvelopeView, expectation: Expectation, time_s: float) -> slice:
    """Return the slice of the bins with a margin at a time [s]: all of the hold time, as it is in one of them."""
    first, last = (
        int(np.searchsorted(view.times, time + 1e-7, side="right")) - 1
        for time in (time_s - expectation.hold, time_s)
    )
    return slice(max(first, 0), max(last, 0) + 1)


def _distance(line: SignalLine, bins: slice, value: float) -> tuple[float, int]:
    """Return (distance from a value to the nearest of `bins`, its index in them); infinite: no bin has a value."""
    low, high = line.low[bins], line.high[bins]
    away = np.maximum(np.maximum(low - value, value - high), 0.0)
    if not np.isfinite(away).any():
        return math.inf, 0
    place = int(np.nanargmin(away))
    return float(away[place]), place
