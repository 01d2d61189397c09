"""Warnings on an identification's reliability, with the dependence of estimates on fixed parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from liftgate_hil.described_result import columns_in
from liftgate_hil.errors import number_of
from liftgate_hil.identification.result import (
    Estimate,
    FixedParameter,
    Identification,
    ModelResult,
    PhaseErrors,
    Series,
    columns_of,
    series_of,
)
from liftgate_hil.identification.statistics import factor_between, is_nothing, rounding_step
from liftgate_hil.report.numbers import clean, column_label, significant

_LIKELY = 0.5  # share by which a suspected parameter may be wrong, at most
_EXPLAINS = 0.05  # share of the squared errors that a suspected parameter explains, at least
_AS_WELL = 0.9  # of what the best one explains: others that explain as much
_MOST = 4  # fixed parameters that are named
_SMALL, _SMALL_STD = 0.01, 1.0  # change of an estimate that is not reported: share of it, standard deviations
# The same above which there is a warning. Of a product of which one factor is 10 % off, the other one changes by
# 1/0.9 - 1 = 11 % at most: that is no amplification.
_AMPLIFIED, _AMPLIFIED_STD = 0.12, 3.0
Warned = TypeVar("Warned", bound=ModelResult)
_ROUNDING = 1e-9  # of an output's range: largest residual of data without noise
_FAR = 2.0  # ratio of the errors of two phases from which on the larger one is named
_ALIKE = 0.98  # correlation of two courses of the same shape
_OTHER = 1.3  # ratio of their sizes that is reported
_WELL_PERCENT = 80.0  # fit above which it is not
_LARGER_PART = math.sqrt(0.5)  # of an rms: its squared mean is more than half of the squared rms
_PARTS, _CONSTANT = 4, 0.5  # parts in time, and share of the mean error that each of them has where it is constant
_SURE = 5.0  # standard deviations of a mean error that is reported
_NOT_IN_STD = (
    "; the standard deviations account for its correlation, not for a bias, nor for noise of a measured voltage: "
    "give the commanded one, or a filtered one"
)
_TURNED = (
    "above the simulation in one measurement and below it in another, so it is no sensor offset: check scale "
    "factors: gear ratio, spindle lead, end angle, clock"
)
_STRONG = 0.9  # correlation of two parameters from which on it is reported
VALUES = ("value", "std", "relative_error", "initial", "change_percent", "unit")  # columns of an estimate
ERRORS = ("mean", "rms", "maximum")  # of an output
PHASE = columns_in(PhaseErrors, "rms", "maximum", "samples")
EXCUSES = {"rounding": "not white: rounding of the data", "slopes": "not white: derived from the position"}


class Dependence(NamedTuple):
    """Dependence of an estimate on a fixed parameter, whose error the residuals would not show."""

    estimate: Estimate
    fixed: FixedParameter
    shift: float  # of the estimate, in its unit, if the fixed parameter were 10 % larger

    @property
    def share(self) -> float:
        """Shift of the estimate relative to its magnitude, if the fixed parameter were 10 % larger."""
        return self.shift / abs(self.estimate.value)


def dependences(result: Identification) -> list[Dependence]:
    """Return each identifiable estimate's strongest dependences on fixed parameters that residuals do not show."""
    found = []
    for each in result.parameters:
        if not each.identifiable or each.value == 0.0:
            continue
        least = max(_SMALL * abs(each.value), _SMALL_STD * each.std)
        own = [Dependence(each, fixed, fixed.shifts[each.name]) for fixed in result.fixed if not fixed.is_seen]
        found += sorted((one for one in own if abs(one.shift) > least), key=lambda one: -abs(one.shift))[:_MOST]
    return found


def firsts(found: Sequence[Dependence]) -> list[tuple[Dependence, bool]]:
    """Return each dependence, and whether it is the first one of its estimate; those of one estimate adjoin."""
    earlier = [None, *(each.estimate for each in found)]
    return [(each, each.estimate is not before) for each, before in zip(found, earlier, strict=False)]


