"""Experiment design: D-optimality of candidate inputs, from the model's sensitivities.

The information of an experiment is M = Σ ψᵀ Λ⁻¹ ψ with ψ relative to each parameter's value, so ½ log₁₀ det M⁻¹ is
the log of the volume of relative uncertainty (Ljung, System Identification, 2nd ed., 13.3; Atkinson and Donev,
Optimum Experimental Designs). The information matrices of independent experiments add up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.identification import statistics
from liftgate_hil.identification.data import Data, Floats, rows_of
from liftgate_hil.identification.problem import Problem, Sought
from liftgate_hil.plan.provenance import Provenance
from liftgate_plant.vehicle import Vehicle

_BIT = 0.05  # s, duration of one bit of the PRBS
_CHIRP = (0.2, 20.0)  # Hz, first and last frequency
_SLOPE_DEG = 8.0
# Noise of sensors where the vehicle specifies none: a shunt's amplifier, a Hall speed's rounding, a potentiometer.
_NOISE = {"current_a": 0.05, "speed_rps": 0.5, "angle_deg": 0.1}


# fmt: off
@dataclass(frozen=True)
class Candidate(DescribedResult):
    """An experiment that could be run: motor voltage (n,) [V] of all drives over `times` (n,) [s], from rest."""

    name: Annotated[str, Shown("name of the experiment", key="experiment")]
    times: Floats
    voltage: Floats
    angle_deg: Annotated[float, Shown("gate angle at its begin [deg]", key="initial_angle_deg")]
    road_slope_deg: Annotated[float, Shown("slope of the road [deg]")]


@dataclass(frozen=True)
class Ranked(DescribedResult):
    """Candidate experiment with the information that it would yield."""

    # of the relative information; −inf: some parameters are not identifiable
    log_det: Annotated[float, Shown("decimal logarithm of the information matrix's determinant; null: not all "
        "parameters are identifiable", key="log10_det")]
    candidate: Annotated[Candidate, Shown("", is_flat=True)]
    relative_std: Floats  # (p,) expected standard deviations relative to the values; inf: not identifiable
    names: tuple[str, ...]  # of the parameters

    @property
    def relative_std_of(self) -> Annotated[Mapping[str, float], Shown("expected standard deviations",
            key="relative_std", keys={"NAME": "of a parameter, divided by its value: 0.01 is 1 %; null: "
            "unknown"})]:
        """Expected standard deviation of each parameter relative to its value."""
        return dict(zip(self.names, self.relative_std.tolist(), strict=True))


@dataclass(frozen=True)
class ExperimentPlan(DescribedResult):
    """Plan of experiments: candidates ranked by their information, and the best sequence."""

    names: Annotated[tuple[str, ...], Shown("names of the parameters to be estimated", key="parameters")]
    ranked: Annotated[tuple[Ranked, ...], Shown("single experiments, the most informative first")]
    order: Annotated[tuple[Ranked, ...], Shown("the best sequence; each row counts together with all before it")]
    provenance: Annotated[Provenance | None, Shown("see Provenance")] = None


# fmt: on


def candidates(vehicle: Vehicle, duration: float, rate: float) -> list[Candidate]:
    """Return candidate inputs within the supply's voltage: steps, chirp, PRBS, open-close, some on slopes."""
    times = np.arange(round(duration * rate) + 1) / rate
    full = vehicle.supply.voltage
    top = math.degrees(vehicle.gate.open_angle)
    share = times / max(duration, 1e-9)
    phase = _CHIRP[0] * times + 0.5 * (_CHIRP[1] - _CHIRP[0]) * share * times
    chirp = full * (0.6 + 0.35 * np.sin(2.0 * math.pi * phase))
    # 0.3 s is bit 6, although 0.3 / 0.05 is less than 6.
    bits = prbs(math.ceil(duration / _BIT) + 1)[np.floor(times / _BIT + 1e-6).astype(int)]
    random = full * np.where(bits, 0.9, 0.35)
    turns = full * np.select([share < 0.4, share < 0.5, share < 0.9], [1.0, 0.0, -1.0], 0.0)
    level = [
        ("step to full voltage, opening", np.full(len(times), full), 0.0),
        ("step to half voltage, opening", np.full(len(times), 0.5 * full), 0.0),
        ("step to full voltage, closing", np.full(len(times), -full), top),
        ("open, stop, close", turns, 0.0),
        ("chirp 0.2 to 20 Hz, opening", chirp, 0.0),
        ("PRBS of 50 ms, opening", random, 0.0),
        ("PRBS of 50 ms, closing", -random, top),
    ]
    found = [Candidate(name, times, volts, angle, 0.0) for name, volts, angle in level]
    for slope in (_SLOPE_DEG, -_SLOPE_DEG):
        found += [
            Candidate(f"{name}, slope {slope:+g} deg", times, volts, angle, slope)
            for name, volts, angle in (level[0], level[5])
        ]
    return found


