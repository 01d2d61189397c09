"""Decoder of trouble codes in an ECU's responses, from the frames of a run or of its recording.

This listener sends nothing: it reassembles what comes with the identifier of the response, whoever made the
request.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import Frames
from liftgate_hil.diagnostics import isotp
from liftgate_hil.diagnostics.services import answer_of
from liftgate_hil.diagnostics.tester import NO_FAILURE, NO_RESPONSE, Diagnostics
from liftgate_hil.diagnostics.trouble_code import number_of

NO_ANSWER = -1  # mark of a frame that completes no reading
MOST_CODES = 62  # bits of a mark


class Answers:
    """Decoder of responses in frames as they come; `codes` are the texts of the watched trouble codes."""

    def __init__(self, diagnostics: Diagnostics, codes: Sequence[str]) -> None:
        self._own = diagnostics
        self._codes = [number_of(each) for each in codes]
        self._link = isotp.new_link(diagnostics.request, diagnostics.response)
        self.refused = ""  # last refused request, and why
        self._times: list[float] = []  # s, of complete readings

    def marks(self, frames: Any) -> NDArray[np.int64]:
        """Return the marks (n,) of frames (n,) LOGGED: which trouble codes each of them reports.

        A frame that completes a reading has the watched trouble codes that it reports as its mark, one bit each in
        their order, any other frame NO_ANSWER.
        """
        found = np.full(len(frames), NO_ANSWER, dtype=np.int64)
        seen = Frames(len(frames), frames["identifier"], frames["length"], frames["payload"])
        for place in np.flatnonzero(seen.identifiers == self._own.response).tolist():
            length = isotp.hear(self._link, seen, place, int(frames["time_ns"][place]))
            answer = answer_of(isotp.message_in(self._link, length)) if length else None
            if answer is None:
                continue
            if answer.codes is None:
                self.refused = answer.refused
            else:
                self._times.append(1e-9 * float(frames["time_ns"][place]))
                found[place] = self._mark(
                    [code for code, status in answer.codes.items() if status & self._own.status_mask]
                )
        return found

    def last_before(self, time: float) -> float:
        """Return the time [s] of the last complete reading of trouble codes at or before `time`; NaN: none."""
        place = bisect.bisect_right(self._times, time)
        return self._times[place - 1] if place else math.nan

    @property
    def longest_wait(self) -> float:
        """Longest time [s] between two complete readings of trouble codes of an ECU that responds in time."""
        return self._own.period + self._own.patience

    def _mark(self, reported: Sequence[int]) -> int:
        """Return the mark of a reading: one bit for each watched code that is among the reported numbers."""
        return sum(
            1 << bit
            for bit, (number, mask) in enumerate(self._codes)
            if any(code & mask == number for code in reported)
        )


_RESET, _POSITIVE, _NEGATIVE, _BUSY, _PENDING = 0x11, 0x51, 0x7F, 0x21, 0x78


class ResetWatch:
    """Observer of frames that tells whether an ECUReset failed: refused, or without a response."""

    def __init__(self, diagnostics: Diagnostics) -> None:
        self._own = diagnostics
        self._is_asked = False
        self._failure = NO_FAILURE

    def take(self, frames: Any) -> None:
        """Observe the ECUReset requests and responses in further frames (n,) LOGGED."""
        for row in frames[
            (frames["identifier"] == self._own.request) | (frames["identifier"] == self._own.response)
        ]:
            length = int(row["payload"][0])
            payload = row["payload"][1 : 1 + min(length, 7)].tolist()
            if row["identifier"] == self._own.request:
                self._is_asked |= payload[:1] == [_RESET]
            elif self._is_asked and payload[:1] == [_POSITIVE]:
                self._is_asked = False
            elif self._is_asked and payload[:2] == [_NEGATIVE, _RESET] and len(payload) > 2:
                self._is_asked = payload[2] == _PENDING
                if payload[2] not in (_PENDING, _BUSY):
                    self._failure = payload[2]

    @property
    def failure(self) -> int:
        """Outcome of the observed resets, with the values of `tester.failure_of`."""
        if self._failure == NO_FAILURE and self._is_asked:
            return NO_RESPONSE
        return self._failure
