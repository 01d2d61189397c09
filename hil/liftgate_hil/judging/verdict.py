"""Verdicts: pass, inconclusive, fail, error; of several the worst counts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

PASS, INCONCLUSIVE, FAIL, ERROR = "pass", "inconclusive", "fail", "error"
DIRECT, REPLAY = "direct", "replay"  # methods
VERDICTS = (PASS, INCONCLUSIVE, FAIL, ERROR)  # the worst last


@dataclass(frozen=True)
class Verdict:
    """What came of an expectation.

    `margin` is how much was left, negative for what failed, in `margin_unit`; None: undecided. `time_s` is when it
    was decided: the first violation, the first fulfilment, else where the margin is; None: never. `reason` says in
    words what the verdict does not.

    `window_s` is from when to when it was judged, as far as the run went; None: it was never opened.
    `margin_time_s` is the tick with the margin, with `for_s` the last of its stretch, and `decided_by` the
    comparison that the margin is of, its numbers filled in. In real time, `uncertainty` is how far the bench's own
    lateness may have moved the margin, in its unit; None: not at all, or nobody knows. `method` says how a verdict
    was reached: DIRECT, from the run as it was, or REPLAY, the bench was late and the gate was stepped again.
    """

    name: str
    verdict: str
    margin: float | None = None
    margin_unit: str = ""
    time_s: float | None = None
    reason: str = ""
    window_s: tuple[float, float] | None = None
    margin_time_s: float | None = None
    decided_by: str = ""
    uncertainty: float | None = None
    method: str = ""


def worst(verdicts: Iterable[str]) -> str:
    """The worst of them; of none pass."""
    return max(verdicts, key=VERDICTS.index, default=PASS)
