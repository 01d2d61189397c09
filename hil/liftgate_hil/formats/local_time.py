"""Local times without a zone, as in headers of ASC, BLF and TRC and in date columns of text tables."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta, tzinfo
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# Months as CANoe writes them, in English or German (python-can's list), and what other tools make of March.
_MONTHS = {
    name: number
    for number, names in enumerate(
        (
            "jan", "feb", "mar mär mrz", "apr", "may mai", "jun", "jul", "aug", "sep", "oct okt", "nov", "dec dez",
        ),
        1,
    )
    for name in names.split()
}  # fmt: skip
_DATE = re.compile(
    r"(?:\w+[.,]?\s+)?(?P<month>[^\W\d]+)\.?\s+(?P<day>\d{1,2}),?\s+(?P<clock>\d{1,2}:\d\d:\d\d)(?:[.,](?P<part>\d+))?"
    r"(?:\s*(?P<half>[ap])\.?m\.?)?\s+(?P<year>\d{4})",
    re.IGNORECASE,
)
_ISO = re.compile(r"(?P<date>\d{4}-\d\d-\d\d)[T ]+(?P<clock>\d\d:\d\d:\d\d)(?:[.,](?P<part>\d+))?")
# PCAN-View's start in words, with ms and tenths of them.
_DOTTED = re.compile(
    r"(?P<day>\d{1,2})\.(?P<month>\d{1,2})\.(?P<year>\d{4})\s+(?P<clock>\d{1,2}:\d\d:\d\d)(?:\.(?P<ms>\d{3})(?:\.\d)?)?"
)
_DAY_0 = datetime(1899, 12, 30)  # of PEAK's $STARTTIME, in days


def epoch_us(stated: datetime, zone: tzinfo | None = None) -> int:
    """Return a time as µs since 1970, UTC; `zone` is the zone of a local time, None: this computer's.

    Raises ValueError, OverflowError, OSError if it cannot be expressed.
    """
    whole = stated.replace(microsecond=0, tzinfo=zone)
    return round(whole.timestamp()) * 1_000_000 + stated.microsecond


def local_of(us: int) -> datetime:
    """Return a time [µs since 1970, UTC] as this computer's local time, without a zone."""
    return datetime.fromtimestamp(us // 1_000_000) + timedelta(microseconds=us % 1_000_000)


def stated_in(text: str) -> datetime | None:
    """Return the date and time in a text of a log's header; None if it is not understood.

    Forms: `Mon Sep 29 01:00:00.000 pm 2025`, with or without weekday, fraction of a second, and am or pm,
    `2025-09-29 13:00:00` or `29.09.2025 13:00:00.000.0`. One or two digits after the point are milliseconds:
    python-can writes 1 ms as .1.
    """
    try:
        if iso := _ISO.fullmatch(text.strip()):
            whole = datetime.fromisoformat(f"{iso['date']} {iso['clock']}")
            return whole + timedelta(microseconds=_micros(iso["part"]))
        if dotted := _DOTTED.fullmatch(text.strip()):
            hour, minute, second = map(int, dotted["clock"].split(":"))
            day = int(dotted["year"]), int(dotted["month"]), int(dotted["day"])
            return datetime(*day, hour, minute, second, 1000 * int(dotted["ms"] or 0))
        found = _DATE.fullmatch(text.strip())
        month = _MONTHS.get(found["month"][:3].lower()) if found else None
        if found is None or month is None:
            return None
        hour, minute, second = map(int, found["clock"].split(":"))
        if found["half"] and 1 <= hour <= 12:
            hour = hour % 12 + (12 if found["half"].lower() == "p" else 0)
        whole = datetime(int(found["year"]), month, int(found["day"]), hour, minute, second)
        return whole + timedelta(microseconds=_micros(found["part"]))
    except (ValueError, OverflowError):
        return None


def _micros(part: str | None) -> int:
    """Return in µs the fraction of a second, given as digits; one or two digits are milliseconds."""
    if not part:
        return 0
    return int(part) * 1000 if len(part) < 3 else round(int(part) * 10.0 ** (6 - len(part)))


def of_system_time(fields: Sequence[int]) -> datetime | None:
    """Return the time of a Windows SYSTEMTIME (year, month, weekday, day, hour, minute, second, ms).

    None if it is not a valid time: zeros state that none is known.
    """
    year, month, _, day, hour, minute, second, millis = fields
    try:
        return datetime(year, month, day, hour, minute, second, millis * 1000)
    except ValueError:
        return None


def as_system_time(stated: datetime) -> tuple[int, ...]:
    """Return a time as a Windows SYSTEMTIME."""
    weekday = stated.isoweekday() % 7
    clock = stated.hour, stated.minute, stated.second, stated.microsecond // 1000
    return (stated.year, stated.month, weekday, stated.day, *clock)


def of_days(days: float) -> datetime | None:
    """Return the time given as days since 30 December 1899; None if the number is no valid time."""
    try:
        return _DAY_0 + timedelta(microseconds=round(days * 86_400_000) * 1000) if days > 0.0 else None
    except (ValueError, OverflowError):
        return None


def as_days(stated: datetime) -> float:
    """Return a time as days since 30 December 1899."""
    return (stated - _DAY_0) / timedelta(days=1)


_CLOCK = r"(?P<hour>\d{1,2}):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.,](?P<part>\d+))?)?"
_ZONE = r"(?P<zone>\s?(?:Z|UTC|[+-]\d\d:?\d\d))?"
# With slashes only the year may come first: 09/10/2025 is a day in September, or in October.
_FORMS = (
    re.compile(rf"(?P<year>\d{{4}})[-/.](?P<month>\d\d)[-/.](?P<day>\d\d)(?:(?:T|\s+){_CLOCK}{_ZONE})?"),
    re.compile(rf"(?P<day>\d{{1,2}})\.(?P<month>\d{{1,2}})\.(?P<year>\d{{4}})(?:,?\s+{_CLOCK}{_ZONE})?"),
    re.compile(_CLOCK),
)
_EPOCH_DAY = date(1970, 1, 1).toordinal()
_DAY_S, _NS = 86_400, 10**9
FORMS = "2025-09-29 13:00:00.5, 29.09.2025 13:00:00,5 or 13:00:00.5"  # for messages


class Stamp(NamedTuple):
    """Date with time, or time of day, that a cell of a table states."""

    ns: int  # since 1970, by the cell's clock or UTC, or since midnight
    is_date: bool  # false: a time of day
    is_utc: bool  # the cell states how far its clock is from UTC

    def epoch_ns(self, zone: tzinfo | None = None) -> int:
        """Return the date as ns since 1970, UTC; 0 for a time of day.

        `zone` is the zone of local times; None: this computer's.
        """
        if not self.is_date or self.is_utc:
            return self.ns if self.is_date else 0
        seconds, part = divmod(self.ns, _NS)
        return epoch_us(datetime.fromtimestamp(seconds, UTC), zone) * 1000 + part


def stamp_of(cell: str) -> Stamp | None:
    """Return the date or time of day in a cell; None if the cell is neither."""
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
        seconds += _DAY_S * (day.toordinal() - _EPOCH_DAY)
    if zone[:1] in ("+", "-"):
        seconds -= (3600 * int(zone[1:3]) + 60 * int(zone[-2:])) * (-1 if zone[0] == "-" else 1)
    return Stamp(seconds * _NS + int((parts["part"] or "").ljust(9, "0")[:9]), is_date, bool(zone))


def in_minutes(cell: str) -> bool:
    """Whether a cell is a time of day without seconds, which may be meant as minutes and seconds (mm:ss)."""
    found = re.fullmatch(_CLOCK, cell.strip())
    return found is not None and found["second"] is None


def seconds_since(first: Stamp, cells: Sequence[str], before: float = 0.0) -> NDArray[np.float64] | int:
    """Return cells (n,) of times as [s] since `first`, an empty one as NaN; or the index of an invalid cell.

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
