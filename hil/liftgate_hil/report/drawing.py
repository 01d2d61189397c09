"""Common drawing functions of all figures: colours, labels, decimation, SVG and file output.

The SVG carries its colours as CSS variables, so that the page decides on light or dark.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.report.files import SOFTWARE
from liftgate_hil.report.numbers import clean

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

# Okabe and Ito's colours, which colour-blind readers can distinguish; VARIABLES has the page's CSS variables.
INK, GRID, MEASURED, FINAL, INITIAL, MARK = (
    "#1c2126", "#d9dde2", "#8c939c", "#0072b2", "#d55e00", "#009e73",
)  # fmt: skip
# Three more of theirs, for figures with many curves; a page does not restyle them.
SKY, ORANGE, PURPLE = "#56b4e9", "#e69f00", "#cc79a7"
VARIABLES = {INK: "ink", GRID: "grid", MEASURED: "measured", FINAL: "final", INITIAL: "initial", MARK: "mark"}
# Looks of both drives: colour, dashes, width. Those of a symmetric gate have the same curve: a wide line under a
# narrow, dashed one, lighter in grey, shows both.
DRIVES: dict[str, tuple[str, Any, float]] = {"left": (FINAL, "-", 2.6), "right": (ORANGE, (0, (3, 2)), 1.3)}
WIDTH = 7.6  # inch, width of the page's text
_LEAST_SPAN = 1e-3  # of an axis, as a share of its values
LIMIT = 1500  # points of a drawn line: two for each pixel of its width

_SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",
    "pdf.fonttype": 42,  # fonts that can be searched and edited
    "svg.hashsalt": "liftgate-hil",
    "text.parse_math": False,
    "axes.unicode_minus": True,
    "axes.formatter.useoffset": False,  # whole numbers at the ticks, not 1e-11 and somewhere else "+1"
    "font.family": "sans-serif",
    "font.size": 8.5,
    "axes.labelsize": 8.5,
    "axes.titlesize": 9.0,
    "legend.fontsize": 8.5,
    "xtick.labelsize": 8.0,
    "xtick.minor.pad": 5.0,
    "ytick.labelsize": 8.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": MEASURED,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "legend.frameon": False,
    "lines.linewidth": 1.3,
}


@contextmanager
def style() -> Iterator[None]:
    """Context with the matplotlib settings in which all figures are drawn and saved, restored at its end."""
    import matplotlib

    with matplotlib.rc_context(), warnings.catch_warnings():
        matplotlib.rcParams.update(_SETTINGS)
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # the browser has the glyph
        warnings.filterwarnings("ignore", message=".*layout not applied")
        yield


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """Return an empty figure of a size in inches; call this function, and draw, inside `style`."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def thin(times: Floats, values: Floats, limit: int = LIMIT) -> tuple[Floats, Floats]:
    """Return at most `limit` points that still show every peak: lowest and highest of each interval."""
    if len(values) <= limit:
        return times, values
    edges = np.linspace(0, len(values), limit // 2 + 1).astype(np.intp)
    kept = []
    for start, stop in pairwise(edges.tolist()):
        part = values[start:stop]
        known = np.isfinite(part)
        if known.any():
            kept += [
                start + int(np.argmin(np.where(known, part, np.inf))),
                start + int(np.argmax(np.where(known, part, -np.inf))),
            ]
        else:
            kept.append(start)
    index = np.unique(kept)
    return times[index], values[index]


def line(axis: Axes, times: Floats, values: Floats, colour: str, **looks: object) -> None:
    """Draw a line with at most LIMIT points, see `thin`; values from 1e30 on, or not finite, leave a gap."""
    shown = np.where(np.abs(values) < 1e30, values, np.nan)
    axis.plot(*thin(times, shown), color=colour, **looks)  # type: ignore[arg-type]


def limits(main: Floats, aside: Floats) -> tuple[float, float] | None:
    """Return an axis range (low, high) for all of `main` and part of `aside`; None: `main` has no values.

    `aside` extends the range by the span of `main` at most, to either side; there is a margin at both ends. What
    is constant but for rounding is drawn as a level line. NaN and values from 1e30 on are ignored.
    """
    known = main[np.abs(main) < 1e30]
    if not len(known):
        return None
    low, high = float(known.min()), float(known.max())
    span = (high - low) or abs(high) or 1.0
    other = aside[np.abs(aside) < 1e30]
    if len(other):
        low = min(low, max(float(other.min()), low - span))
        high = max(high, min(float(other.max()), high + span))
    margin = 0.06 * ((high - low) or span)
    return widened(low - margin, high + margin)


def widened(low: float, high: float) -> tuple[float, float]:
    """Return (low, high) of an axis about the same centre, widened where tick labels could not resolve it."""
    middle, least = 0.5 * (low + high), _LEAST_SPAN * max(abs(low), abs(high))
    half = max(0.5 * (high - low), 0.5 * least)
    return middle - half, middle + half


def log_axis(axis: Axes, side: str) -> None:
    """Make the x or y axis logarithmic, with plain tick labels: math text is off, as names may contain a $."""
    from matplotlib.ticker import NullFormatter

    (axis.set_xscale if side == "x" else axis.set_yscale)("log")
    scale = axis.xaxis if side == "x" else axis.yaxis
    scale.set_major_formatter(lambda value, _: f"{value:g}")
    scale.set_minor_formatter(NullFormatter())


def svg(figure: Figure, name: str, title: str) -> str:
    """Return a figure as SVG for an HTML page; `name` makes its identifiers unique among the figures."""
    stream = io.StringIO()
    with style():
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(stream, format="svg", metadata=nothing)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    box = re.search(r'viewBox="[^"]*"', text)
    head = f'<svg class="plot" role="img" aria-label="{escape(clean(title))}" {box[0] if box else ""}>'
    text = head + text[text.index(">") + 1 :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<style.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = text.replace("url(#", f"url(#{name}-")
    text = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), text)
    for colour, variable in VARIABLES.items():
        text = text.replace(colour, f"var(--{variable}, {colour})")
    return text


def png(figure: Figure, dpi: int = 130) -> bytes:
    """Return a figure as PNG on a white background, for a file."""
    stream = io.BytesIO()
    with style():
        figure.savefig(stream, format="png", dpi=dpi, metadata={"Software": SOFTWARE}, facecolor="white")
    return stream.getvalue()


def pdf(figure: Figure) -> bytes:
    """Return a figure as PDF for a file, with the same bytes for the same figure."""
    stream = io.BytesIO()
    with style():
        about = {"Creator": SOFTWARE, "Producer": None, "CreationDate": None}
        figure.savefig(stream, format="pdf", metadata=about, facecolor="white")
    return stream.getvalue()
