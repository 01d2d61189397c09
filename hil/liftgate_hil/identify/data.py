"""Measured data as the grey box takes it, and how a measurement may have begun."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.identify import rigid
from liftgate_hil.identify.decimation import Decimation
from liftgate_hil.identify.trajectory import REST, Start
from liftgate_plant import gate
from liftgate_plant.dynamics import Plant
from liftgate_plant.rows import AT, INPUT_COLUMNS
from liftgate_plant.vehicle import Vehicle, plant_of

Floats = NDArray[np.float64]

_CLOSED_DEG = 0.3
# Of the largest speed: what a start from rest extrapolates to at most, and what is one where nothing drives it.
_REST_SHARE, _STILL_SHARE = 0.2, 0.01
_SURE = 4.0  # standard deviations of a speed
_STALL_SHARE = 0.5  # of V/R: above, for so long, it is no inrush
_WINDOWS = (0.04, 0.15)  # s by which a motion is told
# How far position and angle may disagree before the counter has a zero of its own, rev.
_OFFSET_REV = 1.5
# Standard deviations of what is not known of a beginning: how far a gate may be from the balance of forces, moving
# and at rest (where friction and play hold it); how far two drives may be apart, as unlike forces wind them up
# (500 N bend a mechanism of 5e5 N/m by three revolutions); how warm windings and housings may be.
_SPREAD_DEG, _SPREAD_DEGPS = 0.2, 3.0
_SPREAD_REST_DEG = 0.5
_SPREAD_REV = 3.0
_SPREAD_RPS = 5.0  # of a rest that no speed and no position shows
_SPREAD_K, _SPREAD_HOUSING_K = 20.0, 10.0
_HOTTEST_K = 200.0
_FIRST = 0.02  # s in which an angle has hardly changed
_CUT = 0.1  # s: a file whose clock shows more where it begins was cut


@dataclass(frozen=True)
class Data:
    """One experiment: outputs (n,) at `times` (n,) [s] by their names of trajectory.OUTPUTS, NaN where there is no
    sample; inputs of rows.INPUT_COLUMNS of the plant in `rows`, each held until the next one.
    """

    name: str
    times: Floats
    inputs: Floats  # (N, 14)
    outputs: Mapping[str, Floats]
    through_sensors: bool = (
        False  # a bus log: sensors' readings, inputs at the stamps of their frames
    )
    decimation: Decimation | None = None  # how the outputs come from those in all rows
    whole: Data | None = None  # before it was thinned out
    after_motion: bool = False  # whether it is told to begin in a pause

    @property
    def rows(self) -> Floats:
        """(N,) s: the rows of the inputs, and of the outputs before they were thinned out."""
        return self.times if self.decimation is None else self.decimation.rows

    def thinned(self, name: str, values: Floats) -> Floats:
        """An output's values (N,) in all rows as its samples (n,) show them."""
        return values if self.decimation is None else self.decimation.of(name, values)


@dataclass(frozen=True)
class Unknown:
    """Something of an experiment's beginning that is estimated along."""

    experiment: int
    name: str  # a field of Start, or left_offset, right_offset: zero of a position counter [rev]
    value: float
    std: float = math.inf  # of its prior
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class InitialCondition:
    """How an experiment begins: what is known, and what is not."""

    start: Start
    unknowns: tuple[Unknown, ...]
    in_pause: bool = False  # at rest, after a motion


def without_end(data: Data, seconds: float) -> Data:
    """The data without the samples of their last `seconds`, nor those that look there: what drove these need not
    be among the inputs.
    """
    reach = 0.0 if data.decimation is None else data.decimation.reach
    late = data.times > data.times[-1] - seconds - reach
    outputs = {name: np.where(late, np.nan, values) for name, values in data.outputs.items()}
    return replace(data, outputs=outputs)


def part_of(data: Data, first: int, last: int, zeros: Mapping[str, float]) -> Data:
    """The samples from `first` to `last` (exclusive), of outputs less their `zeros`, with the inputs that hold in
    between; without the filter of a thinning, which looks beyond them.
    """
    outputs = {name: own[first:last] - zeros.get(name, 0.0) for name, own in data.outputs.items()}
    times, rows = data.times[first:last], data.rows
    if data.decimation is None:
        inputs = data.inputs[first:last]
        return replace(data, times=times, inputs=inputs, outputs=outputs)
    begin, end = np.searchsorted(rows, [times[0], times[-1]], side="right")
    own = rows[begin - 1 : end].copy()
    own[0] = times[0]
    if own[-1] < times[-1]:
        own = np.append(own, times[-1])
    inputs = data.inputs[np.arange(begin - 1, begin - 1 + len(own)).clip(max=end - 1)]
    decimation = Decimation(own, times)
    return replace(
        data, times=times, inputs=inputs, outputs=outputs, decimation=decimation, whole=None
    )


