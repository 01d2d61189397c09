"""The prediction of measured data as a function of a point of the search.

A point holds the values of the sought parameters, then those of the unknowns: initial conditions and input delay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.parameters import FreeParameter, with_values
from liftgate_hil.identification.data import Data, Floats, changes_of, is_count, without_end
from liftgate_hil.identification.initial_condition import InitialCondition, Unknown, beginning_of
from liftgate_hil.identification.trajectory import MODELS, OUTPUTS, REST, Start, on_all_cpus, trajectory
from liftgate_plant.dynamics import NOMINAL, Load, Plant
from liftgate_plant.rows import inputs_of
from liftgate_plant.sensors import Sensors
from liftgate_plant.vehicle import Vehicle, load_of, plant_of

Item = TypeVar("Item")
Result = TypeVar("Result")

_DIFFERENCE = 1e-5  # of a parameter's size: half the width of a central difference
_IDEAL = Sensors()
LONGEST_DELAY = 0.1  # s, the longest delay that is searched
_FEW = 2  # samples that an output needs, at least
_END = 0.2  # share of an experiment that is left out at its end for want of its inputs, at most
ALL = -1  # `experiment` of an unknown that all experiments share


@dataclass(frozen=True)
class Sought:
    """A parameter to estimate; values in the unit of the vehicle file."""

    parameter: FreeParameter
    initial: float
    low: float
    high: float
    prior: float = math.nan  # mean and standard deviation of the prior
    prior_std: float = math.inf


@dataclass
class Problem:
    """Measured data, a model, and the sought parameters; `outputs` are names of trajectory.OUTPUTS."""

    vehicle: Vehicle
    model: str
    sought: Sequence[Sought]
    data: Sequence[Data]
    outputs: Sequence[str]
    # Angle at which all experiments, or each of them, begin at rest, where it is known.
    angle_deg: float | Sequence[float | None] | None = None
    delay: float = 0.0  # s from a change of the inputs' columns to its effect
    is_delay_sought: bool = False
    speed_window: float = 0.0  # s before a sample, over which a measured speed is averaged
    longest: float = 1e-3  # s, longest step of a simulation
    # A search visits only vehicles with which these checks find nothing wrong.
    refused_by: Callable[[Vehicle], Sequence[str]] = lambda vehicle: ()
    evaluations: int = 0
    beginnings: Sequence[InitialCondition] = ()  # default: estimated from the data
    unknowns: list[Unknown] = field(init=False)
    changes: list[NDArray[np.intp]] = field(init=False)  # rows at which the inputs change
    measured: Floats = field(init=False)  # (rows, outputs), NaN where nothing is compared
    _counted: dict[int, NDArray[np.intp]] = field(init=False, default_factory=dict)
    _is_ready: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        full = MODELS[self.model] == 0
        ahead = LONGEST_DELAY if self.is_delay_sought else max(-self.delay, 0.0)
        if ahead > 0.0:
            self.data = [without_end(each, min(ahead, _END * float(np.ptp(each.times)))) for each in self.data]
        self.changes = [changes_of(data) for data in self.data]
        if not self.beginnings:
            angles = self.angle_deg
            if not isinstance(angles, Sequence):
                angles = [angles] * len(self.data)
            if len(angles) != len(self.data):
                raise ValueError(
                    f"{len(angles)} angles for {len(self.data)} experiments; allowed: one per experiment"
                )
            beginnings = []
            for number, (data, angle) in enumerate(zip(self.data, angles, strict=True)):
                try:
                    beginnings.append(beginning_of(self.vehicle, data, number, angle, full))
                except ValueError as error:
                    raise ValueError(f"{data.name}: {error}") from error
            self.beginnings = beginnings
        self.unknowns = [each for begin in self.beginnings for each in begin.unknowns]
        if self.is_delay_sought:
            self.unknowns.append(Unknown(ALL, "input_delay", self.delay, low=-LONGEST_DELAY, high=LONGEST_DELAY))
        self.measured = np.concatenate([self._columns(data) for data in self.data])
        for column, name in enumerate(self.outputs):
            if name.endswith("_position_rev"):
                self._compare_edges(column)

    def on(self, data: Sequence[Data], **changes: Any) -> Problem:
        """Return a copy of the problem with other data and the fields of `changes`; `evaluations` begins at 0."""
        return replace(self, data=data, angle_deg=None, evaluations=0, **changes)

    def leave_out_few(self) -> list[int]:
        """Leave out outputs with fewer than two samples to compare; return the indices of those kept.

        So few samples do not determine the noise of an output.
        """
        counts = np.sum(np.isfinite(self.measured), axis=0)
        kept = [column for column, count in enumerate(counts) if count >= _FEW]
        self.outputs = [self.outputs[column] for column in kept]
        self.measured = self.measured[:, kept]
        self._counted = {
            kept.index(column): earlier for column, earlier in self._counted.items() if column in kept
        }
        return kept

    def _compare_edges(self, column: int) -> None:
        """Restrict the comparison of a position that is a Hall count to its edges.

        Between two samples that differ the position is, on average, half-way between the counts, while a constant
        count says little, and repeats it with every sample.
        """
        quantum = 1.0 / self.vehicle.sensors.hall_counts
        values = self.measured[:, column]
        there = np.flatnonzero(np.isfinite(values))
        if not len(there) or not is_count(values, quantum):
            return
        earlier = np.arange(len(values))
        earlier[there[1:]] = there[:-1]
        first = np.cumsum([0, *(len(data.times) for data in self.data)])[:-1]
        number = np.searchsorted(first, np.arange(len(values)), side="right")
        changed = (values != values[earlier]) & (number == number[earlier]) & np.isfinite(values)
        self.measured[:, column] = np.where(changed, 0.5 * (values + values[earlier]), np.nan)
        self._counted[column] = earlier

    def _columns(self, data: Data) -> Floats:
        nothing = np.full(len(data.times), np.nan)
        return np.column_stack([data.outputs.get(name, nothing) for name in self.outputs])

    @property
    def initial(self) -> Floats:
        """Point at which the search begins: initial values (p,) of the parameters, then of the unknowns."""
        return np.array([s.initial for s in self.sought] + [u.value for u in self.unknowns])

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest values (p,) of the parameters, then of the unknowns."""
        low = [s.low for s in self.sought] + [u.low for u in self.unknowns]
        high = [s.high for s in self.sought] + [u.high for u in self.unknowns]
        return np.array(low), np.array(high)

    @property
    def sizes(self) -> Floats:
        """Sizes (p,) of a typical change of each parameter, then of each unknown, by which both are scaled."""
        by_range = [1e-2 * min(s.high - s.low, 1.0) for s in self.sought]
        own = [abs(s.initial) or size for s, size in zip(self.sought, by_range, strict=True)]
        default = {"angle": 0.01, "rate": 0.1, "input_delay": 0.01}
        default |= {"warmth": 10.0, "housing_warmth": 10.0}
        return np.array(own + [default.get(u.name, max(1.0, abs(u.value))) for u in self.unknowns])

    def priors(self) -> tuple[Floats, Floats]:
        """Return (means, 1/std), (p,) each, of the priors of a point's values; both 0 where there is no prior."""
        mean = [s.prior for s in self.sought] + [u.value for u in self.unknowns]
        std = [s.prior_std for s in self.sought] + [u.std for u in self.unknowns]
        weight = 1.0 / np.array(std)
        return np.where(weight > 0.0, np.array(mean), 0.0), weight

    def vehicle_at(self, point: Floats) -> Vehicle:
        """Return the vehicle with the parameters of a point of the search."""
        names = [s.parameter for s in self.sought]
        return with_values(self.vehicle, names, [float(x) for x in point[: len(names)]])

    def refusals(self, point: Floats) -> Sequence[str]:
        """Return the issues with the vehicle at a point, by the checks of `refused_by`, one line each."""
        return self.refused_by(self.vehicle_at(point)) if self.sought else []

    def predicted(self, point: Floats, late: Sequence[Floats] | None = None) -> Floats:
        """Return the prediction (rows, outputs) of all experiments, one below the other, in the outputs' units.

        `late` [s] states for each experiment by how much each of its `changes` comes later than its timestamp.
        """
        self.evaluations += 1
        return self.on_all_cpus(lambda _: self.prediction(point, late), [0])[0]

    def on_all_cpus(self, simulate: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """Call `simulate`, which calls `prediction`, with each item in threads; return its results in order.

        `simulate` calls `prediction`. Machine code that is missing is compiled beforehand, in the calling thread,
        where an interrupt (Ctrl-C) ends the compilation.
        """
        if not self._is_ready:
            data, plant, base = self.data[0], plant_of(self.vehicle), load_of(self.vehicle)
            first = data.rows[:1], data.inputs[:1]
            trajectory(plant, _IDEAL, base, REST, MODELS[self.model], *first, self.longest)
            self._is_ready = True
        return on_all_cpus(simulate, items, sum(len(data.rows) for data in self.data))

    def prediction(self, point: Floats, late: Sequence[Floats] | None = None) -> Floats:
        """Return the prediction like `predicted`, but not counted in `evaluations`, for use in `on_all_cpus`."""
        vehicle = self.vehicle_at(point)
        plant = plant_of(vehicle)
        parts = []
        for number in range(len(self.data)):
            own = None if late is None else late[number]
            rows = self._rows(vehicle, plant, point, number, own)
            parts.append(self._samples(number, rows, self.outputs))
        whole = parts[0] if len(parts) == 1 else np.concatenate(parts)
        for column, earlier in self._counted.items():
            whole[:, column] = 0.5 * (whole[:, column] + whole[earlier, column])
        return whole

    def states(self, point: Floats, number: int) -> Floats:
        """Return one experiment's simulated trajectory.OUTPUTS (rows, 7) at a point of the search."""
        vehicle = self.vehicle_at(point)

        def samples(each: int) -> Floats:
            rows = self._rows(vehicle, plant_of(vehicle), point, each)
            return self._samples(each, rows, OUTPUTS)

        return self.on_all_cpus(samples, [number])[0]

    def _samples(self, number: int, rows: Floats, names: Sequence[str]) -> Floats:
        """Return the samples (n, names) of an experiment from its simulated rows (N, 7)."""
        columns = [OUTPUTS.index(name) for name in names]
        data = self.data[number]
        if data.decimation is None:
            return rows[:, columns]
        shown = zip(names, columns, strict=True)
        return np.column_stack([data.thinned(name, rows[:, column]) for name, column in shown])

    def _rows(
        self, vehicle: Vehicle, plant: Plant, point: Floats, number: int, late: Floats | None = None
    ) -> Floats:
        """Return an experiment's simulated OUTPUTS (N, 7) in all rows of its inputs, with delay and offsets."""
        values = point[len(self.sought) :]
        data, start = self.data[number], self.beginnings[number].start
        aside = {"input_delay": self.delay}
        for unknown, value in zip(self.unknowns, values, strict=True):
            if unknown.experiment in (number, ALL):
                if unknown.name not in Start._fields:
                    aside[unknown.name] = float(value)
                else:
                    start = start._replace(**{unknown.name: float(value)})
        base = load_of(vehicle)._replace(latch_released=1.0)
        if start.balanced > 0.0:
            in_pause = self.beginnings[number].in_pause
            start = _with_currents(plant, data, base, start, in_pause)
        delay = aside["input_delay"] + (np.zeros(1) if late is None else late)
        times, inputs, kept = _delayed(data, self.changes[number], delay)
        out = trajectory(
            plant,
            vehicle.sensors if data.through_sensors else _IDEAL,
            base,
            start,
            MODELS[self.model],
            times,
            inputs,
            self.longest,
        )[kept]
        if self.speed_window > 0.0:
            for speed, position in ((2, 4), (3, 5)):
                out[:, speed] = _mean_speed(data.rows, out[:, position], out[:, speed], self.speed_window)
        out[:, 4] += aside.get("left_offset", 0.0)
        out[:, 5] += aside.get("right_offset", 0.0)
        return out

    def slopes(self, point: Floats, predicted: Floats) -> Floats:
        """Return slopes (rows, outputs, p) by one-sided differences from `predicted`, the prediction at the point.

        They take half the simulations of `derivative`, and are accurate to about 1e-5.
        """
        _, high = self.bounds
        steps = _DIFFERENCE * np.maximum(np.abs(point), self.sizes)
        steps = np.where(point + steps > high, -steps, steps)

        def slope(k: int) -> Floats:
            return self._difference(_moved(point, k, steps[k]), point, k, predicted)

        return self._slopes(slope, len(point))

    def derivative(self, point: Floats, widths: Floats | None = None) -> Floats:
        """Return slopes (rows, outputs, p) by central differences of `predicted`, one-sided at a bound.

        Differences span half the `widths` (p,) to either side where these are given and wider. A simulation costs
        half a microsecond a row and is smooth to 1e-12, so differences are accurate to about 1e-8.
        """
        narrow = 2.0 * _DIFFERENCE * np.maximum(np.abs(point), self.sizes)
        widths = narrow if widths is None else np.maximum(widths, narrow)
        low, high = self.bounds

        def slope(k: int) -> Floats:
            above = _moved(point, k, min(0.5 * widths[k], high[k] - point[k]))
            below = _moved(point, k, max(-0.5 * widths[k], low[k] - point[k]))
            return self._difference(above, below, k, self.prediction(below))

        self.evaluations += len(point)
        return self._slopes(slope, len(point))

    def _difference(self, above: Floats, below: Floats, k: int, predicted: Floats) -> Floats:
        """Return the slope (rows, outputs) between points that differ in value k; `predicted` is for `below`."""
        slope = self.prediction(above)
        with np.errstate(invalid="ignore", over="ignore"):  # predictions may have diverged
            slope -= predicted
            slope /= above[k] - below[k]
        return slope

    def _slopes(self, slope: Callable[[int], Floats], count: int) -> Floats:
        """Return slopes (rows, outputs, count) from those of each value of a point, computed on all CPUs."""
        self.evaluations += count
        # An unknown's slopes are contiguous in memory, because they are filled and summed in that order.
        slopes = np.empty((count, *self.measured.shape))

        def fill(k: int) -> None:
            slopes[k] = slope(k)

        self.on_all_cpus(fill, range(count))
        return np.moveaxis(slopes, 0, 2)


def _moved(point: Floats, k: int, step: float) -> Floats:
    other = point.copy()
    other[k] += step
    return other


def _with_currents(plant: Plant, data: Data, base: Load, start: Start, in_pause: bool) -> Start:
    """Return the start with the windings' steady-state currents: at the first voltage; `in_pause`: at none."""
    inputs = inputs_of(data.inputs[0], base, NOMINAL)
    currents = {}
    for side in ("left", "right"):
        drive, given = getattr(plant, side), getattr(inputs, side)
        volts = given.voltage + given.duty * inputs.load.supply_voltage
        emf = drive.motor.speed_constant * start.speed
        steady = ((0.0 if in_pause else volts) - emf) / drive.motor.resistance
        currents[f"{side}_current"] = 0.0 if given.coast else drive.active * steady
    return start._replace(**currents)


def _mean_speed(times: Floats, position: Floats, speed: Floats, window: float) -> Floats:
    """Return the mean speed (n,) [rev/s] over the last `window` seconds, at the beginning over what there is."""
    before = np.maximum(times - window, times[0])
    span = times - before
    way = position - np.interp(before, times, position)
    return np.where(span > 0.0, way / np.where(span > 0.0, span, 1.0), speed)


def _delayed(
    data: Data, changes: NDArray[np.intp], delay: Floats
) -> tuple[Floats, Floats, NDArray[np.intp] | slice]:
    """Return (times, inputs, indices of the rows) with every input change `delay` (m or 1,) seconds later."""
    if not np.any(delay):
        return data.rows, data.inputs, slice(None)
    later = np.maximum.accumulate(data.rows[changes] + delay)
    inside = (later > data.rows[0]) & (later < data.rows[-1])
    times = np.union1d(data.rows, later[inside])
    last = np.maximum(np.searchsorted(later, times, side="right") - 1, 0)
    return times, data.inputs[changes[last]], np.searchsorted(times, data.rows)