def amplified(result: Identification) -> list[str]:
    """Return a warning on each estimate that an unseen error of a fixed parameter changes by a larger share."""
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
    """Return a note on fixed parameters whose errors would explain residuals that are not white; else none."""
    series = [each for one in result.experiments for each in one.series]
    if all(each.is_white or each.excuse for each in series):
        return []
    able = [each for each in result.fixed if each.explains > _EXPLAINS and abs(each.change) < _LIKELY]
    ranked = sorted(able, key=lambda each: -each.explains)
    if not ranked:
        return []
    alike = [each for each in ranked if each.explains > _AS_WELL * ranked[0].explains]
    named = ", ".join(
        f"{clean(each.name)} {significant(100.0 * abs(each.change), 2)} % "
        f"{'larger' if each.change > 0.0 else 'smaller'}"
        for each in alike[:_MOST]
    )
    more = f" and {number_of(len(alike) - _MOST, 'more parameter')}" if len(alike) > _MOST else ""
    either, then = "this one", "if it is uncertain, estimate it, too"
    if len(alike) > 1:
        either, then = "one of these", "estimate the one that is uncertain, too"
    return [
        f"of the fixed parameters, {either} would explain {significant(100.0 * ranked[0].explains, 2)} % of the "
        f"squared errors: {named}{more}; {then}"
    ]


def with_warnings(result: Warned, worded: Callable[[str], str] = str) -> Warned:
    """Return a result with its warnings added, each as `worded` returns it."""
    found = warnings_of(result) if isinstance(result, Identification) else validation_warnings(result)
    return replace(result, warnings=tuple(map(worded, found)))


def warnings_of(result: Identification) -> list[str]:
    """Return the warnings, worst first: not identifiable, at a bound, residual not white or fit below 0 %."""
    not_identifiable = [
        f"{clean(each.name)} is not identifiable{_because(each.remark)}"
        for each in result.parameters
        if not each.identifiable
    ]
    remarks = [
        f"{clean(each.name)}: {clean(each.remark)}"
        for each in result.parameters
        if each.identifiable and each.remark
    ]
    apart = [clean(each) for each in result.inseparable]
    return [
        *not_identifiable,
        *apart,
        *remarks,
        *_one_sided(result),
        *amplified(result),
        *suspects(result),
        *validation_warnings(result),
    ]


def _one_sided(result: Identification) -> list[str]:
    """Return a warning for each side on which a profile likelihood does not reach the 95 % limit."""
    return [
        f"{clean(each.name)}: its profile likelihood has no 95 % limit {side} the estimate: it ends at "
        f"{significant(last, 4)}, {why or 'after 3 standard deviations'}"
        for each in result.profiles
        for side, limit, last, why in (
            ("below", each.low, each.values[0], each.ends[0]),
            ("above", each.high, each.values[-1], each.ends[1]),
        )
        if math.isnan(limit)
    ]


def validation_warnings(result: ModelResult) -> list[str]:
    """Return warnings on initial states that are not identifiable, on the data, then on the experiments."""
    states = [
        f"initial state {clean(each.name)} is not identifiable{_because(each.remark)}"
        for each in result.initial_states
        if not each.identifiable
    ]
    return [*states, *map(clean, result.data_warnings), *experiment_warnings(result)]


def _because(remark: str) -> str:
    return f": {clean(remark)}" if remark else ""


