"""Comparison of the frames of two recordings in their order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import ERROR, EXTENDED, FD_FLAGS, REMOTE, no_logged
from liftgate_hil.conversion.partners import TIME_TOLERANCE_S, offset_of
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.formats.recording import Recording

_FIELDS = {"identifier": "identifier", "length": "length", "is_sent": "direction", "payload": "data"}
_NONE = "none"


# fmt: off
@dataclass(frozen=True)
class FramesCompared(DescribedResult):
    """Result of the comparison of two recordings' frames."""

    counts: Annotated[tuple[int, int], Shown("number of frames: [first, second]")]
    first: Annotated[int | None, Shown("index from 0 of the first frame that differs; null: all are equal",
        key="first_unlike")]
    # in the first recording, if it has that frame
    time_s: Annotated[float, Shown("time of that frame [s]; null: all are equal")]
    what: Annotated[str, Shown("what differs in that frame; empty: nothing, or the other recording has "
        "ended")] = ""
    values: Annotated[tuple[str, str], Shown("that frame in words: [first, second]; empty: all are "
        "equal")] = ("", "")


# fmt: on


def compare_frames(
    first: Recording,
    second: Recording,
    time_tolerance: float = TIME_TOLERANCE_S,
    report: Callable[[int], None] = lambda frames: None,
) -> FramesCompared:
    """Compare the frames of two recordings in their order, with their times within `time_tolerance` [s].

    Times count from the start of the run or, if one recording does not know it, by the wall clock. `report` is
    called with the frames compared so far.
    """
    counts, offset, tolerance_ns = [0, 0], None, round(1e9 * time_tolerance)
    found = FramesCompared((0, 0), None, float("nan"))
    heads = [_Frames(first), _Frames(second)]
    while all(head.fill() for head in heads):
        count = min(len(head.block) for head in heads)
        here, there = (head.take(count) for head in heads)
        shift = here["time_ns"] - there["time_ns"]
        if offset is None:
            offset = offset_of(int(shift[0]), first.start_ns, second.start_ns, tolerance_ns)
        differs = {"time": abs(shift - offset) > tolerance_ns}
        for field, name in _FIELDS.items():
            own = here[field] != there[field]
            differs[name] = own.any(axis=1) if own.ndim > 1 else own
        bad = np.logical_or.reduce(list(differs.values()))
        if found.first is None and bad.any():
            at = int(np.argmax(bad))
            what = ", ".join(name for name, own in differs.items() if own[at])
            values = in_words(here[at]), in_words(there[at], offset)
            found = FramesCompared((0, 0), counts[0] + at, float(here["time_ns"][at] / 1e9), what, values)
        counts = [each + count for each in counts]
        report(counts[0])
    for place, head in enumerate(heads):
        while head.fill():
            if found.first is None:
                shift_ns = (offset or 0) if place else 0
                time = float((head.block["time_ns"][0] + shift_ns) / 1e9)
                values = (_NONE, in_words(head.block[0], shift_ns)) if place else (in_words(head.block[0]), _NONE)
                found = FramesCompared((0, 0), counts[place], time, "", values)
            counts[place] += len(head.take(len(head.block)))
    return FramesCompared((counts[0], counts[1]), found.first, found.time_s, found.what, found.values)


def in_words(frame: np.void, offset_ns: int = 0) -> str:
    """Return a frame as a line of text: time plus `offset_ns` [ns], direction, identifier, data."""
    identifier = int(frame["identifier"])
    number = identifier & ~FD_FLAGS & ~(EXTENDED | REMOTE | ERROR)
    kinds = [
        name
        for flag, name in ((EXTENDED, "extended"), (REMOTE, "remote"), (ERROR, "error"), (FD_FLAGS, "FD"))
        if identifier & flag
    ]
    data = bytes(frame["payload"][: int(frame["length"])]).hex(" ").upper()
    direction = "sent" if frame["is_sent"] else "received"
    shown = f"0x{number:X}" + (f" ({', '.join(kinds)})" if kinds else "")
    return f"{(int(frame['time_ns']) + offset_ns) / 1e9:.6f} s {direction} {shown}: {data or 'no data'}"


class _Frames:
    """Reader of a recording's frames, with one block at a time in memory."""

    def __init__(self, source: Recording) -> None:
        self._blocks = source.frames()
        self.block = no_logged()

    def fill(self) -> bool:
        """Read on until `block` holds frames; return False if the recording has no more."""
        while not len(self.block):
            following = next(self._blocks, None)
            if following is None:
                return False
            self.block = following
        return True

    def take(self, count: int) -> NDArray[np.void]:
        """Return the first `count` frames of `block`, and remove them from it."""
        taken, self.block = self.block[:count], self.block[count:]
        return taken
