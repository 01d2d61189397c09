"""A verdict on an expectation as it is shown, on one line of text."""

from __future__ import annotations

import math

from liftgate_hil.judging.verdict import FAIL, Verdict


def line_of(verdict: Verdict) -> str:
    """Return an expectation's verdict as one line: with what was expected, or the reason, which states it.

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
    """Return the margin with its uncertainty and unit; a dash where there is none."""
    if not verdict.has_margin or verdict.margin is None or not math.isfinite(verdict.margin):
        return "—"
    return _amount(verdict)


def times_text(verdict: Verdict) -> str:
    """Return when it was decided, and where that is another time, when the margin was reached; "": never."""
    if verdict.time_s is None:
        return ""
    if _has_two_times(verdict):
        return f"at {verdict.margin_time_s:.3f} s, fulfilled at {verdict.time_s:.3f} s"
    return f"at {verdict.time_s:.3f} s"


def _amount(verdict: Verdict) -> str:
    doubt = f" ± {verdict.uncertainty:.2g}" if verdict.uncertainty else ""
    return f"{verdict.margin:.4g}{doubt} {verdict.margin_unit}".rstrip()


def _has_two_times(verdict: Verdict) -> bool:
    """Whether the margin was reached at another time than the expectation was fulfilled."""
    is_apart = verdict.margin_time_s not in (None, verdict.time_s)
    return verdict.has_margin and is_apart and verdict.verdict != FAIL
