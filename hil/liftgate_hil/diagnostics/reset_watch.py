"""Check from the frames of a recorded run whether each ECUReset that a tester requested was made."""

from __future__ import annotations

from typing import Any

from liftgate_hil.diagnostics.tester import NO_FAILURE, NO_RESPONSE, Diagnostics

_RESET, _POSITIVE, _NEGATIVE, _BUSY, _PENDING = 0x11, 0x51, 0x7F, 0x21, 0x78


class ResetWatch:
    """Observes frames as they come: single frames of ISO-TP, as an ECUReset and its responses are."""

    def __init__(self, diagnostics: Diagnostics) -> None:
        self._own = diagnostics
        self._is_asked = False
        self._failure = NO_FAILURE

    def take(self, frames: Any) -> None:
        """Process frames (n,) LOGGED."""
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
        """The outcome of the resets, with the values of `tester.failure_of`."""
        if self._failure == NO_FAILURE and self._is_asked:
            return NO_RESPONSE
        return self._failure
