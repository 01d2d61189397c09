"""Warnings on data, and hints on why a simulation does not follow them: units, signs, gaps, offsets."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from liftgate_hil.config.units import spellings
from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.identification.data import (
    DRIVEN,
    Data,
    Floats,
    applied_voltage,
    first_sample,
    is_count,
    is_driven,
)
from liftgate_hil.identification.initial_condition import motion
from liftgate_hil.identification.problem import LONGEST_DELAY, Problem
from liftgate_hil.identification.statistics import factor_between, fit_percent, mean_std, rounding_step
from liftgate_hil.identification.trajectory import OUTPUTS
from liftgate_hil.measurement.mapping import KNOWN
from liftgate_hil.measurement.quality import GAP, usual_spacing
from liftgate_plant import gate
from liftgate_plant.signals import SIDES
from liftgate_plant.vehicle import Vehicle, plant_of

_LONG_GAP_S = 0.2  # in which a voltage may have changed, and a motor settles
_FEWEST = 10  # samples before the first voltage
_SURE = 5.0  # standard deviations of a mean
_LEAST_SHARE = 1e-3  # of the largest current: an offset that is worth a warning
_EMF_MARGIN = 2.0  # times the current that a motion within the data's error would induce
_SLOW = 0.2  # share of the largest speed below which a motion at the beginning may be noise
_ONE_WAY = 0.05  # share of the largest speed: less is no motion in the other direction, as when it springs back
_LEFT_SPEED = OUTPUTS.index("left_speed_rps")
_BALANCE = ("spring.", "gate.")  # parameters of what balances the gate
# Parameters of friction, whose torque has the sign of the motion.
_FRICTION = ("efficiency", "friction_torque", "friction_force", "load_torque", "static_ratio", "stribeck_speed")
_STATED = "sensors.current_offset"
_ALIKE = 0.95  # correlation from which on two courses have the same shape
_OTHER = 1.5  # ratio of two courses of the same shape that the initial values do not explain
_NEAR = 0.15  # share by which a factor may differ from that of a unit
_GOOD, _EACH = 50.0, 33.0  # % of fit, on average and of every output, above which other inputs explain the data
_BETTER = 1.0  # % of fit by which other inputs are better, at least: inputs of zero are as good, but for rounding
_NOISE, _BOTH = 0.05, 0.2  # shares of the largest value: of noise about zero, and of values of the other sign
# Factors of the inputs that are tried, and what they mean.
_INPUTS = {
    -1.0: "reversed inputs",
    1000.0: "inputs 1000 times as large",
    2.0: "inputs twice as large",
    0.5: "inputs half as large",
    -1000.0: "reversed inputs 1000 times as large",
}


def never_driven(data: Sequence[Data]) -> list[str]:
    """Return one warning if no motor is driven by a voltage or a duty in any experiment; else an empty list."""
    if any(np.any(is_driven(each)) for each in data):
        return []
    return ["no motor is driven: the data show only motion by weight, springs and hand"]


def moves_one_way(problem: Problem, states: Sequence[Floats]) -> list[str]:
    """Return one warning if the gate moves in one direction only, and balance and friction are both estimated.

    `states` are the simulated outputs (rows, 7) of each measurement at the end of the search.
    """
    names = [each.parameter.name for each in problem.sought]
    balance = [name for name in names if name.startswith(_BALANCE)]
    friction = [name for name in names if name.endswith(_FRICTION)]
    if not balance or not friction:
        return []
    speeds = np.concatenate([each[:, _LEFT_SPEED] for each in states])
    least = _ONE_WAY * float(np.max(np.abs(speeds), initial=0.0))
    if np.any(speeds > least) == np.any(speeds < -least):  # both directions, or no motion at all
        return []
    return [
        f"the gate moves in one direction only, in which {', '.join(balance)} and {', '.join(friction)} have "
        "nearly the same effect: only end stops and backlash separate them, and they may be off by more than "
        "their standard deviations; add a measurement of the other direction"
    ]


def begun_in_motion(problem: Problem, point: Floats) -> list[str]:
    """Return a warning on each measurement with a small estimated initial speed, which may be noise.

    `point` (p,) is the end of the search.
    """
    found = []
    for unknown, value in zip(problem.unknowns, point[len(problem.sought) :], strict=True):
        if unknown.name != "speed" or math.isfinite(unknown.std):
            continue
        data = problem.data[unknown.experiment]
        _, _, largest = motion(data.whole or data)
        if abs(value) < _SLOW * largest:
            found.append(
                f"{data.name}: the initial speed was estimated as {value:.2g} rev/s: if the gate was at rest at "
                "the first sample, give `initial` (closed, open, or an angle)"
            )
    return found


def driven_through_gaps(data: Sequence[Data]) -> list[str]:
    """Return a warning on each long gap between rows through which the last voltage or duty is held."""
    found = []
    for each in (each.whole or each for each in data):
        is_held = is_driven(each)[:-1]
        gaps = np.diff(each.rows)
        for k in np.flatnonzero((gaps > _LONG_GAP_S) & (gaps > GAP * usual_spacing(each.rows)) & is_held):
            begin, end = each.rows[k : k + 2]
            found.append(
                f"{each.name}: no rows from {begin:.5g} to {end:.5g} s: the motor is simulated with the last "
                "voltage all the time; use the rows before or after the gap, unless it got that voltage"
            )
    return found


def offsets_at_rest(problem: Problem) -> list[str]:
    """Return a warning on each motor current with an unexpected offset before the first voltage.

    Expected is zero, or in a bus log the offset that the vehicle states for its sensor, unless this is estimated.
    """
    delay = LONGEST_DELAY if problem.is_delay_sought else max(-problem.delay, 0.0)
    is_sought = any(each.parameter.name == _STATED for each in problem.sought)
    found = []
    for data in (each.whole or each for each in problem.data):
        stated = problem.vehicle.sensors.current_offset if data.through_sensors else 0.0
        if data.through_sensors and is_sought:
            continue
        for side in SIDES:
            mean = _offset(problem.vehicle, data, side, stated, delay)
            if not math.isnan(mean):
                text = f"{data.name}: {side}_current_a is {mean:.2g} A while the motor stands without voltage"
                what = ": has its sensor an offset? an offset with the other sign in a map file corrects it"
                if data.through_sensors:
                    what = f", and {_STATED} in the vehicle file is {stated:g} A: is it right?"
                found.append(f"{text}{what}")
    return found


def _offset(vehicle: Vehicle, data: Data, side: str, stated: float, delay: float) -> float:
    """Return a side's mean current [A] before any voltage; NaN: few samples, or not surely off `stated` [A]."""
    driven = np.flatnonzero(is_driven(data))
    end = data.rows[driven[0]] - delay if len(driven) else math.inf
    current = data.outputs.get(f"{side}_current_a")
    if current is None:
        return math.nan
    early = current[(data.times < end) & np.isfinite(current)]
    if len(early) < _FEWEST:
        return math.nan
    mean = float(np.mean(early))
    motor = getattr(vehicle, side).motor
    induced = motor.speed_constant * min(_speeds(vehicle, data, side, end), default=0.0) / motor.resistance
    least = max(
        _SURE * mean_std(early),
        rounding_step(current[np.isfinite(current)]),
        _LEAST_SHARE * float(np.nanmax(np.abs(current))),
        _EMF_MARGIN * induced,
    )
    return mean if abs(mean - stated) > least else math.nan


