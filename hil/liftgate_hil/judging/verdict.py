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
    """

    name: str
    verdict: str
    margin: float | None = None
    margin_unit: str = ""
    time_s: float | None = None
    reason: str = ""


def worst(verdicts: Iterable[str]) -> str:
    """The worst of them; of none pass."""
    return max(verdicts, key=VERDICTS.index, default=PASS)
