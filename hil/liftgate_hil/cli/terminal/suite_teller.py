"""Display of a suite of scenarios on the terminal: verdict of each, how many are done, which ones run."""

from __future__ import annotations

import itertools
import sys
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli.command import as_flags
from liftgate_hil.cli.terminal.progress import ProgressDisplay
from liftgate_hil.cli.terminal.streams import Output, put_whole
from liftgate_hil.cli.terminal.teller import Teller
from liftgate_hil.config.rig_fit import notes_on_fit
from liftgate_hil.errors import number_of, printable
from liftgate_hil.judging.verdict import PASS, line_of
from liftgate_hil.loop.listener import Listener
from liftgate_hil.loop.priority import in_one_line, refused_here
from liftgate_hil.testing.outcome import Case, Outcome, counts_of
from liftgate_hil.testing.tested import SuiteListener

if TYPE_CHECKING:
    from liftgate_hil.cli.stopping import StopSignals


class QuietListener(Listener):
    """Listener of one run among many that reports alarms, and compilation, for which all runs wait."""

    def __init__(self, teller: Teller) -> None:
        self._teller = teller

    def alarm(self, text: str) -> None:
        """Print an alarm of the run, unless messages are suppressed (--quiet)."""
        self._teller.say(text)

    def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
        """Show the progress of a compilation on the terminal."""
        self._teller.compiles(name, seconds, expected)

    def compiled(self, name: str, seconds: float) -> None:
        """Show on the terminal that a compilation has ended."""
        self._teller.compiled(name, seconds)


class SuiteTeller(SuiteListener):
    """Listener that prints the scenarios in their order, and shows how many are done and which ones run."""

    def __init__(self, teller: Teller, stop: StopSignals, is_quiet: bool, is_silent: bool) -> None:
        self.runs = QuietListener(teller)
        self.out = Output()
        self._teller = teller
        self._stop = stop
        self._is_quiet = is_quiet
        self._is_silent = is_silent  # stdout is for the JSON alone
        self._progress: ProgressDisplay | None = None
        self._cases: Sequence[Case] = ()
        self._running: list[str] = []
        self._outcomes: dict[str, Outcome] = {}
        self._printed = 0
        self._lock = threading.RLock()

    def words(self, text: str) -> str:
        """Return an issue with the flags in place of the arguments."""
        return as_flags(text)

    def say(self, text: str) -> None:
        """Print a message to stderr, unless quiet."""
        self._teller.say(text)

    def stopped(self) -> bool:
        """Whether a stop signal has been received."""
        return self._stop()

    def put(self, text: str) -> None:
        """Print a whole report to stdout. Raises as `Output.raise_if_lost`."""
        put_whole(text)

    def phase(self, name: str) -> ProgressDisplay:
        """Return the progress display of a phase of the suite, to be used as a context."""
        self._progress = self._teller.progress(name)
        return self._progress

    def prepared(self, cases: Sequence[Case]) -> None:
        """Print which real-time requests this machine refuses, and the notes on rigs and vehicles, each once."""
        self._cases = cases
        asked = cases[0].job.request
        if asked.clock == "realtime" and asked.realtime is not False and (refused := refused_here()):
            self._teller.say(in_one_line(refused))
        for note in dict.fromkeys(itertools.chain.from_iterable(map(_fit_of, cases))):
            self._teller.say(f"note: {note}")

    def began(self, case: Case) -> None:
        """Show that a scenario runs."""
        with self._lock:
            self._running.append(case.file)
        self._show()

    def ended(self, outcome: Outcome) -> None:
        """Show that a scenario has ended; print its verdict once all scenarios before it have ended."""
        with self._lock:
            self._outcomes[outcome.case.file] = outcome
            if outcome.case.file in self._running:
                self._running.remove(outcome.case.file)
        with self._teller.aside():
            while self._printed < len(self._cases) and self._cases[self._printed].file in self._outcomes:
                if not self._is_silent:
                    self.out.put(self._lines(self._outcomes[self._cases[self._printed].file], self._printed + 1))
                self._printed += 1
        self._show()

    def mutated(self, done: int, count: int) -> None:
        """Show how many runs with mutants are done."""
        if self._progress is not None:
            self._progress.update(done, count, f"{done}/{count} runs with mutants")

    def line(self) -> str:
        """Return how many scenarios are done, how many do not pass so far, and which ones run."""
        with self._lock:
            verdicts = [each.verdict for each in self._outcomes.values()]
            parts = [f"{len(verdicts)}/{len(self._cases)} done"]
            parts += [
                f"{verdicts.count(name)} {words}"
                for name, words in (("fail", "failed"), ("error", "with errors"), ("inconclusive", "inconclusive"))
                if name in verdicts
            ]
            if self._running:
                names = ", ".join(printable(Path(each).name) for each in self._running)
                parts.append(f"{len(self._running)} running: {names}")
        return "  ".join(parts)

    def _show(self) -> None:
        if self._progress is not None:
            self._progress.update(len(self._outcomes), len(self._cases), self.line())

    def _lines(self, outcome: Outcome, done: int) -> list[str]:
        """Return the lines on the `done`-th scenario: verdict, expectations, notes; if quiet, not what passes."""
        if self._is_quiet and outcome.verdict == PASS:
            return []
        lines = [f"[{done}/{len(self._cases)}] {outcome.verdict:<12} {outcome.case.file}  {outcome.wall_s:.2f} s"]
        told = [replace(each, reason=as_flags(each.reason)) for each in outcome.expectations]
        shown = [each for each in told if not self._is_quiet or each.verdict != PASS]
        whole, is_told = as_flags(outcome.reason), False
        for each in shown:
            is_again = is_told and each.reason == whole
            is_told = is_told or (bool(whole) and each.reason == whole)
            lines.append(f"    {printable(each.name)}: {line_of(replace(each, reason='') if is_again else each)}")
        if whole and not is_told:
            lines.insert(1, f"    {whole}")
        known = _fit_of(outcome.case)  # printed once for all scenarios
        notes = [printable(as_flags(each)) for each in outcome.notes if each not in known]
        lines += [f"    note: {each}" for each in notes]
        return [each.replace("\n", f"\n{' ' * 8}") for each in lines]  # a reason may have several lines


