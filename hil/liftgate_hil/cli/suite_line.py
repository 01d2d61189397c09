"""Progress of a suite of scenarios: how many are done, which do not pass, which ones run."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.errors import printable
from liftgate_hil.loop.listener import Listener

if TYPE_CHECKING:
    from liftgate_hil.cli.progress import Progress
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.testing.suite import Case, Outcome


class QuietListener(Listener):
    """Listener of one run among many that reports alarms, and compilation, for which all runs wait."""

    def __init__(self, teller: Teller) -> None:
        self._teller = teller

    def alarm(self, text: str) -> None:
        """Pass on an alarm."""
        self._teller.say(text)

    def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
        """Pass the progress of a compilation on."""
        self._teller.compiles(name, seconds, expected)

    def compiled(self, name: str, seconds: float) -> None:
        """Pass the end of a compilation on."""
        self._teller.compiled(name, seconds)


class SuiteLine:
    """Counts scenarios that begin and end, and passes the numbers on to a progress."""

    def __init__(self, progress: Progress, count: int) -> None:
        self._progress = progress
        self._count = count
        self._running: list[str] = []
        self._verdicts: list[str] = []
        self._lock = threading.RLock()

    def began(self, case: Case) -> None:
        """Called from several threads when a scenario begins."""
        with self._lock:
            self._running.append(case.file)
        self._show()

    def ended(self, outcome: Outcome) -> None:
        """Called with the outcome of a scenario that has ended."""
        with self._lock:
            self._verdicts.append(outcome.verdict)
            if outcome.case.file in self._running:
                self._running.remove(outcome.case.file)
        self._show()

    def line(self) -> str:
        """Return the line: how many are done, how many do not pass so far, which ones run."""
        with self._lock:
            parts = [f"{len(self._verdicts)}/{self._count} done"]
            parts += [
                f"{self._verdicts.count(name)} {words}"
                for name, words in (("fail", "failed"), ("error", "with errors"), ("inconclusive", "inconclusive"))
                if name in self._verdicts
            ]
            if self._running:
                names = ", ".join(printable(Path(each).name) for each in self._running)
                parts.append(f"{len(self._running)} running: {names}")
        return "  ".join(parts)

    def _show(self) -> None:
        self._progress.update(len(self._verdicts), self._count, self.line())
