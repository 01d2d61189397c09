"""Identification: search, uncertainty of the estimates, and what cannot be identified."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np

from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.identification import statistics
from liftgate_hil.identification.coarse import coarse_of
from liftgate_hil.identification.data import Floats, applied_voltage
from liftgate_hil.identification.data_warnings import (
    begun_in_motion,
    driven_through_gaps,
    hints,
    moves_one_way,
    never_driven,
    offsets_at_rest,
)
from liftgate_hil.identification.descent import Descent, Report, place_at
from liftgate_hil.identification.estimates import estimates_of, fixed_parameters
from liftgate_hil.identification.jitter import jitter_of
from liftgate_hil.identification.multiple_shooting import in_segments, is_far_off
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.residuals import Frame, phases_of, series_of, speed_series
from liftgate_hil.identification.result import Estimate, Experiment, Identification, Validation
from liftgate_hil.identification.search import at_best_delay, better, past_kinks, profile, search
from liftgate_hil.identification.statistics import Uncertainty
from liftgate_hil.identification.trajectory import OUTPUTS
from liftgate_hil.identification.valleys import past_dents
from liftgate_hil.identification.weighting import errors_of, log_likelihood_deviance, sampled_rows
from liftgate_plant.signals import Truth, signals_of
from liftgate_plant.vehicle import plant_of

_FAR_PERCENT = 0.0  # fit of the initial vehicle below which multiple shooting comes first
_OF_A_RUN = ("sensors.", "supply.", "coding.", "bridge.")  # tables on which few measurements depend
_NEAR_PERCENT = 80.0  # fit that a good search reaches
_NOWHERE_PERCENT = -1.0  # fit of an output below which a model contradicts the data
_HARDLY_PERCENT = 20.0  # the same, where the residual is not noise
_NOTHING_PERCENT = 1.5  # fit of all outputs below which a model explains nothing
_ROUGH_ROUNDS = 30
_NO_SCORE = 1e-12  # of the classic variance: a robust variance that carries no information
_KINDS = {False: "white residuals", True: "robust: the residuals are correlated"}


# A search also tries points at which the model diverges; these count as far off and need no warning.
_FAR_AWAY = np.errstate(over="ignore", invalid="ignore", divide="ignore")


class NothingToTellError(ValueError):
    """Raised when the data do not determine the sought parameters, or no simulation follows the data."""


@_FAR_AWAY
def fitted(
    problem: Problem, report: Report | None = None, given_std: Floats | None = None, profiles: Sequence[str] = ()
) -> Identification:
    """Estimate the sought parameters of a problem, with their uncertainty.

    `given_std` is the standard deviation of the outputs' noise, where it shall not be estimated. Raises
    NothingToTellError, and ValueError where the search would begin at a vehicle that its checks refuse.
    """
    began = time.perf_counter()
    if wrong := problem.refusals(problem.initial):
        raise ValueError("; ".join(wrong))
    kept = _leave_out_few(problem)
    given_std = None if given_std is None else given_std[kept]
    found = _best_fit(problem, report, given_std)
    _check_followed(problem, found.point, found.errors)
    known, covariance, is_robust, jitter = _uncertainty(problem, found, given_std)
    scatter = f"; the inputs' timestamps scatter by {1e3 * jitter:.2g} ms" if jitter > 0.0 else ""
    initial = place_at(problem, problem.initial, given_std).loss
    is_first = not math.isfinite(initial) or found.history[0] == initial
    history = found.history if is_first else (initial, *found.history)
    estimates = estimates_of(problem, found.point, covariance, known)
    count = len(problem.sought)
    parameters, initial_states = estimates[:count], estimates[count:]
    if not any(each.identifiable for each in parameters):
        raise NothingToTellError("; ".join(f"{each.name}: {each.remark}" for each in parameters))
    figures = _criteria(problem, found)
    names = [each.name for each in parameters]
    groups = [[k for k in group if k < count] for group in known.apart]
    is_free = np.array([not each.is_at_bound for each in estimates])
    states = _states_at(problem, found.point)
    return Identification(
        model=problem.model,
        vehicle="",
        outputs=tuple(problem.outputs),
        parameters=tuple(parameters),
        initial_states=tuple(initial_states),
        covariance=covariance[:count, :count],
        correlation=statistics.correlation_of(covariance[:count, :count]),
        noise_variance=found.weighting.covariance,
        loss=found.history[-1],
        loss_initial=initial,
        fpe=figures.fpe,
        aic=figures.aic,
        aicc=figures.aicc,
        bic=figures.bic,
        condition_number=known.condition,
        inseparable=tuple(statistics.named(groups, names)),
        stop_reason=found.stop_reason,
        iterations=len(history) - 1,
        evaluations=problem.evaluations,
        seconds=time.perf_counter() - began,
        covariance_kind=_KINDS[is_robust] + scatter,
        fixed=tuple(fixed_parameters(problem, found, given_std, is_free)),
        input_jitter=jitter,
        data_warnings=(
            *never_driven(problem.data),
            *begun_in_motion(problem, found.point),
            *moves_one_way(problem, states),
            *driven_through_gaps(problem.data),
            *offsets_at_rest(problem),
        ),
        history=np.array(history),
        experiments=tuple(experiments_of(problem, found.point, states, problem.initial)),
        profiles=tuple(
            profile(problem, found, k, estimates[k], given_std, _widening(known.covariance, covariance, k))
            for k in map(names.index, profiles)
        ),
    )


def _widening(white: Floats, whole: Floats, k: int) -> float:
    """Return an estimate's variance divided by that for white residuals, at least 1; 1 where undefined."""
    ratio = float(whole[k, k] / white[k, k]) if 0.0 < white[k, k] < math.inf else 1.0
    return max(ratio, 1.0) if math.isfinite(ratio) else 1.0


