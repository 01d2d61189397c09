"""Initial conditions of experiments, estimated from measured data: a known part, and unknowns to be estimated."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from liftgate_hil.identification.data import Data, Floats, applied_voltage, first_sample, is_count, is_driven
from liftgate_hil.identification.trajectory import REST, Start
from liftgate_plant import gate, rigid
from liftgate_plant.dynamics import Plant
from liftgate_plant.rows import AT
from liftgate_plant.vehicle import Vehicle, plant_of

_CLOSED_DEG = 0.3
# Shares of the largest speed: the initial speed that counts as rest at most, and the same where nothing drives.
_REST_SHARE, _STILL_SHARE = 0.2, 0.01
_SURE = 4.0  # standard deviations, in the margin of an initial speed
_STALL_SHARE = 0.5  # of V/R; a median current above it over the longest window is no inrush
_WINDOWS = (0.04, 0.15)  # s, windows from which the initial speed is estimated
# rev, disagreement of position and angle beyond which the counter has a zero of its own.
_OFFSET_REV = 1.5
# Prior standard deviations of the unknown part of an initial condition: distance of the gate from the balance of
# forces, in motion and at rest (where friction and play hold it); distance between two drives, as unequal forces
# wind them up (500 N bend a mechanism of 5e5 N/m by three revolutions); warmth of windings and of housings.
_SPREAD_DEG, _SPREAD_DEGPS = 0.2, 3.0
_SPREAD_REST_DEG = 0.5
_SPREAD_REV = 3.0
_SPREAD_RPS = 5.0  # of a start at rest that neither a speed nor a position shows
_SPREAD_K, _SPREAD_HOUSING_K = 20.0, 10.0
_HOTTEST_K = 200.0
_FIRST_SAMPLES = 12  # of a speed, from which its noise is taken
_SECOND_DIFFERENCE = 0.6745 * math.sqrt(6.0)  # median size of the second differences of white noise, of its std
_FIRST = 0.02  # s, time in which an angle hardly changes
_CUT = 0.1  # s, a file whose first timestamp is later than this was cut


@dataclass(frozen=True)
class Unknown:
    """A quantity that is estimated along with the parameters: of an initial condition, or the input delay."""

    experiment: int
    name: str  # a field of Start, or left_offset, right_offset: zero of a counter [rev]; or input_delay [s]
    value: float
    std: float = math.inf  # standard deviation of its prior
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class InitialCondition:
    """The initial condition of an experiment: its known part and its unknowns."""

    start: Start
    unknowns: tuple[Unknown, ...]
    in_pause: bool = False  # whether it is at rest after a motion


def is_closed(angle_deg: float) -> bool:
    """Whether an angle [deg] is that of a closed gate; an unknown angle (NaN) counts as closed."""
    return not angle_deg >= _CLOSED_DEG


def motion(data: Data, share: float = _REST_SHARE) -> tuple[float, float, float]:
    """Return (initial speed, its margin of error, largest speed) [rev/s] of the first drive that was measured.

    NaN where neither speed nor position was measured. The margin is below `share` of the largest speed, where the
    data allow it.
    """
    for side in ("left", "right"):
        for name, degree in ((f"{side}_speed_rps", 1), (f"{side}_position_rev", 2)):
            values = data.outputs.get(name)
            if values is not None and np.any(np.isfinite(values)):
                return _moving(data.times, values, degree, share)
    return math.nan, math.nan, math.nan


def _moving(times: Floats, values: Floats, degree: int, share: float) -> tuple[float, float, float]:
    """Return the result of `motion` from a speed (degree 1) or a position (degree 2), over a suitable window."""
    there = np.isfinite(values)
    times, values = times[there], values[there]
    if degree == 1:
        largest = float(np.quantile(np.abs(values), 0.99))
    else:
        edges = np.arange(times[0], times[-1], 0.1)
        speeds = np.diff(np.interp(edges, times, values)) / 0.1
        largest = float(np.max(np.abs(speeds), initial=0.0))
    first, margin = math.nan, math.inf
    for window in _WINDOWS:
        first, margin = _beginning(times, values, degree, window)
        if margin <= share * largest:
            break
    return first, margin, largest


def _beginning(times: Floats, values: Floats, degree: int, window: float) -> tuple[float, float]:
    """Return the speed at the first sample [rev/s], by a polynomial fit, and its margin of error.

    It is that of a polynomial through the first `window` seconds (ten samples at least). The next higher degree
    shows how far a drive that runs up within the window bends away from it: this adds to the margin.
    """
    count = max(10, int(np.searchsorted(times, times[0] + window)))
    t, y = times[:count] - times[0], values[:count]
    order = degree - 1  # the derivative that is the speed
    if len(t) <= degree + 2:
        return (float(y[0]) if order == 0 else 0.0), math.inf
    solution, std = _polynomial(t, y, degree)
    bent, _ = _polynomial(t, y, degree + 1)
    margin = math.hypot(_SURE * std[order], bent[order] - solution[order])
    return float(solution[order]), margin


def _polynomial(t: Floats, y: Floats, degree: int) -> tuple[Floats, Floats]:
    """Fit a polynomial to `y` (n,); return its coefficients (degree + 1,) and their standard deviations."""
    powers = t[:, None] ** np.arange(degree + 1)
    solution, *_ = np.linalg.lstsq(powers, y, rcond=None)
    spread = float(np.sum((y - powers @ solution) ** 2)) / (len(t) - degree - 1)
    std: Floats = np.sqrt(spread * np.diag(np.linalg.pinv(powers.T @ powers)))
    return np.asarray(solution, dtype=np.float64), std


def begins_at_rest(data: Data, creeps: bool = False) -> bool:
    """Whether an experiment begins at rest; `creeps`: undriven motion above 1 % of top speed counts as motion."""
    # Whether there is a voltage within the longest window from which the initial speed is estimated.
    count = max(1, int(np.searchsorted(data.rows, data.rows[0] + _WINDOWS[-1])))
    share = _STILL_SHARE if creeps and not np.any(is_driven(data)[:count]) else _REST_SHARE
    if any(_shows_rest(data.outputs.get(f"{side}_speed_rps"), share) for side in ("left", "right")):
        return True
    first, margin, largest = motion(data, share)
    if math.isnan(first):
        angle = data.outputs.get("gate_angle_deg")
        if angle is None or is_closed(_first(data, angle)):
            return True
        share = _REST_SHARE  # a gate may fall through its play while its drives rest
        first, margin, largest = _moving(data.times, angle, 2, share)
    return abs(first) <= share * largest + margin


def _shows_rest(speed: Floats | None, share: float) -> bool:
    """Whether the first samples of a speed (n,) [rev/s] show rest by themselves, as far as its noise allows that.

    A polynomial cannot follow a light drive that runs up within some milliseconds, and would take it for moving.
    One sample alone is not believed: a speed that was differentiated may begin with a zero.
    """
    values = np.zeros(0) if speed is None else speed[np.isfinite(speed)][:_FIRST_SAMPLES]
    if len(values) < _FIRST_SAMPLES:
        return False
    assert speed is not None
    least = share * float(np.quantile(np.abs(speed[np.isfinite(speed)]), 0.99))
    noise = float(np.median(np.abs(np.diff(values, 2)))) / _SECOND_DIFFERENCE
    return _SURE * noise <= least and abs(float(np.median(values[:3]))) <= least


def beginning_of(
    vehicle: Vehicle, data: Data, experiment: int, angle_deg: float | None, full: bool
) -> InitialCondition:
    """Return the initial condition of an experiment, from its first samples.

    `angle_deg` is a known angle at which it begins at rest, or in motion where only a speed was measured. Raises
    ValueError where the data do not determine the initial condition.
    """
    data, plant = data.whole or data, plant_of(vehicle)
    quantum = 1.0 / vehicle.sensors.hall_counts
    known = _first(data, data.outputs.get("gate_angle_deg"))
    if math.isnan(known):
        known = _angle_at(plant, first_sample(_position(data)))
    after_motion = data.after_motion or not is_closed(known) or data.times[0] > _CUT
    moves = not begins_at_rest(data, after_motion)
    if angle_deg is not None and (_shows_place(data) or not moves):
        return _at_rest(plant, data, experiment, math.radians(angle_deg), quantum)
    if moves or after_motion:
        return _midway(vehicle, data, experiment, full, moves, angle_deg)
    return _at_rest(plant, data, experiment, 0.0, quantum)


def _first(data: Data, values: Floats | None) -> float:
    """Return the median of a column over 0.02 s from its first sample; NaN where it has none."""
    if values is None or not np.any(np.isfinite(values)):
        return math.nan
    times, values = data.times[np.isfinite(values)], values[np.isfinite(values)]
    return float(np.median(values[times <= times[0] + _FIRST]))


def _angle_at(plant: Plant, position: float) -> float:
    """Return the gate's angle [deg] at the left drive's position [rev]."""
    return math.degrees(rigid.angle_at(plant.link, plant.left.travel * position))


def _first_speed(plant: Plant, data: Data) -> float:
    """Return the drives' speed at the first sample [rev/s]; NaN where nothing measured determines it."""
    speed, _, _ = motion(data)
    angle = data.outputs.get("gate_angle_deg")
    if math.isnan(speed) and angle is not None:
        rate, _, _ = _moving(data.times, angle, 2, _REST_SHARE)
        arm = gate.lever(plant.link, math.radians(first_sample(angle)))
        speed = math.radians(rate) * arm / plant.left.travel
    return speed


