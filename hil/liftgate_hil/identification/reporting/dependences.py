"""Fixed parameters in reports: which estimates depend on them, and which would explain the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from liftgate_hil.errors import number_of
from liftgate_hil.identification.result import Estimate, FixedParameter, Identification
from liftgate_hil.report.numbers import clean, significant

_LIKELY = 0.5  # share by which a suspected parameter may be wrong, at most
_EXPLAINS = 0.05  # share of the squared errors that a suspected parameter explains, at least
_AS_WELL = 0.9  # of what the best one explains: others that explain as much
_MOST = 4  # fixed parameters that are named
_SMALL, _SMALL_STD = 0.01, 1.0  # change of an estimate that is not reported: share of it, standard deviations
# The same above which there is a warning. Of a product of which one factor is 10 % off, the other one changes by
# 1/0.9 - 1 = 11 % at most: that is no amplification.
_AMPLIFIED, _AMPLIFIED_STD = 0.12, 3.0


class Dependence(NamedTuple):
    """Dependence of an estimate on a fixed parameter, such that the residuals don't show a wrong value."""

    estimate: Estimate
    fixed: FixedParameter
    shift: float  # of the estimate, in its unit, if the fixed parameter were 10 % larger

    @property
    def share(self) -> float:
        """The shift as a share of the estimate."""
        return self.shift / abs(self.estimate.value)


def dependences(result: Identification) -> list[Dependence]:
    """Return on which fixed parameters the estimates depend unseen, the strongest first for each estimate."""
    found = []
    for each in result.parameters:
        if not each.identifiable or each.value == 0.0:
            continue
        least = max(_SMALL * abs(each.value), _SMALL_STD * each.std)
        own = [Dependence(each, fixed, fixed.shifts[each.name]) for fixed in result.fixed if not fixed.is_seen]
        found += sorted((one for one in own if abs(one.shift) > least), key=lambda one: -abs(one.shift))[:_MOST]
    return found


def firsts(found: Sequence[Dependence]) -> list[tuple[Dependence, bool]]:
    """Return each dependence with whether it is the first of its estimate."""
    earlier = [None, *(each.estimate for each in found)]
    return [(each, each.estimate is not before) for each, before in zip(found, earlier, strict=False)]


def amplified(result: Identification) -> list[str]:
    """Return a warning for each estimate that an unseen error of 10 % of a fixed parameter changes by more."""
    found, listed = [], dependences(result)
    for each in result.parameters:
        own = [
            one
            for one in listed
            if one.estimate is each and abs(one.share) > _AMPLIFIED and abs(one.shift) > _AMPLIFIED_STD * each.std
        ]
        if own:
            names = [clean(one.fixed.name) for one in own]
            others = f"; the same holds for {', '.join(names[1:])}" if names[1:] else ""
            found.append(
                f"{clean(each.name)} depends on parameters that are held fixed: {names[0]} 10 % larger changes it "
                f"by {significant(100.0 * own[0].share, 2)} % ({significant(abs(own[0].shift) / each.std, 2)} "
                f"standard deviations) with no visible effect on the residuals{others}"
            )
    return found


def suspects(result: Identification) -> list[str]:
    """Return a note on which fixed parameters, of another value, would explain residuals that are not white."""
    series = [each for one in result.experiments for each in one.series]
    if all(each.is_white or each.excuse for each in series):
        return []
    able = [each for each in result.fixed if each.explains > _EXPLAINS and abs(each.change) < _LIKELY]
    ranked = sorted(able, key=lambda each: -each.explains)
    if not ranked:
        return []
    alike = [each for each in ranked if each.explains > _AS_WELL * ranked[0].explains]
    named = ", ".join(f"{clean(each.name)} {_by(each.change)}" for each in alike[:_MOST])
    more = f" and {number_of(len(alike) - _MOST, 'more parameter')}" if len(alike) > _MOST else ""
    either, then = "this one", "if it is uncertain, estimate it, too"
    if len(alike) > 1:
        either, then = "one of these", "estimate the one that is uncertain, too"
    return [
        f"of the fixed parameters, {either} would explain {significant(100.0 * ranked[0].explains, 2)} % of the "
        f"squared errors: {named}{more}; {then}"
    ]


def _by(change: float) -> str:
    """Return a relative change in words."""
    return f"{significant(100.0 * abs(change), 2)} % {'larger' if change > 0.0 else 'smaller'}"
