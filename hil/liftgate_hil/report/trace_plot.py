"""SVG plots of signals over time with limits, a window and a margin, in the colours of the page.

The SVG is small, because a report of thousands of scenarios has thousands of plots.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.report.numbers import clean
from liftgate_hil.report.page import text

_CRUSHED = 0.05  # of an axis: least share that a signal may shrink to so that a distant limit is shown
_FLAT = 1e-6  # in the files' units, and relative to the value: span of a constant signal, at most
_LEAST = 1e-9  # the same: span that an axis may resolve, at least
_LARGEST = 1e30  # magnitude of the values that are drawn, at most


class LinearScale(NamedTuple):
    """A linear mapping from values to pixels of an axis."""

    low: float
    high: float
    start: float  # px, place of `low`
    end: float

    def at(self, value: float) -> float:
        """Return the pixel coordinate of a value."""
        share = (value - self.low) / (self.high - self.low)
        return self.start + share * (self.end - self.start)

    def inside(self, value: float) -> bool:
        """Whether a value lies within the axis range."""
        slack = 1e-9 * (self.high - self.low)
        return self.low - slack <= value <= self.high + slack


def range_of(values: NDArray[np.float64], levels: Sequence[float]) -> tuple[float, float]:
    """Return (low, high) of an axis that holds signal `values`, and `levels` (limits) if they stay readable.

    A constant signal stays readable with any limit.
    """
    known = values[np.abs(values) < _LARGEST]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    span = high - low
    is_flat = span <= _FLAT * (1.0 + max(abs(low), abs(high)))
    near = [each for each in levels if abs(each) < _LARGEST]
    for each in sorted(near, key=lambda value: max(low - value, value - high)):
        wider = max(high, each) - min(low, each)
        if is_flat or span > _CRUSHED * wider:
            low, high = min(low, each), max(high, each)
    largest = max(abs(low), abs(high))
    is_wide = high - low > _LEAST * (1.0 + largest)
    room = 0.07 * (high - low) if is_wide else 0.1 * largest + 1e-3
    return low - room, high + room


def ticks(low: float, high: float, most: int) -> list[tuple[float, str]]:
    """Return at most `most` + 1 round numbers within a range as axis ticks, with their labels."""
    raw = (high - low) / most
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(each * power for each in (1.0, 2.0, 5.0, 10.0) if each * power >= raw * (1 - 1e-9))
    places = max(0, -math.floor(math.log10(step) + 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    is_large = max(abs(low), abs(high)) >= 1e6
    return [
        (k * step, f"{k * step:.6g}" if is_large or places > 6 else f"{k * step + 0.0:.{places}f}")
        for k in range(first, min(last, first + 3 * most) + 1)
    ]


Floats = NDArray[np.float64]

# CSS of the classes below; a page with such plots must include it.
STYLE = """
:root { --third: #a8246e; }
@media screen and (prefers-color-scheme: dark) { :root { --third: #e58ac0; } }
svg.trace { display: block; width: 100%; height: auto; font: 11px system-ui, sans-serif; }
svg.trace text { fill: var(--ink); stroke: var(--paper); stroke-width: 3px; paint-order: stroke; }
svg.trace .soft { fill: var(--soft); } svg.trace .grid { stroke: var(--grid); fill: none; }
svg.trace .frame { stroke: var(--measured); fill: none; }
svg.trace .window { fill: var(--final); opacity: .08; }
svg.trace .edge { stroke: var(--soft); stroke-dasharray: 2 3; }
svg.trace .limit { stroke: var(--initial); stroke-width: 1.4; stroke-dasharray: 7 3; }
svg.trace .trigger { stroke: var(--soft); stroke-width: 1.2; stroke-dasharray: 1.5 3; }
svg.trace text.limit { fill: var(--initial); stroke: var(--paper); stroke-width: 3px; stroke-dasharray: none; }
svg.trace text.trigger { fill: var(--soft); stroke: var(--paper); stroke-width: 3px; stroke-dasharray: none; }
svg.trace .decided { stroke: var(--ink); stroke-width: 1; }
svg.trace .margin { stroke: var(--ink); stroke-width: 2.2; fill: none; } svg.trace .dot { fill: var(--ink); }
svg.trace path.k { fill: none; stroke-width: 1.3; stroke-linejoin: round; }
svg.trace path.k.b { fill-opacity: .55; stroke-width: .8; }
svg.trace path.k0 { stroke: var(--final); } svg.trace path.k1 { stroke: var(--mark); }
svg.trace path.k2 { stroke: var(--third); } svg.trace path.k3 { stroke: var(--measured); }
svg.trace path.k0.b, svg.trace tspan.k0 { fill: var(--final); }
svg.trace path.k1.b, svg.trace tspan.k1 { fill: var(--mark); }
svg.trace path.k2.b, svg.trace tspan.k2 { fill: var(--third); }
svg.trace path.k3.b, svg.trace tspan.k3 { fill: var(--measured); }
svg.trace tspan { stroke: none; font-weight: 600; }
"""
_WIDTH, _LEFT, _RIGHT = 880.0, 66.0, 20.0
_TITLE, _HEIGHT, _BOTTOM = 22.0, 118.0, 36.0
_COLOURS = 4
_TICK = 0.011  # s, as the first row of a run is one tick after its start
_APART = 18.0  # px, from a limit to a value, between which there is room for a label
_LETTER = 6.0  # px, approximate width of a letter


class SignalLine(NamedTuple):
    """A signal in a panel: lowest and highest value (n,) of each bin."""

    label: str
    low: Floats
    high: Floats


class ConstantLine(NamedTuple):
    """Constant that a signal is compared with: a limit of the expectation, or a trigger that opens its window."""

    value: float
    label: str
    is_trigger: bool


class Margin(NamedTuple):
    """Margin between a value and its limit, as it is drawn at a `time` [s].

    `stretch` is the interval [s] over which an expectation with a hold time is judged; None: a single tick.
    """

    time: float
    limit: float
    value: float
    label: str
    stretch: tuple[float, float] | None = None


@dataclass
class Panel:
    """Panel of a picture: signals of one unit on one axis, with limits."""

    title: str
    unit: str
    lines: list[SignalLine] = field(default_factory=list)
    levels: list[ConstantLine] = field(default_factory=list)
    margin: Margin | None = None
    names: Mapping[float, str] = field(default_factory=dict)  # names of an enumeration's values


@dataclass(frozen=True)
class Picture:
    """Panels over a common time axis: bins at `times` [s] (n,), and an instant `decided` with its label."""

    times: Floats
    panels: Sequence[Panel]
    window: tuple[float, float] | None = None
    opened: str = ""  # label of the window's start
    decided: tuple[float, str] | None = None


def trace_svg(picture: Picture, title: str) -> str:
    """Return a picture as SVG for a page that includes STYLE."""
    step = _TITLE + _HEIGHT
    top = 34.0 if picture.decided is not None else 18.0 if picture.window is not None else 0.0
    height = top + step * len(picture.panels) + _BOTTOM
    low, high = float(picture.times[0]), float(picture.times[-1])
    x = LinearScale(low, high if high > low else low + 1e-3, _LEFT, _WIDTH - _RIGHT)
    bottom = top + step * len(picture.panels)
    parts = [
        f'<svg class="trace" role="img" aria-label="{text(title)}" viewBox="0 0 {_WIDTH:g} {height:g}">',
        *_window(picture, x, top - 2, bottom),
    ]
    for place, panel in enumerate(picture.panels):
        parts += _panel(panel, picture.times, x, top + step * place + _TITLE)
    parts += _decided(picture, x, top - 2, bottom)
    for tick, label in ticks(x.low, x.high, 9):
        parts.append(_words(x.at(tick), bottom + 14, label, "middle"))
    parts.append(_words((x.start + x.end) / 2, bottom + 30, "time [s]", "middle"))
    return "\n".join([*parts, "</svg>\n"])


def _panel(panel: Panel, times: Floats, x: LinearScale, top: float) -> list[str]:
    values = [each for line in panel.lines for each in (line.low, line.high)]
    low, high = range_of(np.concatenate(values), [each.value for each in panel.levels])
    y = LinearScale(low, high, top + _HEIGHT, top)
    parts = [
        f'<path class="grid" d="M{_px(x.at(tick))} {_px(top)}V{_px(y.start)}"/>'
        for tick, _ in ticks(x.low, x.high, 9)
    ]
    named = [(value, clean(f"{value:g} {name}", 11)) for value, name in panel.names.items() if y.inside(value)]
    for tick, label in named[:12] if panel.names else ticks(y.low, y.high, 5):
        place = y.at(tick)
        parts.append(f'<path class="grid" d="M{_px(x.start)} {_px(place)}H{_px(x.end)}"/>')
        parts.append(_words(x.start - 5, place + 3.5, label, "end"))
    parts.append(f'<path class="frame" d="M{_px(x.start)} {_px(top)}V{_px(y.start)}H{_px(x.end)}"/>')
    for place, line in enumerate(panel.lines):
        parts += _curve(line, times, x, y, f"k{place % _COLOURS}")
    parts += [each for level in panel.levels for each in _level(level, x, y)]
    if panel.margin is not None:
        parts += _margin(panel.margin, x, y)
    unit = f" [{text(panel.unit)}]" if panel.unit else ""
    if len(panel.lines) == 1:
        label = f"{text(clean(panel.title, 120))}{unit}"
    else:
        label = ", ".join(
            f'<tspan class="k{place % _COLOURS}">{text(clean(line.label, 40))}</tspan>'
            for place, line in enumerate(panel.lines)
        )
        label += unit
    parts.append(f'<text x="{_px(x.start)}" y="{_px(top - 6)}">{label}</text>')
    return parts


def _curve(line: SignalLine, times: Floats, x: LinearScale, y: LinearScale, colour: str) -> list[str]:
    """Return a signal's curve as SVG, in pieces between gaps, as a band where bins contain several values."""
    low, high = line.low, line.high
    known = np.isfinite(low) & np.isfinite(high)
    if not known.any():
        return [_words((x.start + x.end) / 2, (y.start + y.end) / 2, "no value", "middle", "soft")]
    edges = np.flatnonzero(np.diff(known, prepend=False, append=False)).reshape(-1, 2)
    upper, lower = [], []
    for start, stop in edges.tolist():
        part = slice(start, stop)
        is_band = bool((low[part] < high[part]).any())
        ahead = _points(times[part], high[part], x, y)
        if is_band:
            back = _points(times[part], low[part], x, y)[::-1]
            lower.append(f"M{'L'.join([*ahead, *back])}Z")
        else:
            upper.append(f"M{'L'.join(ahead)}" + ("h1" if len(ahead) == 1 else ""))
    return [
        f'<path class="k {name}" d="{"".join(pieces)}"/>'
        for name, pieces in ((colour, upper), (f"{colour} b", lower))
        if pieces
    ]


def _points(times: Floats, values: Floats, x: LinearScale, y: LinearScale) -> list[str]:
    """Return a curve's points as SVG coordinates, without points equal to both neighbours."""
    needed = np.ones(len(values), dtype=bool)
    needed[1:-1] = (values[1:-1] != values[:-2]) | (values[1:-1] != values[2:])
    shown = np.clip(values[needed], y.low - (y.high - y.low), y.high + (y.high - y.low))
    across = x.start + (times[needed] - x.low) / (x.high - x.low) * (x.end - x.start)
    up = y.start + (shown - y.low) / (y.high - y.low) * (y.end - y.start)
    return [f"{_px(a)} {_px(b)}" for a, b in zip(across.tolist(), up.tolist(), strict=True)]


def _level(level: ConstantLine, x: LinearScale, y: LinearScale) -> list[str]:
    kind = "trigger" if level.is_trigger else "limit"
    # Limits have their label at the right end, triggers at the left one, so that neither covers the other.
    place, anchor = (x.start + 6, "start") if level.is_trigger else (x.end - 4, "end")
    if not y.inside(level.value):
        is_above = level.value > y.high
        edge = y.end + 12 if is_above else y.start - 5
        return [_words(place, edge, f"{'↑' if is_above else '↓'} {level.label}", anchor, kind)]
    up = y.at(level.value)
    over = up - 4 if up - y.end > 14 else up + 12
    line = f'<path class="{kind}" d="M{_px(x.start)} {_px(up)}H{_px(x.end)}"/>'
    return [line, _words(place, over, level.label, anchor, kind)]


def _margin(margin: Margin, x: LinearScale, y: LinearScale) -> list[str]:
    if not x.inside(margin.time):
        return []
    ends = [min(max(value, y.low), y.high) for value in (margin.limit, margin.value)]
    across, first, last = x.at(margin.time), y.at(ends[0]), y.at(ends[1])
    is_left = across > x.start + 0.6 * (x.end - x.start)
    middle = (first + last) / 2 + 3.5
    found = [f'<circle class="dot" cx="{_px(across)}" cy="{_px(last)}" r="3"/>']
    if abs(first - last) > 1.0:
        found.append(f'<path class="margin" d="M{_px(across)} {_px(first)}V{_px(last)}"/>')
        found.append(f'<path class="margin" d="M{_px(across - 4)} {_px(first)}h8"/>')
    if abs(first - last) < _APART:  # the label would lie on the limit's line: beyond the value it has room
        is_below = last > first if abs(first - last) > 1.0 else last - y.end < 30
        has_room = last + 16 < y.start if is_below else last - 14 > y.end
        middle = last + 16 if is_below == has_room else last - 7
    if margin.stretch is not None:
        begin, end = (x.at(min(max(each, x.low), x.high)) for each in margin.stretch)
        found.append(f'<path class="margin" d="M{_px(begin)} {_px(first - 4)}v8v-4H{_px(end)}v-4v8"/>')
    side, anchor = (across - 8, "end") if is_left else (across + 8, "start")
    return [*found, _words(side, middle, margin.label, anchor)]


def _window(picture: Picture, x: LinearScale, top: float, bottom: float) -> list[str]:
    """Return the SVG of the evaluation window: its area and edges, with an arrow where one is outside the axis."""
    if picture.window is None:
        return []
    begin, end = picture.window
    first, last = (x.at(min(max(each, x.low), x.high)) for each in picture.window)
    found = [
        f'<rect class="window" x="{_px(first)}" y="{_px(top)}" width="{_px(max(last - first, 1.0))}" '
        f'height="{_px(bottom - top)}"/>'
    ]
    opens, ends = f"{picture.opened} {_seconds(begin)}", f"window ends {_seconds(end)}"
    if x.inside(begin):
        found.append(f'<path class="edge" d="M{_px(first)} {_px(top)}V{_px(bottom)}"/>')
    elif begin < x.low - _TICK:
        opens = f"← {opens}"
    if x.inside(end):
        found.append(f'<path class="edge" d="M{_px(last)} {_px(top)}V{_px(bottom)}"/>')
    elif end > x.high + _TICK:
        ends = f"{ends} →"
    anchors = ["start", "end"]
    if last - first < _LETTER * (len(opens) + len(ends)) + 20:  # not enough room for both labels between the ends
        if last + _LETTER * len(ends) < _WIDTH:
            anchors = ["end" if first - _LETTER * len(opens) > 0 else "start", "start"]
            last += 4 if anchors[0] == "end" else max(0.0, first + _LETTER * len(opens) + 12 - last)
        else:
            anchors, first = ["end", "end"], min(first, last - _LETTER * len(ends) - 12)
    return [*found, _words(first, 12, opens, anchors[0], "soft"), _words(last, 12, ends, anchors[1], "soft")]


def _decided(picture: Picture, x: LinearScale, top: float, bottom: float) -> list[str]:
    if picture.decided is None or not x.inside(picture.decided[0]):
        return []
    time, label = picture.decided
    across = x.at(time)
    words = f"{label} {_seconds(time)}"
    half = 0.5 * _LETTER * len(words)
    place = min(max(across, x.start + half), x.end - half)
    return [
        f'<path class="decided" d="M{_px(across)} {_px(top)}V{_px(bottom)}"/>',
        _words(place, 28, words, "middle"),
    ]


def _seconds(time: float) -> str:
    return f"{time:.6f}".rstrip("0").rstrip(".") + " s"


def _words(across: float, down: float, label: str, anchor: str, kind: str = "") -> str:
    name = f' class="{kind}"' if kind else ""
    return f'<text{name} x="{_px(across)}" y="{_px(down)}" text-anchor="{anchor}">{text(clean(label, 120))}</text>'


def _px(value: float) -> str:
    """Return a coordinate [px] as text, rounded to a tenth of a pixel."""
    return f"{value:.1f}".removesuffix(".0")