def changes_of(data: Data) -> NDArray[np.intp]:
    """The rows (m,) from which other inputs hold than before; the first one is the first of them."""
    now, before = data.inputs[1:], data.inputs[:-1]
    same = (now == before) | (np.isnan(now) & np.isnan(before))
    return np.concatenate([[0], 1 + np.flatnonzero(~np.all(same, axis=1))])


def is_count(position: Floats, quantum: float) -> bool:
    """Whether a position's samples are whole multiples of a quantum [rev]."""
    counts = position[np.isfinite(position)] / quantum
    return bool(np.all(np.abs(counts - np.round(counts)) <= 1e-6 * (1.0 + np.abs(counts))))


def is_closed(angle_deg: float) -> bool:
    """Whether an angle is that of a closed gate; also one that is not known."""
    return not angle_deg >= _CLOSED_DEG


def first_sample(values: Floats | None) -> float:
    """The first one there is; NaN where there is none."""
    if values is None:
        return math.nan
    there = np.flatnonzero(np.isfinite(values))
    return float(values[there[0]]) if len(there) else math.nan


def motion(data: Data, share: float = _REST_SHARE) -> tuple[float, float, float]:
    """(speed at the beginning, its standard deviation, largest speed) [rev/s]; NaN where neither speed nor
    position was measured. Good to `share` of the largest speed, where the data are.
    """
    for side in ("left", "right"):
        for name, degree in ((f"{side}_speed_rps", 1), (f"{side}_position_rev", 2)):
            values = data.outputs.get(name)
            if values is not None and np.any(np.isfinite(values)):
                return _moving(data.times, values, degree, share)
    return math.nan, math.nan, math.nan


def _moving(times: Floats, values: Floats, degree: int, share: float) -> tuple[float, float, float]:
    """The same from a speed (degree 1) or a position (2), by the first of the windows that tells enough."""
    there = np.isfinite(values)
    times, values = times[there], values[there]
    if degree == 1:
        largest = float(np.quantile(np.abs(values), 0.99))
    else:
        edges = np.arange(times[0], times[-1], 0.1)
        speeds = np.diff(np.interp(edges, times, values)) / 0.1
        largest = float(np.max(np.abs(speeds), initial=0.0))
    first, std = math.nan, math.inf
    for window in _WINDOWS:
        value, slope, value_std, slope_std = _beginning(times, values, degree, window)
        first, std = (value, value_std) if degree == 1 else (slope, slope_std)
        if _SURE * std <= share * largest:
            break
    return first, std, largest


def _beginning(
    times: Floats, values: Floats, degree: int, window: float
) -> tuple[float, float, float, float]:
    """Value and slope at the first sample, and their standard deviations, by a polynomial through the first
    `window` seconds (ten samples at least).
    """
    count = max(10, int(np.searchsorted(times, times[0] + window)))
    t, y = times[:count] - times[0], values[:count]
    if len(t) <= degree + 1:
        return float(y[0]), 0.0, math.inf, math.inf
    powers = t[:, None] ** np.arange(degree + 1)
    solution, *_ = np.linalg.lstsq(powers, y, rcond=None)
    spread = float(np.sum((y - powers @ solution) ** 2)) / (len(t) - degree - 1)
    std = np.sqrt(spread * np.diag(np.linalg.pinv(powers.T @ powers)))
    return float(solution[0]), float(solution[1]), float(std[0]), float(std[1])


def begins_at_rest(data: Data, creeps: bool = False) -> bool:
    """Whether nothing moves yet at the first sample; `creeps`: nor does anything creep that nothing drives."""
    share = _STILL_SHARE if creeps and not _is_driven(data) else _REST_SHARE
    first, std, largest = motion(data, share)
    if math.isnan(first):
        angle = data.outputs.get("gate_angle_deg")
        if angle is None or is_closed(_first(data, angle)):
            return True
        share = _REST_SHARE  # a gate may fall through its play while its drives rest
        first, std, largest = _moving(data.times, angle, 2, share)
    return abs(first) <= share * largest + _SURE * std


def _is_driven(data: Data) -> bool:
    """Whether there is a voltage within the time by which a motion is told."""
    count = max(1, int(np.searchsorted(data.rows, data.rows[0] + _WINDOWS[-1])))
    drives = [AT.left_voltage_v, AT.right_voltage_v, AT.left_duty, AT.right_duty]
    return bool(np.any(np.nan_to_num(data.inputs[:count, drives]) != 0.0))


def beginning_of(
    vehicle: Vehicle, data: Data, experiment: int, angle_deg: float | None, full: bool
) -> InitialCondition:
    """How an experiment begins, from its first samples; `angle_deg`: at rest at this known angle, or in motion
    there where only a speed was measured.

    Raises ValueError where the data do not say.
    """
    data, plant = data.whole or data, plant_of(vehicle)
    quantum = 1.0 / vehicle.sensors.hall_counts
    known = _first_angle(plant, data)
    after_motion = data.after_motion or not is_closed(known) or data.times[0] > _CUT
    moves = not begins_at_rest(data, after_motion)
    if angle_deg is not None and (_shows_place(data) or not moves):
        return _at_rest(plant, data, experiment, math.radians(angle_deg), quantum)
    if moves or after_motion:
        return _midway(vehicle, data, experiment, full, moves, angle_deg)
    return _at_rest(plant, data, experiment, 0.0, quantum)


