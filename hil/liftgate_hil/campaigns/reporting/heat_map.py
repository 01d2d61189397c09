"""Heat map of a result over two varied values, as an HTML table that prints and reads without colour."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.report.page import Markup, text

_CLASSES = 10  # of a continuous value, at most: more columns are wider than a printed page

STYLE = """
table.heat { border-spacing: 2px; border-collapse: separate; margin: .3rem 0; }
table.heat th { border: 0; font-weight: 400; color: var(--soft); padding: 0 .3rem; text-align: right;
  white-space: nowrap; }
table.heat thead th { text-align: center; }
table.heat th.corner { min-width: 5rem; max-width: 9rem; white-space: normal; overflow-wrap: break-word;
  text-align: right; }
table.heat td { border: 0; padding: .22rem .3rem; text-align: center; min-width: 2.1rem; border-radius: .2rem;
  color: #1c2126; }
table.heat td.none { color: var(--soft); }
table.heat td.over { font-weight: 700; outline: 2px solid #b3261e; outline-offset: -2px; }
p.key { color: var(--soft); font-size: .85rem; margin: .1rem 0 .8rem; }
"""


class HeatMapCells(NamedTuple):
    """Cells of a heat map: the worst result in each, and the labels of the rows and columns."""

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    worst: Floats  # (rows, columns), NaN: no variant there


def cells_of(across: Floats, down: Floats, results: Floats, is_low_worst: bool) -> HeatMapCells:
    """Return heat map cells over two varied values (n,), each with the worst of its results (n,)."""
    columns, column_of = _classes(across, _CLASSES)
    rows, row_of = _classes(down, _CLASSES)
    sign = -1.0 if is_low_worst else 1.0
    worst = np.full((len(rows), len(columns)), -np.inf)
    known = np.isfinite(results)
    np.maximum.at(worst, (row_of[known], column_of[known]), sign * results[known])
    return HeatMapCells(rows, columns, np.where(np.isfinite(worst), sign * worst, np.nan))


def _classes(values: Floats, most: int) -> tuple[tuple[str, ...], np.ndarray]:
    distinct = np.unique(values)
    if len(distinct) <= 3 * most // 2:
        return tuple(f"{each:.12g}" for each in distinct.tolist()), np.searchsorted(distinct, values)
    edges = np.linspace(distinct[0], distinct[-1], most + 1)
    if _is_logarithmic(values):
        edges = np.geomspace(distinct[0], distinct[-1], most + 1)
    middles = (float(f"{0.5 * (low + high):.3g}") for low, high in pairwise(edges.tolist()))
    names = tuple(f"{each:.12g}" for each in middles)
    return names, np.clip(np.searchsorted(edges, values, side="right") - 1, 0, most - 1)


def _is_logarithmic(values: Floats) -> bool:
    """Whether the median of values is nearer to the geometric than to the arithmetic mean of the extremes."""
    low, middle, high = (float(each) for each in np.quantile(values, (0.02, 0.5, 0.98)))
    if low <= 0.0 or values.min() <= 0.0:
        return False
    return abs(middle - math.sqrt(low * high)) < abs(middle - 0.5 * (low + high))


def heat_map(
    cells: HeatMapCells,
    across: str,
    down: str,
    good: float,
    bad: float,
    digits: int = 0,
    *,
    is_judged: bool = True,
) -> str:
    """Return the heat map as an HTML table; a cell is green at `good`, yellow at `bad`, red and framed beyond.

    A result that is not judged is neither: the shade of blue grows from `good` to `bad`. `across` and `down` are
    the labels of the two values.
    """
    head = "".join(f"<th>{text(each)}</th>" for each in cells.columns)
    body = []
    for name, row in zip(cells.rows, cells.worst.tolist(), strict=True):
        inside = "".join(_cell(value, good, bad, digits, is_judged) for value in row)
        body.append(f"<tr><th>{text(name)}</th>{inside}</tr>")
    return (
        '<div class="wide"><table class="heat"><thead>'
        f'<tr><th class="corner">{breakable(down)} ↓ &nbsp; {breakable(across)} →</th>{head}</tr>'
        f"</thead><tbody>{''.join(body)}</tbody></table></div>"
    )


def label_of(name: str, units: Mapping[str, str]) -> str:
    """Return the label of a varied name: the name with its unit."""
    unit = units.get(name, "")
    return f"{name} [{unit}]" if unit else name


def breakable(label: str) -> Markup:
    """Return a label as HTML that may wrap after each dot and underscore."""
    return Markup(re.sub(r"([._])", r"\1<wbr>", text(label)))


# Colours at `good` and `bad`, and beyond: ColorBrewer's RdYlGn, whose ends differ in lightness too, and Blues.
_JUDGED, _OVER = ((0x91, 0xCF, 0x60), (0xFF, 0xEE, 0xA0)), (0xF4, 0x7B, 0x5A)
_NOT_JUDGED = ((0xF7, 0xFB, 0xFF), (0x9E, 0xCA, 0xE1))


def _cell(value: float, good: float, bad: float, digits: int, is_judged: bool) -> str:
    if not np.isfinite(value):
        return '<td class="none">·</td>'
    share = min(max((value - good) / (bad - good), 0.0), 1.0) if bad != good else 0.0
    is_over = is_judged and ((value > bad) if bad > good else (value < bad))
    left, right = (_OVER, _OVER) if is_over else _JUDGED if is_judged else _NOT_JUDGED
    colour = "".join(f"{round(a + share * (b - a)):02x}" for a, b in zip(left, right, strict=True))
    kind = ' class="over"' if is_over else ""
    return f'<td{kind} style="background:#{colour}">{value:.{digits}f}</td>'