def _position(data: Data) -> Floats | None:
    for name in ("left_position_rev", "right_position_rev"):
        values = data.outputs.get(name)
        if values is not None and np.any(np.isfinite(values)):
            return values
    return None


def _at_rest(plant: Plant, data: Data, experiment: int, angle: float, quantum: float) -> InitialCondition:
    """Return the initial condition of a gate that has long been at rest at a known angle [rad]."""
    start = REST._replace(angle=angle, latched=_latched(data, math.degrees(angle)))
    place = gate.extension(plant.link, angle) / plant.left.travel
    return InitialCondition(start, tuple(_offsets(data, experiment, place, quantum)))


def _latched(data: Data, angle_deg: float) -> float:
    """Return 1.0 where the gate begins closed and held by the latch, else 0.0."""
    return 1.0 if data.inputs[0, AT.latch_released] == 0.0 and is_closed(angle_deg) else 0.0


def _offsets(data: Data, experiment: int, place: float, quantum: float) -> list[Unknown]:
    """Return the unknown zeros [rev] of position counters, which the gate's position does not show.

    That is so where the first sample is not near `place` [rev], the position at the gate's angle; and, with half a
    `quantum` [rev] as standard deviation, where the position is a Hall count, which shows it only to its edges.
    """
    unknowns = []
    for side in ("left", "right"):
        name, values = f"{side}_offset", data.outputs.get(f"{side}_position_rev")
        shown = first_sample(values)
        if abs(shown - place) > _OFFSET_REV:
            unknowns.append(Unknown(experiment, name, shown - place))
        elif values is not None and not math.isnan(shown) and is_count(values, quantum):
            unknowns.append(Unknown(experiment, name, 0.0, 0.5 * quantum))
    return unknowns