def _criteria(problem: Problem, found: Descent) -> statistics.Criteria:
    """Return the criteria of model selection (FPE, AIC, AICc, BIC) for the result of a search."""
    measured = problem.measured
    return statistics.criteria(
        found.history[-1],
        log_likelihood_deviance(measured, found.errors, found.weighting),
        int(np.sum(np.isfinite(measured))),
        sampled_rows(measured),
        len(found.point),
    )


def _uncertainty(
    problem: Problem, found: Descent, given_std: Floats | None
) -> tuple[Uncertainty, Floats, bool, float]:
    """Return (uncertainty by the information matrix, covariance, whether it is robust, input jitter [s])."""
    _, inverse_std = problem.priors()
    root = found.weighting.root
    known = statistics.uncertainty(statistics.information(found.slopes, root, inverse_std))
    covariance = known.covariance.copy()
    there = np.isfinite(problem.measured)
    white = all(statistics.is_white(errors[own]) for errors, own in zip(found.errors.T, there.T, strict=True))
    determined = np.isfinite(np.diag(covariance))
    own = np.ix_(determined, determined)
    slopes = found.slopes if np.all(determined) else found.slopes[:, :, determined]
    inverse = covariance[own]
    if not white and np.any(determined):
        series = _score_series(problem, slopes, found.errors, root)
        robust = statistics.robust_covariance(series, inverse, inverse_std[determined])
        covariance[own] = widened(inverse, robust)
    rounding = statistics.rounding_information(problem.measured, slopes, root)
    covariance[own] += statistics.sandwich(inverse, rounding)
    jitter = 0.0
    if np.any(determined):
        jitter, scores = jitter_of(problem, found, slopes, inverse_std[determined], given_std)
        covariance[own] += statistics.sandwich(inverse, scores)
    return known, covariance, not white, jitter


def _score_series(problem: Problem, slopes: Floats, errors: Floats, root: Floats) -> list[Floats]:
    """Return the scores ψᵀ Λ⁻¹ ε over time (m, p) of each experiment."""
    scores = np.einsum("noj,no->nj", slopes, errors @ root @ root.T)
    edges = np.cumsum([len(data.times) for data in problem.data])[:-1]
    parts = (np.split(each, edges) for each in (problem.measured, scores))
    return [
        statistics.score_series(data.times, measured, own)
        for data, measured, own in zip(problem.data, *parts, strict=True)
    ]


