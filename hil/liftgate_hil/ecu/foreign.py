"""Whether code of a user's runs in this process: it may hang, and cannot be killed as a process can.

Imports nothing, so that those who ask need not have an ECU.
"""

from __future__ import annotations


class NoAnswerError(BaseException):
    """Ends a call that does not come back, from a signal handler; no `except Exception` in it keeps that."""


class ForeignCode:
    """Use it as a context around each call."""

    def __init__(self) -> None:
        self._calls = 0
        self._depth = 0

    def __enter__(self) -> None:
        self._calls += 1
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        self._depth -= 1

    def call(self) -> int:
        """The number of the call that is under way; 0: none."""
        return self._calls if self._depth else 0


FOREIGN = ForeignCode()
