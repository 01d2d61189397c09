"""The judge of a run: evaluates rows and frames as they come, and returns the verdicts at the end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compiled
from liftgate_hil.codec.frames import no_logged
from liftgate_hil.conditions.evaluator import Work
from liftgate_hil.diagnostics.answers import Answers
from liftgate_hil.judging.comparisons import comparisons_of
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.judging.expected import FIRST_S, Expected, tables_of
from liftgate_hil.judging.failure import failure_of, shown_time
from liftgate_hil.judging.stepped_again import LONGEST, StepAgain, stepped_again
from liftgate_hil.judging.stimulus_times import brief_faults, never_made
from liftgate_hil.judging.table import SLACK, Progress, judge_block
from liftgate_hil.judging.timeliness import Timeliness
from liftgate_hil.judging.verdict import DIRECT, ERROR, FAIL, INCONCLUSIVE, PASS, PENDING, Verdict
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH

_NO_MARKS = np.zeros(0, dtype=np.int64)
_TIME = COLUMN_PLACE["time_s"]


@dataclass(frozen=True)
class Gap:
    """Time span [s] in which some columns were not recorded; without names: all columns."""

    begin: float
    end: float
    names: frozenset[str] = frozenset()
    is_thinned: bool = False  # rows were left out evenly: what one of them shows is seen, what none shows is not


class Judge:
    """Sink that judges the expectations of a run from rows and frames as they come.

    `rate` [Hz] is that of the rows, `end` [s] that of the run and of every window. A frame may wait for
    `tolerance` [s] until the gate processes it; None: on the rows' clock none waits, and the bench is never late.
    After a lateness of more than `silence` [s] an ECU may have taken messages of the gate for lost, and nothing
    more can be said of it.
    """

    def __init__(
        self,
        expected: Expected,
        rate: float,
        end: float,
        tolerance: float | None = None,
        silence: float = LONGEST,
        work: Work | None = None,
    ) -> None:
        self.expected = expected
        self._silence = silence
        self._step = 1.0 / rate
        self._timeliness = None if tolerance is None else Timeliness(tolerance, 1.0 / rate)
        self.end = end
        self._last = -math.inf
        self._began_deg = math.nan  # gate angle in the first row that has one
        self._not_made = 0.0  # stimuli that could not be applied, at the last row
        self._frames = no_logged()
        self._marks = _NO_MARKS
        self._answers = Answers(expected.diagnostics, expected.codes) if expected.diagnostics else None
        self._run = compiled(judge_block)
        self._tables, self._judged = tables_of(expected, rate, end, work)
        self._final: list[Progress] = []
        self._judge(np.zeros((0, ROW_WIDTH)), no_logged(), _NO_MARKS)  # compiles in advance

    @property
    def reads_the_bus(self) -> bool:
        """Whether the judge needs the frames on the bus."""
        return bool(self.expected.signals or self.expected.codes)

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Judge rows (n, ROW_WIDTH) and the frames up to their time; later frames wait for their rows."""
        self._final = []
        if not self.reads_the_bus:
            frames = no_logged()
        marks = _NO_MARKS
        if self._answers is not None:
            marks = np.concatenate([self._marks, self._answers.marks(frames)])
        if len(self._frames):
            frames = np.concatenate([self._frames, frames])
        if not len(rows):
            self._frames, self._marks = np.array(frames), marks
            return
        if len(frames) and (np.diff(frames["time_ns"]) < 0).any():  # some came while the gate was sending
            frames = frames[np.argsort(frames["time_ns"], kind="stable")]
        if self._timeliness is not None:
            self._timeliness.take(rows)
        if self._last < FIRST_S and math.isnan(self._began_deg):
            self._began_deg = _first_angle(rows)
        last, inside = float(rows[-1, _TIME]), len(rows)
        if last > self.end + SLACK:
            inside = int(np.searchsorted(rows[:, _TIME], self.end + SLACK, side="right"))
        if inside:
            self._not_made = float(rows[inside - 1, COLUMN_PLACE["stimuli_not_made"]])
        self._last = max(self._last, min(last, self.end))
        seen = self._judge(rows, frames, marks)
        self._frames = np.array(frames[seen:]) if seen < len(frames) else no_logged()
        self._marks = marks[seen:]

    def _judge(self, rows: NDArray[np.float64], frames: Any, marks: Any) -> int:
        """Judge rows with frames and the frames' marks of trouble codes.

        Returns how many frames belong to these rows; the others wait for later ones.
        """
        frames = frames.view(np.recarray)
        payloads = np.ascontiguousarray(frames["payload"])
        return int(self._run(self._tables, self._judged, rows, frames, payloads, marks, self.end))

    def _progress(self, place: int) -> Progress:
        """Return an expectation's row of PROGRESS; at the end a cached copy, as records are slow to read."""
        if self._final:
            return self._final[place]
        return Progress(*self._judged.progress[place].tolist())

    def verdicts(
        self, error: str = "", late: str = "", gaps: Sequence[Gap] = (), again: StepAgain | None = None
    ) -> list[Verdict]:
        """Return the final verdicts in the order of the scenario file.

        `error` is why the run did not reach its end; `late` is how late the bench itself was, or which stimuli
        could not be applied, so that no verdict on the ECU is possible; `gaps` is what was not recorded. Where the
        bench's lateness may have decided, `again` simulates the run again.
        """
        if self._not_made > 0.0 and not late:
            late = f"the bench did not apply {self._not_made:g} of the requested stimuli"
        self._final = [Progress(*each) for each in self._judged.progress.tolist()]
        count = len(self.expected.expectations) - self.expected.awaited
        found = [self._in_gaps(place, self._verdict(place, error), gaps) for place in range(count)]
        found = [self._on_time(place, each, again) for place, each in enumerate(found)]
        found = self._hindered(found, late, gaps)
        return [replace(each, window_s=self.window(place)) for place, each in enumerate(found)]

    def so_far(self) -> list[Verdict]:
        """Return the verdicts decided so far, PENDING for the others, in the order of the scenario file.

        The bench's lateness, which is known only at the end, may still change them.
        """
        count = len(self.expected.expectations) - self.expected.awaited
        found = []
        for place in range(count):
            progress = self._progress(place)
            is_over = bool(progress.is_decided) or self._last >= min(progress.end, self.end) - SLACK
            name = self.expected.expectations[place].name
            found.append(self._verdict(place, "") if is_over else Verdict(name, PENDING))
        return found

    def spoilt(self) -> str:
        """Return as text the lateness of the bench that prevents any further verdicts; "": there is none."""
        if self._timeliness is None:
            return ""
        worst = self._timeliness.worst(0.0, self._last)
        is_too_late = worst.seconds > self._silence + SLACK
        places = range(len(self.expected.expectations) - self.expected.awaited)
        return worst.text if is_too_late and not all(self._progress(each).is_decided for each in places) else ""

    def late(self) -> str:
        """Return as text when the bench was later than tolerated in the run; "": it was not."""
        if self._timeliness is None:
            return ""
        found = self._timeliness.worst(0.0, math.inf)
        return found.text if found.seconds > self._timeliness.tolerance else ""

    def _on_time(self, place: int, verdict: Verdict, again: StepAgain | None) -> Verdict:
        """Return the verdict; inconclusive where the bench was late and no simulation confirms the verdict.

        The check is by `stepped_again`; the verdict's method says how. A failure, or a verdict whose trigger
        never came, reports lateness before, which may have led to it.
        """
        progress, timeliness = self._progress(place), self._timeliness
        if timeliness is None or verdict.verdict == ERROR:
            return verdict
        begin, is_opened = float(progress.begin), not np.isnan(progress.begin)
        before = timeliness.worst(0.0, begin if is_opened else self._last).text
        if not is_opened:
            return _with_reason(verdict, before)
        if verdict.verdict not in (PASS, FAIL):
            return verdict
        end = float(progress.decided_at if progress.is_decided else min(progress.end, self._last))
        so_far = timeliness.worst(0.0, end)
        if so_far.seconds > self._silence + SLACK:
            why = f": from {1e3 * self._silence:.3g} ms on, an ECU may treat messages as lost"
            why = so_far.text + ("" if math.isinf(so_far.seconds) else why)
            return Verdict(verdict.name, INCONCLUSIVE, reason=why)
        if verdict.verdict == FAIL and before:
            verdict = _with_reason(verdict, f"before its window {before}")
        late, force = timeliness.worst(begin, end), 0.0
        if verdict.margin_unit == "N" and late.seconds > 0.0:
            at, around = float(progress.margin_at), late.seconds + self._step
            # If nothing is pinched around its margin, the force cannot differ there.
            if timeliness.pinches(at - around, at + around):
                force = late.seconds * timeliness.force_rate(begin, end)
        if late.seconds > timeliness.tolerance:
            return stepped_again(verdict, place, late.seconds, force, late.text, again)
        if verdict.margin is not None and abs(verdict.margin) < force:
            why = f"the frames' delay means {force:.3g} N, the margin is {verdict.margin:.3g} N"
            return stepped_again(verdict, place, late.seconds, force, why, again)
        return replace(verdict, uncertainty=force or None)

    def _hindered(self, found: list[Verdict], late: str, gaps: Sequence[Gap]) -> list[Verdict]:
        """Return the verdicts; inconclusive: passes if awaited stimuli never came, all but errors if bench `late`.

        So are a pass of a scenario that did not begin where its precondition should have ended, and a failure
        because a trouble code was not reported: what it reports may be the stimulus.
        """
        missed = [*filter(None, [self.expected.not_completed(self._began_deg)])]
        for place in range(len(found), len(self.expected.expectations)):
            if not self._progress(place).is_decided:
                waiting = self.expected.expectations[place]
                never = f"{waiting.key} never came: {waiting.condition}"
                known = self._in_gaps(place, Verdict("", INCONCLUSIVE, reason=never), gaps).reason
                missed.append(known if known == never else f"{waiting.key}: {known}")
        if missed:
            reason = "; ".join(missed)
            found = [
                Verdict(each.name, INCONCLUSIVE, reason=reason)
                if each.verdict == PASS or (each.verdict == FAIL and self._waits_for_code(place))
                else each
                for place, each in enumerate(found)
            ]
        if not late:
            return found
        return [each if each.verdict == ERROR else Verdict(each.name, INCONCLUSIVE, reason=late) for each in found]

    def _waits_for_code(self, place: int) -> bool:
        """Whether an expectation concerns a trouble code and is not yet decided."""
        return self.expected.expectations[place].kind == "dtc" and not self._progress(place).is_decided

    def window(self, place: int) -> tuple[float, float] | None:
        """Return begin and end [s] of an expectation's window, as far as known; None: it is not open yet."""
        progress = self._progress(place)
        if np.isnan(progress.begin):
            return None
        begin, end = float(progress.begin), min(float(progress.end), self.end)
        return begin, max(begin, end if math.isfinite(end) else self._last)

    def closest(self, place: int) -> float:
        """Return the time [s] of the tick with an expectation's margin so far; NaN: it has none."""
        if self.expected.expectations[place].kind == "dtc":
            return math.nan
        return float(self._progress(place).margin_at)

    def _verdict(self, place: int, error: str) -> Verdict:
        expectation, progress = self.expected.expectations[place], self._progress(place)
        name = expectation.name
        if error:
            return Verdict(name, ERROR, reason=error)
        reason = self._undecided(place)
        if reason:
            return Verdict(name, INCONCLUSIVE, reason=reason)
        is_decided = bool(progress.is_decided)
        verdict = PASS if is_decided != expectation.is_always else FAIL
        if expectation.kind == "dtc":
            time = float(progress.decided_at) if is_decided else None
            reason = self._reason_for(place, verdict)
            formula = expectation.formula
            return Verdict(name, verdict, time_s=time, reason=reason, method=DIRECT, formula=formula)
        condition, decider = self.expected.conditions[place], int(progress.decider)
        time = progress.decided_at if is_decided else progress.margin_at
        return Verdict(
            name,
            verdict,
            margin=float(progress.margin),
            margin_unit=condition.units[decider],
            time_s=float(time),
            reason=self._reason_for(place, verdict),
            margin_time_s=float(progress.margin_at),
            decided_by=comparisons_of(condition)[decider].text,
            method=DIRECT,
            formula=expectation.formula,
        )

    def _in_gaps(self, place: int, verdict: Verdict, gaps: Sequence[Gap]) -> Verdict:
        """Return the verdict, or an inconclusive one if data missing in or before its window could change it."""
        progress = self._progress(place)
        is_opened = self.expected.openers[place] >= 0
        begin = 0.0 if is_opened else float(progress.begin)
        # A row is enough to violate these, in a window that opens by the clock.
        is_proven = verdict.verdict == FAIL and not is_opened and self.expected.expectations[place].is_always
        for gap in gaps:
            if gap.is_thinned and is_proven and progress.is_decided:
                continue
            hit = gap.names & set(self.expected.names(place))
            if gap.names and not hit:
                continue
            if gap.end > begin + SLACK and not gap.begin > progress.end + SLACK:
                what = f"there is no sample of {', '.join(sorted(hit))}"
                what = what if hit else "rows were left out evenly" if gap.is_thinned else "rows are missing"
                reason = f"{what} from {shown_time(gap.begin)} to {shown_time(gap.end)}"
                return Verdict(verdict.name, INCONCLUSIVE, reason=reason)
        return verdict

    def _undecided(self, place: int) -> str:
        """Return as text why there is no verdict on an expectation; "": there is one."""
        expectation, progress = self.expected.expectations[place], self._progress(place)
        if np.isnan(progress.begin):
            return f"its trigger never came: {expectation.after}"
        if progress.is_decided:
            return ""
        end = min(float(progress.end), self.end)
        begins, ends, ended = map(shown_time, (progress.begin, end, self._last))
        if progress.begin > self._last + SLACK:
            return f"its window begins at {begins}, the run ended at {ended}"
        if progress.end > self.end + SLACK and math.isfinite(expectation.within):
            return f"its window, to {shown_time(progress.end)}, was cut off by the end at {ends}"
        if math.isfinite(end) and self._last < end - SLACK:
            return f"its window, to {ends}, was cut off where the run ended, at {ended}"
        if progress.ticks == 0:
            return f"no tick lies in its window, {begins} to {ends}"
        if self._answers is not None and expectation.kind == "dtc":
            return self._unanswered(self._answers, progress, expectation, min(end, self._last))
        if progress.counted == 0:
            return "one of its columns or signals has no value in its window"
        if np.isnan(progress.margin):
            return f"no stretch of {expectation.hold:g} s in its window in which all its columns have a value"
        return ""

    @staticmethod
    def _unanswered(answers: Answers, progress: Any, expectation: Expectation, end: float) -> str:
        """Return as text why there is no verdict on a trouble code up to a time [s]; "": there is one."""
        begins, ends = shown_time(progress.begin), shown_time(end)
        if progress.counted == 0:
            why = f"; the ECU refused {answers.refused}" if answers.refused else ""
            return f"no response to reading the trouble codes in its window, {begins} to {ends}{why}"
        last = answers.last_before(end + SLACK)
        if expectation.is_always and end - last > answers.longest_wait + SLACK:
            came = shown_time(last)
            return f"the last answer to reading the trouble codes came at {came}, its window ends at {ends}"
        return ""

    def _reason_for(self, place: int, verdict: str) -> str:
        """Return as text why an expectation failed; "" if it passed."""
        if verdict == PASS:
            return ""
        progress = self._progress(place)
        end = min(float(progress.end), self.end)
        last = end if math.isfinite(end) else self._last
        return failure_of(self.expected.expectations[place], self.expected.conditions[place], progress, last)

    def notes(self) -> list[str]:
        """Return notes that may explain the verdicts: on precondition, stimuli never made, faults too brief.

        Notes name a precondition that was not completed, or may not have been, stimuli that were never made, and
        faults that were in force too briefly.
        """
        came = self._came()
        briefly = brief_faults(self.expected.faults, came, self._last, self._tables.step)
        began = self.expected.notes_on_begin(self._began_deg)
        return [*began, *briefly, *never_made(self.expected.begins, came, self._last)]

    def condition_times(self) -> dict[str, float]:
        """Return, by text, when [s] each condition that a stimulus awaits from time 0 became true, if it did."""
        return {condition: time for (condition, after), time in self._came().items() if after == 0.0}

    def _came(self) -> dict[tuple[str, float | str], float]:
        """Return when [s] each condition that stimuli wait for became true, by text and preceding instant."""
        first = len(self.expected.expectations) - self.expected.awaited
        return {
            (each.condition, each.after): float(self._progress(place).decided_at)
            for place, each in enumerate(self.expected.expectations)
            if place >= first and self._progress(place).is_decided
        }


def _first_angle(rows: NDArray[np.float64]) -> float:
    """Return the first gate angle [deg] in the rows before `FIRST_S`; NaN: there is none."""
    angles = rows[rows[:, _TIME] < FIRST_S, COLUMN_PLACE["gate_angle_deg"]]
    known = angles[np.isfinite(angles)]
    return float(known[0]) if len(known) else math.nan


def _with_reason(verdict: Verdict, more: str) -> Verdict:
    return replace(verdict, reason="; ".join(filter(None, (verdict.reason, more))))
