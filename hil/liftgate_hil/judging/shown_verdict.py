"""A verdict on an expectation as it is shown: on one line of text, and for JSON."""

from __future__ import annotations

import math
from typing import Any

from liftgate_hil.judging.verdict import FAIL, Verdict


def expectation_json(verdict: Verdict) -> dict[str, Any]:
    """Return a verdict for JSON; what is not a finite number is null."""

    def known(value: float | None) -> float | None:
        return value if value is not None and math.isfinite(value) else None

    return {
        "name": verdict.name,
        "verdict": verdict.verdict,
        "margin": known(verdict.margin),
        "margin_unit": verdict.margin_unit,
        "time_s": known(verdict.time_s),
        "reason": verdict.reason,
        "uncertainty": known(verdict.uncertainty),
        "method": verdict.method or None,
        "window_s": list(verdict.window_s) if verdict.window_s is not None else None,
        "margin_time_s": known(verdict.margin_time_s),
        "decided_by": verdict.decided_by,
    }


def line_of(verdict: Verdict) -> str:
    """Return an expectation's verdict as one line: with what was expected, or the reason, which states it.

    The reason of a failure also states the times. Of several comparisons the deciding one is named.
    """
    is_explained = bool(verdict.reason)
    parts = [verdict.verdict + (f" ({verdict.formula})" if verdict.formula and not is_explained else "")]
    if verdict.has_margin:
        unit = f" {verdict.margin_unit}" if verdict.margin_unit else ""
        doubt = f" ± {verdict.uncertainty:.2g}" if verdict.uncertainty else ""
        is_one_of_several = not is_explained and any(f" {each} " in verdict.formula for each in ("and", "or"))
        compared = f" of {verdict.decided_by}" if is_one_of_several else ""
        parts.append(f"margin {verdict.margin:.4g}{doubt}{unit}{compared}")
    has_times = verdict.time_s is not None and not (verdict.verdict == FAIL and verdict.reason)
    if has_times and (not verdict.has_margin or verdict.margin_time_s in (None, verdict.time_s)):
        parts.append(f"at {verdict.time_s:.3f} s")
    elif has_times:
        parts[-1] += f" at {verdict.margin_time_s:.3f} s"
        parts.append(f"fulfilled at {verdict.time_s:.3f} s")
    line = ", ".join(parts)
    return f"{line}: {verdict.reason}" if verdict.reason else line