class JudgeTeller(SuiteTeller):
    """Listener that prints the verdicts on recordings, run by run."""

    def prepared(self, cases: Sequence[Case]) -> None:
        """Store the cases of the recorded runs."""
        self._cases = cases

    def ended(self, outcome: Outcome) -> None:
        """Print the verdicts on a recorded run, with the notes on how it was read."""
        self._outcomes[outcome.case.file] = outcome
        done, count = len(self._outcomes), len(self._cases)
        with self._teller.aside():
            for note in () if outcome.result is None else outcome.result.notes:
                print(printable(f"liftgate-hil judge: note: {note}"), file=sys.stderr)
            if not self._is_silent:
                self.out.put(self._judged_lines(outcome, count > 1))
        if self._progress is not None:
            self._progress.update(done, count, f"{done}/{count} runs" if count > 1 else "")

    def _judged_lines(self, outcome: Outcome, is_named: bool) -> list[str]:
        """Return the printed lines on a recorded run's verdicts; `is_named`: below a line that names its files."""
        indent, lines = "    " if is_named else "", list[str]()
        if is_named and not (self._is_quiet and outcome.verdict == PASS):
            lines.append(printable(f"{outcome.verdict:<12} {', '.join(map(str, outcome.case.recordings))}"))
        if outcome.reason:
            return [*lines, f"{indent}{printable(as_flags(outcome.reason))}"]
        return lines + [
            f"{indent}{printable(each.name)}: {line_of(replace(each, reason=as_flags(each.reason)))}"
            for each in outcome.expectations
            if not (self._is_quiet and each.verdict == PASS)
        ]


def _fit_of(case: Case) -> list[str]:
    """Return the notes on mismatches between the rig and the vehicle of a scenario."""
    return notes_on_fit(case.plan.rig, case.plan.setup.vehicle, case.plan.request.rate)


def summary_of(outcomes: Sequence[Outcome], what: str) -> list[str]:
    """Return a list with the last line of output: how many expectations have which verdict.

    `what` names what was judged, in the plural: "scenarios", "recordings".
    """
    counts = counts_of(outcomes)
    text = ", ".join(f"{number} {name}" for name, number in counts.by_verdict().items() if number)
    runs, judged = number_of(len(outcomes), what.removesuffix("s")), number_of(counts.total, "expectation")
    return [f"{runs}, {judged}: {text}; {100.0 * counts.inconclusive_share:.0f} % inconclusive"]