def _best_fit(problem: Problem, report: Report | None, given_std: Floats | None) -> Descent:
    """Search for the best fit; where there are many rows, start from the result of a coarse problem."""
    few = coarse_of(problem)
    if few is None:
        _check_excited(problem)
        found = _best(problem, _search(problem, report, given_std), report, given_std)
        return past_dents(problem, found, report, given_std) or found
    coarse, kept = few
    std = None if given_std is None else given_std[kept]
    _check_excited(coarse)
    first = _best(coarse, _search(coarse, report, std), report, std)
    deeper = past_dents(coarse, first, report, std)
    rough = deeper or first
    problem.evaluations += coarse.evaluations
    found = search(problem, report, given_std, rough.point)
    is_lost = is_far_off(problem, found.errors, _NEAR_PERCENT)
    if is_lost and not is_far_off(coarse, rough.errors, _NEAR_PERCENT):
        found = _search(problem, report, given_std)
    found = _best(problem, found, report, given_std)
    if deeper is None:
        return found
    # All rows have the same valley as few, and more local minima.
    return past_dents(problem, found, report, given_std) or found


def _best(problem: Problem, found: Descent, report: Report | None, given_std: Floats | None) -> Descent:
    """Return the search's result, or a better one behind a kink of the loss or at another delay."""
    found = past_kinks(problem, found, report, given_std)
    if problem.is_delay_sought:
        found = at_best_delay(problem, found, report, given_std)
    return found


def _search(problem: Problem, report: Report | None, given_std: Floats | None) -> Descent:
    """Search from the initial values; where these are far off or lead nowhere, from multiple shooting."""
    begin = problem.initial
    errors = errors_of(problem.measured, problem.predicted(begin))
    first: Descent | None = None
    if not is_far_off(problem, errors, _FAR_PERCENT):
        first = search(problem, report, given_std)
        if not is_far_off(problem, first.errors, _NEAR_PERCENT):
            return first
    segments = in_segments(problem)
    if segments is None:
        return first or search(problem, report, given_std)
    rough = search(segments, report, given_std, rounds=_ROUGH_ROUNDS)
    problem.evaluations += segments.evaluations
    count = len(problem.sought)
    begin[:count] = rough.point[:count]
    if problem.is_delay_sought:
        begin[-1] = rough.point[-1]
    second = search(problem, report, given_std, begin)
    return second if first is None else better(first, second)


@_FAR_AWAY
def validated(problem: Problem) -> Validation:
    """Compare a model with measurements; only the input delay and unknown initial conditions are estimated."""
    point, outputs = problem.initial, problem.outputs
    states: list[Estimate] = []
    if len(point) and problem.leave_out_few():
        found = past_kinks(problem, search(problem))
        known, covariance, _, _ = _uncertainty(problem, found, None)
        point, states = found.point, estimates_of(problem, found.point, covariance, known)
    problem.outputs = outputs
    return Validation(
        model=problem.model,
        vehicle="",
        experiments=tuple(experiments_of(problem, point, _states_at(problem, point))),
        initial_states=tuple(states),
        data_warnings=(
            *begun_in_motion(problem, point),
            *driven_through_gaps(problem.data),
            *offsets_at_rest(problem),
        ),
    )


def widened(classic: Floats, robust: Floats) -> Floats:
    """Return the robust covariance, scaled where needed to standard deviations no less than the classic ones."""
    own, other = np.diag(classic), np.diag(robust)
    silent = other <= _NO_SCORE * own  # hardly any score, so nothing to scale
    scale = np.sqrt(np.maximum(own / np.where(silent, own, other), 1.0))
    result: Floats = robust * np.outer(scale, scale)
    result[silent], result[:, silent] = classic[silent], classic[:, silent]
    return result


def _leave_out_few(problem: Problem) -> list[int]:
    """Leave out outputs with too few samples; return indices of the others. Raises NothingToTellError."""
    still = [
        name
        for name, column in zip(problem.outputs, problem.measured.T, strict=True)
        if not np.nanmax(column, initial=-np.inf) > np.nanmin(column, initial=np.inf)
    ]
    if len(still) == len(problem.outputs):
        raise NothingToTellError(f"{', '.join(still)}: constant from beginning to end")
    return problem.leave_out_few()


