"""Text of a comparison of two recordings: a table of the columns that differ, other differences, the verdict."""

from __future__ import annotations

import math

from liftgate_hil.conversion.compare import Comparison, Difference
from liftgate_hil.conversion.compare_frames import FramesCompared
from liftgate_hil.errors import number_of, with_unit


def comparison_lines(found: Comparison, names: tuple[object, object]) -> list[str]:
    """Return the comparison of two recordings with these names as lines of text."""
    unlike = [each for each in found.columns if each.at is not None]
    rows = [("column", "first difference", "largest difference", "rms", "tolerance")] if unlike else []
    rows += [_cells(each) for each in unlike]
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    if found.columns:
        same = len(found.columns) - len(unlike)
        lines.append(f"{same} of {len(found.columns)} columns are the same in all {found.rows} rows")
    for name, count, missing in zip(names, found.alone, found.missing, strict=True):
        if count:
            lines.append(f"{number_of(count, 'row')} only in {name}")
        if missing:
            text = ", ".join(missing[:8]) + (", …" if len(missing) > 8 else "")
            lines.append(f"{number_of(len(missing), 'column')} only in {name}: {text}")
    if found.frames is not None:
        lines += _frame_lines(found.frames, names)
    lines.append("equal" if found.is_equal else "different")
    return lines


def _cells(found: Difference) -> tuple[str, str, str, str, str]:
    """Return the table cells of a column that differs; numbers have their unit."""
    assert found.at is not None
    first = "within the tolerance"
    if found.first is not None:
        values = " and ".join(_number(each, found.unit) for each in found.first[1:])
        first = f"{found.first.time_s:.6f} s: {values}"
    largest = "no value in one" if math.isnan(found.largest) else with_unit(f"{found.largest:.6g}", found.unit)
    return (
        found.name,
        first,
        f"{largest} at {found.at.time_s:.6f} s",
        with_unit(f"{found.rms:.4g}", found.unit),
        with_unit(f"{found.tolerance:g}", found.unit) + ("" if found.is_equal else ": different"),
    )


def _number(value: float, unit: str) -> str:
    return "no value" if math.isnan(value) else with_unit(f"{value:.6g}", unit)


def _frame_lines(found: FramesCompared, names: tuple[object, object]) -> list[str]:
    first, second = found.counts
    if found.first is None:
        return [f"{number_of(first, 'frame')}, the same"]
    what = f" ({found.what})" if found.what else ""
    return [
        f"{first} and {number_of(second, 'frame')}; the first difference is at frame {found.first + 1}{what}:",
        *(f"  {name}: {frame}" for name, frame in zip(names, found.values, strict=True)),
    ]
