"""Offset between the times of two recordings whose times count from another instant, such as two bus logs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.formats.recording import Recording

Floats = NDArray[np.float64]

TIME_TOLERANCE_S = 1e-6  # formats keep microseconds, rounded or truncated
_COARSE_NS = 1_000_000  # resolution of the start time in ASC and TRC


def offset_of(shift_ns: int, first_ns: int, second_ns: int, tolerance_ns: int) -> int:
    """Return the offset [ns] between the times of two recordings, which is no difference of their content.

    `shift_ns` is the time of the first row or frame in the first recording minus that in the second, `first_ns`
    and `second_ns` are the wall clock at their time 0 (0: unknown). The offset is the difference of the wall
    clocks if the shift is that, too, within `tolerance_ns`; the shift, if it is so to the millisecond and a wall
    clock is not known more precisely; else 0.
    """
    by_clock = second_ns - first_ns
    if abs(shift_ns - by_clock) <= tolerance_ns:
        return by_clock
    is_coarse = any(each and each % _COARSE_NS == 0 for each in (first_ns, second_ns))
    return shift_ns if is_coarse and abs(shift_ns - by_clock) <= _COARSE_NS else 0


@dataclass(frozen=True, kw_only=True)
class ShiftedRows(Recording):
    """Rows of a recording with a constant added to their times."""

    source: Recording
    offset_s: float

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the file."""
        return self.source.notes

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of these columns, one block at a time; NaN: no value."""
        shift = np.array([self.offset_s if name == "time_s" else 0.0 for name in wanted])
        for rows in self.source.rows(wanted):
            yield rows + shift


def aligned(first: Recording, second: Recording, tolerance_ns: int) -> Recording:
    """Return the rows of the second recording with times that count from the time 0 of the first one."""
    begins = [_first_ns(each) for each in (first, second)]
    if begins[0] is None or begins[1] is None:
        return second
    offset = offset_of(begins[0] - begins[1], first.start_ns, second.start_ns, tolerance_ns)
    if not offset:
        return second
    return ShiftedRows(
        path=second.path, signals=second.signals, names=second.names, source=second, offset_s=1e-9 * offset
    )


def _first_ns(table: Recording) -> int | None:
    """Return the time of the first row [ns]; None: there is none, or its time is no number."""
    rows = next(table.rows(["time_s"]), None)
    return None if rows is None or not np.isfinite(rows[:1]).all() or not len(rows) else round(1e9 * rows[0, 0])