def _is_stalled(vehicle: Vehicle, data: Data) -> bool:
    """Whether the left drive is stalled under voltage from the first sample on, as shown by its current."""
    early = data.times <= data.times[0] + _WINDOWS[-1]
    current = data.outputs.get("left_current_a", np.full(len(data.times), np.nan))[early]
    if not np.any(np.isfinite(current)):
        return False
    stall = applied_voltage(data, vehicle.supply.voltage)[early] / vehicle.left.motor.resistance
    least = _STALL_SHARE * float(np.min(np.abs(stall)))
    return 0.0 < least < abs(float(np.nanmedian(current)))


def _shows_place(data: Data) -> bool:
    """Whether a position or the gate's angle was measured."""
    return any(
        name.endswith(("_position_rev", "angle_deg")) and bool(np.any(np.isfinite(values)))
        for name, values in data.outputs.items()
    )


def _midway(
    vehicle: Vehicle, data: Data, experiment: int, full: bool, moves: bool, angle_deg: float | None
) -> InitialCondition:
    """Return the initial condition of a gate in motion or at rest after a motion. Raises ValueError if unknown."""
    plant = plant_of(vehicle)
    if not moves and _is_stalled(vehicle, data):
        raise ValueError(
            "begins with drives stalled under voltage, so that their friction force is unknown; allowed: `from_s` "
            "before they stop, or after the voltage is off; `initial` where it begins at rest at a known angle; a "
            "resistance nearer to the motor's"
        )
    speed = _first_speed(plant, data) if moves else 0.0
    known = first_sample(data.outputs.get("gate_angle_deg")) if angle_deg is None else angle_deg
    shown = first_sample(_position(data))
    place = shown
    if not math.isnan(known):
        by_angle = gate.extension(plant.link, math.radians(known)) / plant.left.travel
        if math.isnan(shown) or abs(shown - by_angle) > _OFFSET_REV:
            place = by_angle
    if not moves and math.isnan(place):
        place = 0.0
    if math.isnan(place) or math.isnan(speed):
        raise ValueError(
            "begins in motion at an unknown position; allowed: data that begin at rest, "
            "a measured position or angle, or `initial`"
        )
    latched = 0.0 if moves else _latched(data, _angle_at(plant, place))
    start = REST._replace(balanced=1.0, speed=speed, left_position=place, latched=latched)
    unknowns = []
    if moves or (full and math.isnan(motion(data)[0])):
        unknowns.append(Unknown(experiment, "speed", speed, math.inf if moves else _SPREAD_RPS))
    if _shows_place(data) or not moves:
        is_held = latched > 0.0 or not _shows_place(data)
        std = _SPREAD_REV if is_held else math.inf
        unknowns.append(Unknown(experiment, "left_position", place, std))
    if full and plant.right.active > 0.0:
        unknowns.append(Unknown(experiment, "right_ahead", 0.0, _SPREAD_REV))
    if full and latched == 0.0:
        spread = _SPREAD_DEG if moves else _SPREAD_REST_DEG
        unknowns.append(Unknown(experiment, "angle", 0.0, math.radians(spread)))
    if full and moves:
        unknowns.append(Unknown(experiment, "rate", 0.0, math.radians(_SPREAD_DEGPS)))
    if plant.left.thermal.enabled > 0.0:
        for name, std in (("warmth", _SPREAD_K), ("housing_warmth", _SPREAD_HOUSING_K)):
            unknowns.append(Unknown(experiment, name, 0.0, std, -_SPREAD_K, _HOTTEST_K))
    offsets = _offsets(data, experiment, place, 1.0 / vehicle.sensors.hall_counts)
    return InitialCondition(start, (*unknowns, *offsets), not moves)
