"""Selection of the frames of a recording to be played, and their due times."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import ERROR, FD
from liftgate_hil.errors import ConfigError

if TYPE_CHECKING:
    from cantools.database.can import Message

_NUMBER = 0x1FFFFFFF  # bits of an identifier without its flags
# If a timestamp is so much earlier than the one before, the logger's clock was set back.
_SET_BACK_NS = 100_000_000

Blocks = Iterator[NDArray[np.void]]


@dataclass(frozen=True)
class Selection:
    """Selection of a recording's frames by time [s], ends included, direction, and identifiers in or left out."""

    direction: str = ""  # sent, received or both; empty: sent if there are such frames, else both
    only: tuple[tuple[int, int], ...] = ()  # ranges of identifiers, both ends included; none: all
    without: tuple[tuple[int, int], ...] = ()  # ranges of identifiers that are left out
    begin: float = -math.inf
    end: float = math.inf

    def of(self, blocks: Blocks) -> Blocks:
        """Yield the selected frames of each block."""
        for frames in blocks:
            times = frames["time_ns"] * 1e-9
            keep = (times >= self.begin) & (times <= self.end)
            if self.direction in ("sent", "received"):
                keep &= (frames["is_sent"] != 0) == (self.direction == "sent")
            if self.only:
                keep &= _among(frames, self.only)
            if self.without:
                keep &= ~_among(frames, self.without)
            if keep.any():
                yield frames[keep]


def _among(frames: NDArray[np.void], ranges: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """Return the mask (n,) of the frames whose identifier is in one of the ranges, both ends included."""
    numbers = frames["identifier"] & _NUMBER
    found = np.zeros(len(frames), dtype=bool)
    for low, high in ranges:
        found |= (numbers >= low) & (numbers <= high)
    return found


def identifiers_of(
    argument: str, given: Sequence[str], messages: Mapping[str, Message]
) -> tuple[tuple[int, int], ...]:
    """Return the ranges of identifiers in an argument: 0x120, 0x200-0x2FF, or a message of the rig.

    Raises ConfigError.
    """
    found, issues = list[tuple[int, int]](), list[str]()
    for name in given:
        if name in messages:
            found.append((messages[name].frame_id,) * 2)
            continue
        first, dash, last = name.partition("-")
        low = _number(first)
        high = _number(last) if dash else low
        if not 0 <= low <= high <= _NUMBER:
            issues.append(
                f"`{argument}` {name}: allowed: 0x0 to 0x{_NUMBER:X}, a range such as 0x200-0x2FF, or a message "
                "of the rig"
            )
        found.append((low, high))
    if issues:
        raise ConfigError(issues)
    return tuple(found)


def _number(text: str) -> int:
    """Parse an identifier that begins with 0x; else return -1: 120 is 0x120 in candump, 0x78 elsewhere."""
    try:
        return int(text, 16) if text.strip().lower().startswith("0x") else -1
    except ValueError:
        return -1


@dataclass
class DueTimes:
    """Schedule of a replay: computes when frames are due [ns since the beginning], round by round.

    `begin` [s] is the recording's time at which a round begins, by default that of the first frame; `end` is that
    at which it ends, by default that of the last frame.
    """

    speed: float = 1.0
    begin: float = -math.inf
    end: float = math.inf
    set_back: int = field(default=0, init=False)  # times that the logger's clock was set back
    _round: int = field(default=0, init=False)  # when the round began
    _origin: int | None = field(default=None, init=False)  # the recording's time at that moment
    _last: int = field(default=0, init=False)  # timestamp of the frame read last
    _shift: int = field(default=0, init=False)  # ns that the logger's clock was set back by
    _due: int = field(default=0, init=False)  # when the last frame is due

    def due(self, frames: NDArray[np.void]) -> NDArray[np.int64]:
        """Return the due times (n,) of frames (n,) of dtype LOGGED, in the order of the recording.

        None is due before the one that precedes it; where the logger's clock was set back, time continues.
        """
        times = frames["time_ns"].astype(np.int64)
        if self._origin is None:
            has_begin = math.isfinite(self.begin)
            self._origin = round(self.begin * 1e9) if has_begin else int(times[0])
            self._last, self._shift = int(times[0]), 0
        steps = np.diff(times, prepend=self._last)
        jumps = np.where(steps < -_SET_BACK_NS, -steps, 0)
        since = times + self._shift + np.cumsum(jumps) - self._origin
        self._last, self._shift = int(times[-1]), self._shift + int(jumps.sum())
        self.set_back += int(np.count_nonzero(jumps))
        due = self._round + np.round(since / self.speed).astype(np.int64)
        due = np.maximum.accumulate(np.maximum(due, self._due))
        self._due = int(due[-1])
        return due

    def begin_again(self) -> None:
        """Begin the next round where the present one ends. Raises ConfigError if a round takes no time."""
        ended = self._due
        if math.isfinite(self.end) and self._origin is not None:
            ended = max(ended, self._round + round((self.end * 1e9 - self._origin) / self.speed))
        if ended <= self._round:
            raise ConfigError("all frames have the same time; allowed: one round, or with `to_s`")
        self._round = self._due = ended
        self._origin = None


def playable(frames: NDArray[np.void], is_fd: bool) -> tuple[NDArray[np.void], int]:
    """Return the frames that can be sent, and the number of error frames, which cannot.

    Raises ConfigError for CAN FD frames on another bus.
    """
    fd = frames["identifier"] & FD != 0
    if fd.any() and not is_fd:
        at = frames["time_ns"][int(np.argmax(fd))] * 1e-9
        raise ConfigError(f"the frame at {at:.6f} s is CAN FD; allowed: with `is_fd`")
    errors = frames["identifier"] & ERROR != 0
    left_out = int(np.count_nonzero(errors))
    return (frames[~errors] if left_out else frames), left_out