def _check_followed(problem: Problem, point: Floats, errors: Floats) -> None:
    """Raise NothingToTellError where the best simulation (at a point of p parameters) misses the data."""
    fits = {}
    for name, measured, own in zip(problem.outputs, problem.measured.T, errors.T, strict=True):
        there = np.isfinite(measured)
        fit = statistics.fit_percent(measured[there], (measured - own)[there])
        if not math.isnan(fit):
            fits[name] = (fit, statistics.is_white(own[there]))
    off = [
        f"{name} (fit {fit:.1f} %)"
        for name, (fit, is_noise) in fits.items()
        if fit < _NOWHERE_PERCENT
        or (fit < _HARDLY_PERCENT and not is_noise)
        or all(each < _NOTHING_PERCENT for each, _ in fits.values())
    ]
    if off:
        raise NothingToTellError(
            f"the simulation does not follow {', '.join(off)}; allowed: a vehicle, inputs and an initial "
            "condition that match the measurement, units that match the columns, and currents of the right sign"
            + "".join(f"; {hint}" for hint in hints(problem, point))
        )


def _check_excited(problem: Problem) -> None:
    begin = problem.initial
    slopes = problem.slopes(begin, problem.predicted(begin))[:, :, : len(problem.sought)]
    there = np.isfinite(problem.measured)[:, :, None]
    if not np.any(there & np.isfinite(slopes) & (slopes != 0.0)):
        text = "no measured output depends on the estimated parameters: the input does not excite them"
        idle = [each.parameter.name for each in problem.sought if each.parameter.name.startswith(_OF_A_RUN)]
        if idle:
            text += (
                f", or, as with {', '.join(idle)}, they act in a run and not on this measurement; allowed: offset "
                "and scale of a column in a map"
            )
        raise NothingToTellError(text)


def _states_at(problem: Problem, point: Floats) -> list[Floats]:
    """Return the simulated outputs (rows, 7) of each experiment at a point (p,) of the search."""
    return [problem.states(point, number) for number in range(len(problem.data))]


def experiments_of(
    problem: Problem, point: Floats, simulated_states: Sequence[Floats], before: Floats | None = None
) -> list[Experiment]:
    """Return measured and simulated outputs of all experiments, also simulated at the point `before` unless None.

    `simulated_states` are the outputs (rows, 7) of each at `point`.
    """
    plant = plant_of(problem.vehicle_at(point))
    experiments = []
    for number, (data, states) in enumerate(zip(problem.data, simulated_states, strict=True)):
        _check_sound(data.times, states, data.name)
        earlier = None if before is None else problem.states(before, number)
        voltage = applied_voltage(data, problem.vehicle.supply.voltage)
        frame = Frame(data.times, voltage, phases_of(plant, data.times, voltage, states))
        series = []
        for name in problem.outputs:
            measured = data.outputs.get(name)
            if measured is None or not np.any(np.isfinite(measured)):
                continue
            column = OUTPUTS.index(name)
            simulated = states[:, column]
            was = None if earlier is None else earlier[:, column]
            series.append(series_of(name, frame, measured, simulated, was))
            speed = name.replace("position_rev", "speed_rps")
            if speed != name and speed not in data.outputs:
                series.append(speed_series(speed, frame, measured, simulated, was))
        experiments.append(Experiment(data.name, data.times, voltage, tuple(series)))
    return experiments


def _check_sound(times: Floats, states: Floats, name: str) -> None:
    """Raise PlantDivergedError where the simulated outputs (n, 7) exceed the ranges of their signals."""
    catalogue = signals_of(Truth)
    limits = [catalogue[each].high for each in OUTPUTS]
    off = np.flatnonzero(~np.all(np.abs(states) <= limits, axis=1))
    if len(off):
        raise PlantDivergedError(
            f"{name}: the model diverged at {times[off[0]]:.6g} s; allowed: a shorter `step`, a plausible vehicle"
        )