def prbs(bits: int) -> NDArray[np.bool_]:
    """Return a pseudo-random binary sequence (bits,) of period 1023, from the shift register x¹⁰ + x⁷ + 1."""
    register = [True] * 10
    result = np.empty(bits, dtype=np.bool_)
    for k in range(bits):
        result[k] = register[-1]
        register = [register[9] != register[6], *register[:-1]]
    return result


def noise_of(vehicle: Vehicle, output: str) -> float:
    """Return the expected standard deviation of a measured output's noise, in the output's unit."""
    sensors = vehicle.sensors
    if output.endswith("current_a"):
        return (
            math.hypot(sensors.current_noise, sensors.current_resolution / math.sqrt(12.0))
            or (_NOISE["current_a"])
        )
    if output.endswith("position_rev"):
        return 1.0 / (sensors.hall_counts * math.sqrt(12.0))
    if output.endswith("angle_deg"):
        noise = math.hypot(sensors.angle_noise, sensors.angle_resolution / math.sqrt(12.0))
        return math.degrees(noise) or _NOISE["angle_deg"]
    return _NOISE["speed_rps"]


def plan(
    vehicle: Vehicle,
    model: str,
    sought: Sequence[Sought],
    outputs: Sequence[str],
    offered: Sequence[Candidate],
    count: int = 3,
) -> ExperimentPlan:
    """Rank the candidates, and choose one by one the `count` experiments that are most informative together."""
    root = np.diag([1.0 / noise_of(vehicle, name) for name in outputs])
    matrices = [_information(vehicle, model, sought, outputs, each, root) for each in offered]
    names = tuple(each.parameter.name for each in sought)
    ranked = [_ranked(each, matrix, names) for each, matrix in zip(offered, matrices, strict=True)]
    total = np.zeros_like(matrices[0])
    order: list[Ranked] = []
    for _ in range(min(count, len(offered))):
        sums = [_ranked(each, total + matrix, names) for each, matrix in zip(offered, matrices, strict=True)]
        best = max(range(len(sums)), key=lambda k: _order(sums[k]))
        total = total + matrices[best]
        order.append(sums[best])
    ranked.sort(key=_order, reverse=True)
    return ExperimentPlan(names, tuple(ranked), tuple(order))


def _order(each: Ranked) -> tuple[int, float, float]:
    """Return the sort key of a candidate: number of identifiable parameters, then information."""
    identifiable = np.isfinite(each.relative_std)
    spread = -float(np.sum(np.log(each.relative_std[identifiable]))) if np.any(identifiable) else -math.inf
    return int(np.sum(identifiable)), each.log_det, spread


def _information(
    vehicle: Vehicle,
    model: str,
    sought: Sequence[Sought],
    outputs: Sequence[str],
    candidate: Candidate,
    root: Floats,
) -> Floats:
    slope = np.full(len(candidate.times), candidate.road_slope_deg)
    columns = {"left_voltage_v": candidate.voltage, "road_slope_deg": slope}
    nothing = np.zeros(len(candidate.times))
    data = Data(
        candidate.name, candidate.times, rows_of(columns, len(candidate.times)), dict.fromkeys(outputs, nothing)
    )
    problem = Problem(vehicle, model, sought, [data], outputs, angle_deg=candidate.angle_deg)
    known = problem.priors()[1]
    known[: len(sought)] = 0.0
    sizes, slopes = problem.sizes, problem.derivative(problem.initial)
    whole = statistics.information(slopes * sizes, root, known * sizes)
    # The information that is left on the sought parameters where a counter's zero is estimated too.
    own, rest = slice(len(sought)), slice(len(sought), None)
    across = whole[own, rest]
    return whole[own, own] - across @ np.linalg.inv(whole[rest, rest]) @ across.T


def _ranked(candidate: Candidate, matrix: Floats, names: tuple[str, ...]) -> Ranked:
    known = statistics.uncertainty(matrix)
    std = np.sqrt(np.maximum(np.diag(known.covariance), 0.0))
    lost = [*known.silent, *(k for group in known.apart for k in group)]
    std[lost] = np.inf
    sign, logarithm = np.linalg.slogdet(matrix)
    log_det = float(logarithm) / math.log(10.0) if sign > 0 and not lost else -math.inf
    return Ranked(log_det, candidate, std, names)
