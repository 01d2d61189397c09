"""Verdicts: pass, inconclusive, fail, error; of several the worst counts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

PASS, INCONCLUSIVE, FAIL, ERROR = "pass", "inconclusive", "fail", "error"
VERDICTS = (PASS, INCONCLUSIVE, FAIL, ERROR)  # the worst last


@dataclass(frozen=True)
class Verdict:
    """What came of an expectation.

    `margin` is how much was left, negative for what failed, in `margin_unit`; None: undecided. `time_s` is when it
    was decided: the first violation, the first fulfilment, else where the margin is; None: never. `reason` says in
    words what the verdict does not.

    `window_s` is from when to when it was judged, as far as the run went; None: it was never opened.
    `margin_time_s` is the tick with the margin, with `for_s` the last of its stretch, and `decided_by` the
    comparison that the margin is of, its numbers filled in. `uncertainty` is what the delay of the bench's own
    frames means in a force [N], in real time.
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


def worst(verdicts: Iterable[str]) -> str:
    """The worst of them; of none pass."""
    return max(verdicts, key=VERDICTS.index, default=PASS)
