"""Recordings of a run that are written in its own process."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from liftgate_hil.formats.guarded import Say, failures_of
from liftgate_hil.formats.open import open_writers
from liftgate_hil.isolate.recorders import RecordingSink
from liftgate_hil.plan.recording_trigger import Triggered

if TYPE_CHECKING:
    from liftgate_hil.formats.content import Content
    from liftgate_hil.loop.observers import Sink
    from liftgate_hil.loop.statistics import Summary
    from liftgate_hil.plan.plan import Plan


class Recordings:
    """Files to which a run is recorded, open until the stack is left.

    `sinks` write the run's rows and frames to them; there is none where nothing is recorded. No wall
    clock applies: the recordings are the same every time.
    """

    def __init__(self, plan: Plan, content: Content, say: Say, stack: contextlib.ExitStack) -> None:
        request = plan.request
        self._writers = open_writers(request.recordings, content, request.limit(), say, stack)
        self._triggered = None if plan.trigger is None else Triggered(plan.trigger)
        sink = RecordingSink(self._writers, content, self._triggered)
        stack.callback(sink.flush)  # before the files are closed
        self.sinks: list[Sink] = [sink] if self._writers else []

    def mark(self, time_s: float, text: str) -> bool:
        """Write an operator's mark at a time [s] of the run; False: a recording has ended."""
        for each in self._writers:
            each.write_mark(time_s, text)
        return not any(each.failure for each in self._writers)

    def note(self, summary: Summary) -> None:
        """Enter files and windows in the figures of the run; they are whole once the stack is closed."""
        summary.recordings = [file for each in self._writers for file in each.files]
        if self._triggered is not None:
            summary.recording_windows = self._triggered.count

    def failures(self) -> list[str]:
        """Return why files are not complete."""
        return failures_of(self._writers)
