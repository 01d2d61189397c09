"""Clocks of a run's recordings: where each file's times begin, so that all count from the same moment."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations

from liftgate_hil.errors import ConfigError
from liftgate_hil.testing.run_file import LATEST_S, RunFile

_NEAR_0_S = 1.0  # s, of time 0: a bus log that begins there counts from when its logger was started
_ROUNDED, _HEADER_US = (".asc", ".trc"), 1000  # formats whose times count from a start in whole ms of the header
_HOUR_S, _NEAR_S = 3600.0, 60.0  # s, by how much two clocks of one moment may differ, besides whole hours


def set_clocks(files: Sequence[RunFile], origin: float | None) -> None:
    """Set where each file's times begin, so that all count from the same moment. Raises ConfigError.

    Files by the wall clock are brought together by it, where all have one. A log whose header states it counts
    from its own beginning where others have none. Files of other tools begin with their first sample, or at
    `origin` by their own times; a log that begins within a second of its time 0 keeps that.
    """
    timed = [each for each in files if each.span is not None]
    walls = {each.path: wall for each in timed if (wall := each.wall_us) is not None}
    ours = next((each for each in timed if each.is_ours), None)
    if origin is not None and ours is not None:
        text = f"`origin` {origin:g}: {ours.path} states its own time 0"
        raise ConfigError(f"{text}; allowed: with recordings of other tools")
    if not walls:
        if ours is None and timed:
            begin_us = _begin_us(timed) if origin is None else round(1e6 * origin)
            for each in timed:
                each.zero_us = begin_us
        return
    start_us = max((walls[each.path] for each in timed if each.is_ours and each.path in walls), default=None)
    without = [each for each in timed if each.path not in walls]
    if without and start_us is None:
        absolute = next((each for each in timed if each.path in walls and each.is_absolute), None)
        if absolute is None:
            return
        text = f"wall-clock timestamps, but none in {without[0].path}"
        raise ConfigError(
            f"{absolute.path}: {text}; allowed: the same clock in both, or a recording of this program that "
            "states its start, as those of runs in real time do"
        )
    if start_us is None:
        begins = [(math.floor(1e6 * each.span[0]), walls[each.path]) for each in timed if each.span is not None]
        first_us, wall_us = min(begins, key=sum)
        own_us = 0 if origin is not None and origin > LATEST_S else wall_us  # or by the wall clock itself
        start_us = own_us + round(1e6 * origin) if origin is not None else wall_us + first_us
    for each in timed:
        if each.path in walls:
            zero_us = start_us - walls[each.path]
            # Times since a start that the header rounds to milliseconds are those since the run's own.
            is_same = each.path.suffix.lower() in _ROUNDED and abs(zero_us) < _HEADER_US
            each.zero_us = 0 if is_same else zero_us
    _check_hours(timed)


def _begin_us(files: Sequence[RunFile]) -> int:
    """Return where a run begins in files of other tools that have no wall clock [µs by their times]."""
    first = min(each.span[0] for each in files if each.span is not None)
    is_kept = all(each.table is None for each in files) and 0.0 <= first <= _NEAR_0_S
    return 0 if is_kept else math.floor(1e6 * first + 1e-3)


def _check_hours(files: Sequence[RunFile]) -> None:
    """Raise ConfigError if two files of a run are whole hours apart: one header states another zone's time."""
    spans = [(each, each.span, 1e-6 * each.zero_us) for each in files if each.span is not None]
    ends = [(each, span[0] - zero, span[1] - zero) for each, span, zero in spans]
    for (one, low, high), (other, begin, end) in combinations(ends, 2):
        hours = round((begin - low) / _HOUR_S)
        is_apart = (begin > high or end < low) and abs(begin - low - hours * _HOUR_S) < _NEAR_S
        if hours and is_apart:
            late, early = (other, one) if hours > 0 else (one, other)
            raise ConfigError(
                f"{late.path}: {abs(hours)} h after {early.path}, as if one header had another zone's time; "
                "allowed: files of one run, or `timezone` for headers from elsewhere"
            )


def notes_on_begin(file: RunFile) -> Iterable[str]:
    """Yield notes on where a run begins in a file of another tool."""
    if file.is_ours or file.span is None:
        return
    first, zero = file.span[0], 1e-6 * file.zero_us
    if first < zero - 1e-6:
        yield f"{file.path}: begins {zero - first:.6g} s before time 0 of the run; what precedes it is not judged"
    elif file.zero_us and file.wall_us is None:
        yield f"{file.path}: begins at {first:.9g} s; the run's time 0 is at {zero:.9g} s"
