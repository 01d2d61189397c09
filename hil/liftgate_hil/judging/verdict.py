"""Verdicts: pass, inconclusive, fail, error, of which the worst counts; during a run also pending."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.errors import Entries

PASS, INCONCLUSIVE, FAIL, ERROR = "pass", "inconclusive", "fail", "error"
STOPPED = "stopped"  # in place of a verdict: the run was stopped before its end
GIVEN_UP = "given up"  # in place of a verdict: the bench has ended the run early
PENDING = "pending"  # not decided yet, while the run goes on
DIRECT, REPLAY = "direct", "replay"  # methods of reaching a verdict
VERDICTS = (PASS, INCONCLUSIVE, FAIL, ERROR)  # the worst last


# fmt: off
@dataclass(frozen=True)
class Verdict(DescribedResult):
    """Verdict on an expectation, with its margin, times and reason.

    `margin` is the distance to failure, negative after it, in `margin_unit`; None: undecided. `time_s` is when it
    was decided: the first violation, the first fulfilment, else where the margin is; None: never. `reason`
    explains the verdict in words.

    `window_s` is from when to when it was judged, as far as the run went; None: the window never opened.
    `margin_time_s` is the tick with the margin, with `for_s` the last tick of its hold time, and `decided_by` the
    comparison that the margin is of, with numbers for parameters. In real time, `uncertainty` is how far the
    bench's own lateness may have moved the margin, in its unit; None: not at all, or unknown. `method` says how
    the verdict was reached: DIRECT, from the run as it was, or REPLAY, the bench was late and the gate was stepped
    again.
    """

    name: Annotated[str, Shown("name of the expectation")]
    verdict: Annotated[str, Shown("`pass`, `inconclusive`, `fail` or `error`")]
    margin: Annotated[float | None, Shown("distance to the limit, in `margin_unit`; negative: failed; 0: see "
        "`verdict`; null: undecided")] = None
    margin_unit: Annotated[str, Shown("unit of `margin`; empty: it has none")] = ""
    time_s: Annotated[float | None, Shown("when it was decided: model time [s]; null: never")] = None
    reason: Annotated[str, Shown("why, in words; may be empty")] = ""
    window_s: Annotated[tuple[float, float] | None, Shown("when it was judged, as far as the run went: [from, "
        "to], model time [s]; null: the window never opened")] = None
    margin_time_s: Annotated[float | None, Shown("when the margin was reached: model time [s]; null: "
        "unknown")] = None
    decided_by: Annotated[str, Shown("comparison of the condition that the margin is of, with numbers for "
        "parameters")] = ""
    uncertainty: Annotated[float | None, Shown("how far the bench's lateness may have moved the margin, in "
        "`margin_unit`; null: not at all, or unknown")] = None
    method: Annotated[str | None, Shown("`direct`: from the run as it was; `replay`: the bench was late, and the "
        "gate was stepped again; null: undecided")] = None
    formula: Annotated[str, Shown("what was expected, with numbers for parameters; empty: there is no verdict on "
        "it")] = ""

    # fmt: on
    @property
    def has_margin(self) -> bool:
        """Whether there is a margin to show; a state that is equal (==) as expected has no distance."""
        is_as_compared = self.margin == 0.0 and "==" in self.decided_by
        return self.margin is not None and not is_as_compared


class Verdicts(Entries[Verdict]):
    """Verdicts by the names of their expectations."""

    what, none = "expectation", "none, as there are none"


def worst(verdicts: Iterable[str]) -> str:
    """Return the worst of several verdicts; pass where there is none."""
    return max(verdicts, key=VERDICTS.index, default=PASS)


def line_of(verdict: Verdict) -> str:
    """Return an expectation's verdict as one line of text, with margin and times, and its reason or condition.

    The reason of a failure also states the times. Of several comparisons the deciding one is named.
    """
    is_explained = bool(verdict.reason)
    line = verdict.verdict + (f" ({verdict.formula})" if verdict.formula and not is_explained else "")
    if verdict.has_margin:
        is_one_of_several = not is_explained and any(f" {each} " in verdict.formula for each in ("and", "or"))
        compared = f" of {verdict.decided_by}" if is_one_of_several else ""
        line += f", margin {_amount(verdict)}{compared}"
    times = "" if verdict.verdict == FAIL and is_explained else times_text(verdict)
    if times:
        line += f" {times}" if _has_two_times(verdict) else f", {times}"
    return f"{line}: {verdict.reason}" if verdict.reason else line


def margin_text(verdict: Verdict) -> str:
    """Return a verdict's margin as text, with uncertainty and unit; a dash: infinite, or there is none."""
    if not verdict.has_margin or verdict.margin is None or not math.isfinite(verdict.margin):
        return "—"
    return _amount(verdict)


def times_text(verdict: Verdict) -> str:
    """Return as text when a verdict was decided and, if different, when the margin was reached; "": never."""
    if verdict.time_s is None:
        return ""
    if _has_two_times(verdict):
        return f"at {verdict.margin_time_s:.3f} s, fulfilled at {verdict.time_s:.3f} s"
    return f"at {verdict.time_s:.3f} s"


def _amount(verdict: Verdict) -> str:
    doubt = f" ± {verdict.uncertainty:.2g}" if verdict.uncertainty else ""
    return f"{verdict.margin:.4g}{doubt} {verdict.margin_unit}".rstrip()


def _has_two_times(verdict: Verdict) -> bool:
    """Whether a verdict's margin was reached at another time than its fulfilment; False for a failed one."""
    is_apart = verdict.margin_time_s not in (None, verdict.time_s)
    return verdict.has_margin and is_apart and verdict.verdict != FAIL