def _first_angle(plant: Plant, data: Data) -> float:
    """The gate's angle at the first samples [deg], by its sensor or a position; NaN where neither was measured."""
    known = _first(data, data.outputs.get("gate_angle_deg"))
    if math.isnan(known):
        known = _angle_at(plant, first_sample(_position(data)))
    return known


def _first(data: Data, values: Floats | None) -> float:
    """The median of the first samples; NaN where there is none."""
    if values is None or not np.any(np.isfinite(values)):
        return math.nan
    times, values = data.times[np.isfinite(values)], values[np.isfinite(values)]
    return float(np.median(values[times <= times[0] + _FIRST]))


def _angle_at(plant: Plant, position: float) -> float:
    """The gate's angle [deg] at the left drive's position [rev]."""
    return math.degrees(rigid.angle_at(plant.link, plant.left.travel * position))


def _first_speed(plant: Plant, data: Data) -> float:
    """The drives' speed at the first sample [rev/s]; NaN where nothing says."""
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


def _at_rest(
    plant: Plant, data: Data, experiment: int, angle: float, quantum: float
) -> InitialCondition:
    """A gate that has been at rest for long at a known angle [rad]."""
    start = REST._replace(angle=angle, latched=_latched(data, math.degrees(angle)))
    place = gate.extension(plant.link, angle) / plant.left.travel
    return InitialCondition(start, tuple(_offsets(data, experiment, place, quantum)))


def _latched(data: Data, angle_deg: float) -> float:
    """A latch holds a closed gate; at any other place its command says nothing of its state."""
    return 1.0 if data.inputs[0, AT.latch_released] == 0.0 and is_closed(angle_deg) else 0.0


def _offsets(data: Data, experiment: int, place: float, quantum: float) -> list[Unknown]:
    """Zeros of the position counters, where these do not show the position that the gate is at. A count (`quantum`
    rev) shows it to half of that at best: an edge may be anywhere.
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
    """Whether a voltage drives a current through a drive that stands still, from the first sample on."""
    early = data.times <= data.times[0] + _WINDOWS[-1]
    current = data.outputs.get("left_current_a", np.full(len(data.times), np.nan))[early]
    if not np.any(np.isfinite(current)):
        return False
    stall = applied_voltage(data, vehicle.supply.voltage)[early] / vehicle.left.motor.resistance
    least = _STALL_SHARE * float(np.min(np.abs(stall)))
    return 0.0 < least < abs(float(np.nanmedian(current)))


def _shows_place(data: Data) -> bool:
    """Whether a position or the angle was measured."""
    return any(
        name.endswith(("_position_rev", "angle_deg")) and bool(np.any(np.isfinite(values)))
        for name, values in data.outputs.items()
    )


def _midway(
    vehicle: Vehicle,
    data: Data,
    experiment: int,
    full: bool,
    moves: bool,
    angle_deg: float | None,
) -> InitialCondition:
    """A gate in motion, or at rest after one."""
    plant = plant_of(vehicle)
    if not moves and _is_stalled(vehicle, data):
        raise ValueError(
            "begins with drives that their voltage stalls, and how far friction holds them is not known; allowed: "
            "`from` before they stop, or from where the voltage is off"
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
            "begins in motion, and neither position nor angle say where; allowed: data that begin at rest, "
            "a position or an angle, or `initial`"
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


def rows_of(columns: Mapping[str, Floats], count: int) -> Floats:
    """Inputs (n, 14) from columns; a drive that nothing is said of is driven like the other one."""
    rows = np.full((count, len(INPUT_COLUMNS)), np.nan)
    for place, name in enumerate(INPUT_COLUMNS):
        if name in columns:
            rows[:, place] = columns[name]
    left = (AT.left_voltage_v, AT.left_duty, AT.left_coast)
    right = (AT.right_voltage_v, AT.right_duty, AT.right_coast)
    for own, other in ((left, right), (right, left)):
        if np.all(np.isnan(rows[:, own])):
            rows[:, own] = rows[:, other]
    return rows


def applied_voltage(data: Data, supply: float) -> Floats:
    """The left motor's voltage (n,) [V] at the samples, as far as the inputs tell: 0 while it coasts."""
    held = np.searchsorted(data.rows, data.times * (1.0 + 1e-12), side="right") - 1
    rows = data.inputs[np.maximum(held, 0)]
    given = rows[:, AT.supply_voltage_v]
    source = np.where(np.isnan(given), supply, given)
    driven = np.nan_to_num(rows[:, AT.left_voltage_v])
    driven += np.nan_to_num(rows[:, AT.left_duty]) * source
    voltage: Floats = np.where(np.nan_to_num(rows[:, AT.left_coast]) > 0.0, 0.0, driven)
    return voltage
