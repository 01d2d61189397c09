"""Columns of dates and times of day in text tables."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, date, datetime, tzinfo
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.formats.local_time import epoch_us

_CLOCK = r"(?P<hour>\d{1,2}):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.,](?P<part>\d+))?)?"
_ZONE = r"(?P<zone>\s?(?:Z|UTC|[+-]\d\d:?\d\d))?"
# With slashes only the year may come first: 09/10/2025 is a day in September, or in October.
_FORMS = (
    re.compile(rf"(?P<year>\d{{4}})[-/.](?P<month>\d\d)[-/.](?P<day>\d\d)(?:(?:T|\s+){_CLOCK}{_ZONE})?"),
    re.compile(rf"(?P<day>\d{{1,2}})\.(?P<month>\d{{1,2}})\.(?P<year>\d{{4}})(?:,?\s+{_CLOCK}{_ZONE})?"),
    re.compile(_CLOCK),
)
_DAY_0 = date(1970, 1, 1).toordinal()
_DAY_S, _NS = 86_400, 10**9
FORMS = "2025-09-29 13:00:00.5, 29.09.2025 13:00:00,5 or 13:00:00.5"  # for messages


class Stamp(NamedTuple):
    """Moment that a cell states."""

    ns: int  # since 1970, by the cell's clock or UTC, or since midnight
    is_date: bool  # false: a time of day
    is_utc: bool  # the cell states how far its clock is from UTC

    def epoch_ns(self, zone: tzinfo | None = None) -> int:
        """Return the moment as ns since 1970, UTC; 0 for a time of day.

        `zone` is that of local times; None: this computer's.
        """
        if not self.is_date or self.is_utc:
            return self.ns if self.is_date else 0
        seconds, part = divmod(self.ns, _NS)
        return epoch_us(datetime.fromtimestamp(seconds, UTC), zone) * 1000 + part


def stamp_of(cell: str) -> Stamp | None:
    """Return the moment that a cell states; None if it states none."""
    found = next((match for form in _FORMS if (match := form.fullmatch(cell.strip()))), None)
    if found is None:
        return None
    parts = found.groupdict()
    hour, minute, second = (int(parts[name] or 0) for name in ("hour", "minute", "second"))
    if hour > 23 or minute > 59 or second > 60:
        return None
    seconds, zone = 3600 * hour + 60 * minute + second, (parts.get("zone") or "").strip()
    is_date = "year" in parts
    if is_date:
        try:
            day = date(int(parts["year"]), int(parts["month"]), int(parts["day"]))
        except ValueError:
            return None
        seconds += _DAY_S * (day.toordinal() - _DAY_0)
    if zone[:1] in ("+", "-"):
        seconds -= (3600 * int(zone[1:3]) + 60 * int(zone[-2:])) * (-1 if zone[0] == "-" else 1)
    return Stamp(seconds * _NS + int((parts["part"] or "").ljust(9, "0")[:9]), is_date, bool(zone))


def in_minutes(cell: str) -> bool:
    """Whether a cell is a time of day without seconds, which may be meant as minutes and seconds."""
    found = re.fullmatch(_CLOCK, cell.strip())
    return found is not None and found["second"] is None


def seconds_since(first: Stamp, cells: Sequence[str], before: float = 0.0) -> NDArray[np.float64] | int:
    """Return the moments of cells (n,) [s] since `first`, NaN for an empty one; or the place of a wrong one.

    A time of day that is half a day and more below the last one, `before` [s], is of the next day.
    """
    times = np.full(len(cells), np.nan)
    for place, cell in enumerate(cells):
        if not cell.strip():
            continue
        stamp = stamp_of(cell)
        if stamp is None or stamp[1:] != first[1:]:
            return place
        since_ns = stamp.ns - first.ns
        if not first.is_date and since_ns / _NS < before - 0.5 * _DAY_S:
            since_ns += _DAY_S * _NS * round((before - since_ns / _NS) / _DAY_S)
        times[place] = before = since_ns / _NS
    return times