def _speeds(vehicle: Vehicle, data: Data, side: str, end: float) -> Iterator[float]:
    """Yield an upper limit of a motor's speed [rev/s] until `end` [s] for each output that shows it."""
    plant = plant_of(vehicle)
    for name, values in data.outputs.items():
        there = np.isfinite(values) & (data.times < end)
        if name not in (f"{side}_speed_rps", f"{side}_position_rev", "gate_angle_deg") or np.sum(there) < _FEWEST:
            continue
        times, early = data.times[there], values[there]
        if name.endswith("_speed_rps"):
            yield abs(float(np.mean(early))) + _SURE * mean_std(early)
            continue
        step = rounding_step(values[np.isfinite(values)])
        if name.endswith("_position_rev") and is_count(values, 1.0 / vehicle.sensors.hall_counts):
            step = 1.0 / vehicle.sensors.hall_counts
        speed = _fastest(times, early) + step / (times[-1] - times[0])
        if name == "gate_angle_deg":
            lever = gate.lever(plant.link, math.radians(first_sample(values)))
            speed *= math.radians(1.0) * abs(lever) / plant.left.travel
        yield speed


def _fastest(times: Floats, values: Floats) -> float:
    """Return an upper limit of a signal's average slope, unsigned: the fitted one plus its margin of error."""
    t = times - np.mean(times)
    slope = float(t @ values) / float(t @ t)
    residual = values - np.mean(values) - slope * t
    return abs(slope) + _SURE * math.sqrt(float(residual @ residual) / len(values) / float(t @ t))


def hints(problem: Problem, point: Floats) -> list[str]:
    """Return hints on columns of a measurement that may have another unit or sign than stated.

    `point` (p,) is where the search has ended.
    """
    found = _by_other_inputs(problem) or _by_factors(problem, [point, problem.initial])
    return [*_without_sign(problem), *found]


