"""Warnings on data: an offset at rest, no motor driven, motion in one direction only, a long gap."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from liftgate_hil.identification.data import Data, Floats, first_sample, is_count, is_driven
from liftgate_hil.identification.initial_condition import motion
from liftgate_hil.identification.problem import LONGEST_DELAY, Problem
from liftgate_hil.identification.statistics import mean_std, rounding_step
from liftgate_hil.identification.trajectory import OUTPUTS
from liftgate_hil.measurement.quality import GAP, usual_spacing
from liftgate_plant import gate
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
SIDES = ("left", "right")


def never_driven(data: Sequence[Data]) -> list[str]:
    """Return a warning on data in which no motor is ever driven."""
    if any(np.any(is_driven(each)) for each in data):
        return []
    return ["no motor is driven: the data show only motion by weight, springs and hand"]


def moves_one_way(problem: Problem, states: Sequence[Floats]) -> list[str]:
    """Return a warning on data of one direction where parameters of balance and of friction are estimated.

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
    """Return a warning on each measurement that was taken to begin in motion, slowly: noise may look like that.

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
    """Return a warning on each current that is not as at rest while the motor stands, before the first voltage.

    That is zero, or in a bus log the offset that the vehicle states for its sensor, unless this is estimated.
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
                found.append(f"{text}{_question(data, stated)}")
    return found


def _question(data: Data, stated: float) -> str:
    """Return the end of a warning: what may be the cause, and what to do."""
    if data.through_sensors:
        return f", and {_STATED} in the vehicle file is {stated:g} A: is it right?"
    return ": has its sensor an offset? an offset with the other sign in a map file corrects it"


def _offset(vehicle: Vehicle, data: Data, side: str, stated: float, delay: float) -> float:
    """Return the mean current [A] of a side before the first voltage; NaN: as `stated` [A] but for scatter."""
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
    """Yield for each output that shows the motor's speed [rev/s] what it may be, at most, until `end` [s]."""
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
    """Return how fast a course may change on average, at most: its slope and the error of this."""
    t = times - np.mean(times)
    slope = float(t @ values) / float(t @ t)
    residual = values - np.mean(values) - slope * t
    return abs(slope) + _SURE * math.sqrt(float(residual @ residual) / len(values) / float(t @ t))
