"""Tracking of calls into a user's ECU code in this process, which may hang and cannot be killed separately.

This module imports nothing, so that code that only asks needs no ECU.
"""

from __future__ import annotations


class NoAnswerError(BaseException):
    """Exception that a signal handler raises to abort a hanging call; `except Exception` does not catch it."""


class ForeignCode:
    """Counts the calls of a user's code, each wrapped in this context manager."""

    def __init__(self) -> None:
        self._calls = 0
        self._depth = 0

    def __enter__(self) -> None:
        self._calls += 1
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        self._depth -= 1

    def call(self) -> int:
        """Return the ordinal number of the call of a user's code that is running; 0: none."""
        return self._calls if self._depth else 0


FOREIGN = ForeignCode()