def _without_sign(problem: Problem) -> list[str]:
    """Return hints on outputs or inputs without negative values where other columns imply some."""
    found = [
        f"{name} has no negative values: was only its magnitude recorded?"
        for name, measured, simulated in _courses(problem, problem.initial)
        if _has_both(simulated) and not np.any(measured < -_NOISE * np.max(np.abs(measured)))
    ]
    driven = np.concatenate([applied_voltage(each, problem.vehicle.supply.voltage) for each in problem.data])
    turning = [
        name
        for name, measured in zip(problem.outputs, problem.measured.T, strict=True)
        if name.endswith("_speed_rps") and _has_both(measured[np.isfinite(measured)])
    ]
    if turning and not np.any(driven < 0.0):
        found.append(
            f"{turning[0]} has negative values, and no voltage or duty has: were only their magnitudes recorded?"
        )
    return found


def _has_both(values: Floats) -> bool:
    """Whether values have both signs, with extremes of the same order."""
    least, most = float(np.min(values, initial=0.0)), float(np.max(values, initial=0.0))
    return bool(min(-least, most) > _BOTH * max(-least, most) > 0.0)


def _by_factors(problem: Problem, points: Sequence[Floats]) -> list[str]:
    """Return hints on outputs that have the simulation's shape at one of the points, but another scale."""
    found: dict[str, str] = {}
    for point in points:
        for name, measured, simulated in _courses(problem, point):
            factor = factor_between(measured, simulated, _ALIKE)
            if factor is None or 1.0 / _OTHER < factor < _OTHER:
                continue
            if name not in found:
                found[name] = f"{name} is {factor:.3g} times the simulation{_guess(name, factor)}"
    return list(found.values())


def _guess(name: str, factor: float) -> str:
    """Return the end of a hint: which unit or sign of an output explains its scale factor; "": none does."""
    units: dict[float, str] = {}
    for unit, (ours, _) in spellings(KNOWN[name]).items():
        units.setdefault(ours, unit)  # the usual spelling comes first
    own = units[1.0]
    pairs = {(unit, own): 1.0 / size for size, unit in units.items()}
    pairs |= {(own, unit): size for size, unit in units.items()}
    if not any(_is_near(factor, each) for each in pairs.values()):
        pairs = {(one, other): b / a for a, one in units.items() for b, other in units.items()}
    fitting = [pair for pair, each in pairs.items() if _is_near(factor, each)]
    texts = [f"in {unit}{'' if stated == own else f' where {stated} is stated'}" for unit, stated in fitting[:2]]
    parts = ["is its sign reversed"] if factor < 0.0 and fitting else []
    parts += [] if (own, own) in fitting or not texts else [f"is it {' or '.join(texts)}"]
    return f": {' and '.join(parts)}?" if parts else ""


def _is_near(factor: float, other: float) -> bool:
    return abs(abs(factor) / other - 1.0) <= _NEAR


def _by_other_inputs(problem: Problem) -> list[str]:
    """Return one hint, on scaled or reversed inputs with which all outputs fit, with either sign; else none."""
    before = _fits(problem, problem.initial)
    for factor, text in _INPUTS.items():
        scale = np.ones(problem.data[0].inputs.shape[1])
        scale[list(DRIVEN)] = factor
        data = [replace(each, inputs=each.inputs * scale) for each in problem.data]
        other = replace(problem, data=data, beginnings=())
        after = _fits(other, other.initial)
        fit = _mean_fit(after)
        if not fit > max(_mean_fit(before) + _BETTER, _GOOD) or min(each for each, _ in after.values()) <= _EACH:
            continue
        turned = [name for name, (_, sign) in after.items() if sign < 0.0]
        also = f" and the sign of {', '.join(turned)} reversed" if turned else ""
        return [f"with {text}{also} it follows (fit {fit:.1f} %): is that what the columns mean?"]
    return []


def _mean_fit(fits: dict[str, tuple[float, float]]) -> float:
    return float(np.mean([each for each, _ in fits.values()])) if fits else -math.inf


def _fits(problem: Problem, point: Floats) -> dict[str, tuple[float, float]]:
    """Return for each output the better fit [%] with either sign of the simulation, and that sign."""
    return {
        name: max((fit_percent(measured, sign * simulated), sign) for sign in (1.0, -1.0))
        for name, measured, simulated in _courses(problem, point)
    }


def _courses(problem: Problem, point: Floats) -> Iterator[tuple[str, Floats, Floats]]:
    """Yield (name, measured samples, simulated samples) of each output; nothing where the plant diverges."""
    try:
        predicted = problem.predicted(point)
    except PlantDivergedError:
        return
    for name, measured, simulated in zip(problem.outputs, problem.measured.T, predicted.T, strict=True):
        there = np.isfinite(measured) & np.isfinite(simulated)
        if there.any() and np.ptp(measured[there]) > 0.0:
            yield name, measured[there], simulated[there]
