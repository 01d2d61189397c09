"""Time without progress of another process, counted only while this process could look."""

from __future__ import annotations

import time

_GAP_S = 0.5  # s, the most that counts between two looks


class Stillness:
    """Time for which a value that shows another process's progress has not changed.

    It is counted from look to look, and of a longer gap only 0.5 s: while a machine is so busy, or stands still,
    that this process cannot look, the other cannot go on either.
    """

    def __init__(self) -> None:
        self._value: object = None
        self._looked = time.monotonic()
        self._seconds = 0.0

    def of(self, value: object) -> float:
        """Look at the value, and return for how long it has not changed [s]."""
        now = time.monotonic()
        self._seconds += min(now - self._looked, _GAP_S)
        self._looked = now
        if value != self._value:
            self._value, self._seconds = value, 0.0
        return self._seconds