def experiment_warnings(result: ModelResult) -> list[str]:
    """Return the warnings of each experiment, with the names of the outputs that they concern.

    They are on outputs of another scale or with an offset, on those that the model fits worse than their mean
    value does, and on residuals that are not white.
    """
    turned = []  # above the simulation in one experiment, and below it in another
    for name in columns_of(result.experiments):
        several = series_of(result.experiments, name)
        if len({math.copysign(1.0, each.mean) for each in several if has_offset(each)}) > 1:
            turned.append(name)
    found = [f"{clean(name, 60)}: {_TURNED}" for name in turned]
    has_std = isinstance(result, Identification)
    for experiment in result.experiments:
        worse = [_name(each) for each in experiment.series if each.fit_percent < 0.0]
        coloured = [each for each in experiment.series if not each.is_white and not each.excuse]
        name = clean(experiment.name, 60)
        found += [f"{name}: {text}" for text in map(_scaled, experiment.series) if text]
        found += [
            f"{name}: {_offset(each)}"
            for each in experiment.series
            if has_offset(each) and each.output not in turned
        ]
        if worse:
            found.append(f"{name}: fit below 0 %, worse than the mean value: {', '.join(worse)}")
        if coloured:
            found.append(
                f"{name}: residuals are not white: {', '.join(map(_with_phase, coloured))}. "
                "Model or timestamps leave a part unexplained" + (_NOT_IN_STD if has_std else "")
            )
    return found


def _with_phase(series: Series) -> str:
    """Return an output's name, with the phase of by far the largest errors, if there is one."""
    sizes = sorted(((rms, phase) for phase, (rms, _, count) in series.phases.items() if count), reverse=True)
    if len(sizes) < 2 or not sizes[0][0] > _FAR * sizes[1][0]:
        return _name(series)
    return f"{_name(series)} (mostly in the phase “{clean(sizes[0][1])}”, rms {significant(sizes[0][0], 2)})"


def _name(series: Series) -> str:
    """Return the name of an output, which may come from a file, shortened if it is long."""
    return clean(series.output, 60)


def _scaled(series: Series) -> str:
    """Return a warning on an output that has the simulation's shape but another scale; "": it has not."""
    if series.fit_percent > _WELL_PERCENT:
        return ""
    factor = factor_between(series.measured, series.simulated, _ALIKE)
    if factor is None or factor < 0.0 or abs(math.log(factor)) < math.log(_OTHER):
        return ""
    return f"{_name(series)} is {significant(factor, 3)} times the simulation: is its scale right?"


def has_offset(series: Series) -> bool:
    """Whether an output's errors are mainly a constant offset from beginning to end of the data.

    A mean that noise or rounding explains is none; nor are errors that grow, as those of a wrong model do.

    The slopes of a position are no column of the data, and have no offset of their own.
    """
    least = max(_LARGER_PART * series.rms, _SURE * series.mean_std)
    if series.excuse == "slopes" or not abs(series.mean) > least:
        return False
    errors = series.measured - series.simulated
    if is_nothing(errors, series.measured) or abs(series.mean) <= rounding_step(series.measured):
        return False
    parts = (part for part in np.array_split(errors, _PARTS) if len(part))
    return all(float(np.mean(part)) / series.mean > _CONSTANT for part in parts)


def _offset(series: Series) -> str:
    """Return the text of the warning that an output's errors are mostly an offset."""
    size = f"{significant(abs(series.mean), 2)} {column_label(series.output)[1]}".rstrip()
    side = "above" if series.mean > 0.0 else "below"
    return f"{_name(series)} is {size} {side} the simulation on average: has its sensor an offset?"


def notes_of(result: Identification) -> list[str]:
    """Return one note if the residuals are no more than rounding, as in simulated data; else an empty list."""
    series = [each for experiment in result.experiments for each in experiment.series]
    is_exact = all(each.maximum <= _ROUNDING * float(np.ptp(each.measured)) for each in series)
    text = "the data have no noise, as those of a simulation: standard deviations and criteria are rounding errors"
    return [text] if series and is_exact else []


def residual_words(series: Series) -> str:
    """Return in words whether a residual is white, or why it need not be; "": not white, unexplained."""
    if series.is_white:
        return "white about its mean" if has_offset(series) else "white"
    return EXCUSES[series.excuse] if series.excuse else ""


def strong_correlations(result: Identification) -> list[tuple[str, str, float]]:
    """Return (name, name, correlation) of parameters correlated by at least ±_STRONG, strongest first."""
    names = [each.name for each in result.parameters]
    pairs = [
        (names[i], names[k], float(result.correlation[i, k]))
        for i in range(len(names))
        for k in range(i + 1, len(names))
        if abs(result.correlation[i, k]) >= _STRONG
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))
