"""Check by simulation whether a verdict of a real-time run holds although the bench was late.

The run is simulated again, in model time, with the ECU's commands as they arrived, and also earlier and later
by the bench's lateness.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from liftgate_hil.errors import with_unit
from liftgate_hil.judging.verdict import INCONCLUSIVE, REPLAY, Verdict

LONGEST = 0.25  # s of lateness, up to which the gate is stepped again


@dataclass(frozen=True)
class SteppedAgain:
    """Verdicts of a run simulated again, with commands as they arrived, earlier and later."""

    as_they_arrived: Sequence[Verdict]  # in the order of the expectations
    earlier: Sequence[Verdict]
    later: Sequence[Verdict]
    # By the place of an expectation: how much the deciding value changed within the lateness around its margin.
    changes: Sequence[float]


# Steps the gate again for a lateness [s]; None: it cannot be done.
StepAgain = Callable[[float], SteppedAgain | None]


def stepped_again(
    verdict: Verdict, place: int, late: float, force: float, why: str, again: StepAgain | None
) -> Verdict:
    """Return the verdict if simulations `again`, commands shifted by `late` [s], confirm it; else inconclusive.

    `place` is the expectation's index, `force` [N] the effect on a margin that is a force. The verdict stays as it
    is if the simulation confirms it with room to spare, else it is inconclusive.
    """
    found = None if again is None or late > LONGEST else again(late)
    if found is None:
        return Verdict(verdict.name, INCONCLUSIVE, reason=why, uncertainty=force or None)
    others = {
        "": found.as_they_arrived[place],
        f", {1e3 * late:.3g} ms earlier": found.earlier[place],
        f", {1e3 * late:.3g} ms later": found.later[place],
    }
    for how, other in others.items():
        if other.verdict != verdict.verdict:
            text = f"stepped again with the commands as they arrived{how}: {other.verdict}"
            return Verdict(verdict.name, INCONCLUSIVE, reason=f"{why}; {text}", method=REPLAY)
    if verdict.margin is None:  # a trouble code: only the ECU's responses are known
        return Verdict(verdict.name, INCONCLUSIVE, reason=f"{why}; without a margin its effect cannot be bounded")
    margins = [verdict.margin, *(each.margin for each in others.values() if each.margin is not None)]
    uncertainty = max(margins) - min(margins) + found.changes[place] + force
    # Where a comparison with `==` holds its margin is 0; so it is all around, where its uncertainty is 0, too.
    is_within = abs(verdict.margin) <= uncertainty and uncertainty > 0.0
    if math.isnan(uncertainty) or is_within:
        margin, within = (
            with_unit(each, verdict.margin_unit) for each in (f"{verdict.margin:.4g}", f"{uncertainty:.3g}")
        )
        text = f"the margin of {margin} is within its uncertainty of {within}"
        if verdict.margin == 0.0:  # such as that of a comparison with `==`
            text = f"the margin is 0, with an uncertainty of {within}"
        reason = f"{why}; stepped again, {text}"
        return Verdict(verdict.name, INCONCLUSIVE, reason=reason, uncertainty=uncertainty, method=REPLAY)
    return replace(verdict, method=REPLAY, uncertainty=uncertainty)
