"""Currents of bridges that switch on one source, followed from event to event, apart from the plant's solution.

A bridge is on from the beginning of each of its periods for its duty's share of it, and off for the rest. With
s = 1 for a current that comes from the source, −1 for one that goes back into it, and 0 for one that does neither,
the motors of constant back-EMF e, all of them along their duty, obey

    L di/dt = V − R i − e,    V = s U + v,    U = U_source − R_source Σ s i

    on       s = 1, v = 0
    slow     s = 0, v = 0
    diode    i > 0: s = 0, v = −U_d      i < 0: s = 1, v = U_d
    fast     i > 0: s = −1, v = −2 U_d   i < 0: s = 1, v = 2 U_d
    none     where diodes hold a motor without current, as long as e lies between the voltages of the two lines

Between two events that is linear with constant coefficients, and solved by the eigenvectors of its matrix. Events
are the switches of a bridge, the end of a diode's current, and the beginning of one; they are bracketed on a fine
grid and located to the last bits. Currents run until they repeat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_GRID = 48  # points of a phase at which events are looked for
_REPEATS = 1e-10  # A, by which a current may differ from the one a period before
_NOTHING = 1e-11  # A; so small a current of a diode has ended
_MOST_PERIODS = 4000


class Bridge(NamedTuple):
    """A switching bridge and its motor; `duty` is signed, `emf` [V] has the sign of the motor's speed."""

    mode: str  # slow, diode, fast
    duty: float
    frequency: float  # Hz
    emf: float  # V
    resistance: float = 0.708  # Ω
    inductance: float = 4.37e-5  # H
    drop: float = 0.7  # V, of a diode


class Current(NamedTuple):
    """A motor's current over one period, signed as its motor's torque."""

    mean: float  # A
    rms: float  # A
    drawn: float  # A, mean that the source gives


class Periodic(NamedTuple):
    """All motors' currents, and the mean of the terminal voltage [V]."""

    currents: list[Current]
    terminal: float


class Phase(NamedTuple):
    """Time between two events: the conducting bridges, s and v of each."""

    alive: np.ndarray
    share: np.ndarray
    offset: np.ndarray


def periodic(bridges: Sequence[Bridge], source: float, resistance: float, repeats: float = 0.0) -> Periodic:
    """The currents of bridges on a source [V] behind a resistance [Ω], when they repeat.

    Bridges of several frequencies repeat after a period that they have in common, `repeats` [s]. Raises
    RuntimeError where the currents do not repeat within some thousand periods.
    """
    period = repeats or 1.0 / bridges[0].frequency
    run = _Run(bridges, source, resistance)
    edges = [0.0, period]
    for each in bridges:
        begins = [k / each.frequency for k in range(round(period * each.frequency))]
        edges += begins + [begin + abs(each.duty) / each.frequency for begin in begins]
    edges = sorted(edges)
    edges = [a for a, b in pairwise(edges) if b - a > 1e-9 * period] + [period]
    current = np.zeros(len(bridges))
    for _ in range(_MOST_PERIODS):
        before, sums = current, np.zeros((3, len(bridges)))
        for begin, end in pairwise(edges):
            current, more = run.between(current, begin, end)
            sums += more
        if np.abs(current - before).max() < _REPEATS:
            charge, square, drawn = sums / period
            along = [math.copysign(1.0, each.duty) for each in bridges]
            currents = [
                Current(sign * q, math.sqrt(s), d)
                for sign, q, s, d in zip(along, charge, square, drawn, strict=True)
            ]
            return Periodic(currents, source - resistance * float(drawn.sum()))
    raise RuntimeError("the currents do not repeat")


class _Run:
    """Equations of bridges on one source, and the search for their periodic currents."""

    def __init__(self, bridges: Sequence[Bridge], source: float, resistance: float) -> None:
        self.bridges, self.source, self.shared = bridges, source, resistance
        self.emf = np.array([math.copysign(1.0, each.duty) * each.emf for each in bridges])
        self.resistance = np.array([each.resistance for each in bridges])
        self.inductance = np.array([each.inductance for each in bridges])

    def between(self, current: np.ndarray, begin: float, end: float) -> tuple[np.ndarray, np.ndarray]:
        """The currents [A] at `end`, and ∫ i, ∫ i², ∫ s i dt, between two switches of bridges."""
        middle = 0.5 * (begin + end)
        is_on = [middle * each.frequency % 1.0 < abs(each.duty) for each in self.bridges]
        sums, now, starts = np.zeros((3, len(current))), begin, set[int]()
        while now < end - 1e-15:
            phase = self.phase(current, is_on, starts)
            matrix, force = self.equations(phase)
            ahead, who, begins = self.event(phase, is_on, current, matrix, force, end - now)
            sums += self.integrals(phase, current, matrix, force, ahead)
            current = solution(matrix, force, current, ahead)
            current[~phase.alive] = 0.0
            starts = set()
            for k, each in enumerate(self.bridges):  # those that end at the same instant too
                if not is_on[k] and each.mode != "slow" and abs(current[k]) < _NOTHING:
                    current[k] = 0.0
            if who is not None:
                current[who] = 0.0
                if begins:
                    starts = {who}
            now += ahead
        return current, sums

    def terminal(self, current: np.ndarray, share: np.ndarray) -> float:
        """Terminal voltage U [V] with these currents and shares s."""
        return float(self.source - self.shared * share @ current)

    def window(self, k: int, terminal: float) -> tuple[float, float]:
        """Limits of the EMF [V] within which the diodes of an idle bridge block."""
        drop = self.bridges[k].drop
        if self.bridges[k].mode == "diode":
            return -drop, terminal + drop
        return -terminal - 2.0 * drop, terminal + 2.0 * drop

    def phase(self, current: np.ndarray, is_on: list[bool], starts: set[int]) -> Phase:
        """The conducting bridges with s and v; an idle one begins to conduct if its EMF is beyond its window."""
        count = len(self.bridges)
        share, offset, alive = np.zeros(count), np.zeros(count), np.ones(count, bool)
        for k, each in enumerate(self.bridges):
            if is_on[k]:
                share[k] = 1.0
            elif each.mode != "slow" and current[k] != 0.0:
                share[k], offset[k] = self.freewheel(k, current[k] > 0.0)
        for k, each in enumerate(self.bridges):
            if is_on[k] or each.mode == "slow" or current[k] != 0.0:
                continue
            low, high = self.window(k, self.terminal(current, share))
            if self.emf[k] < low or (k in starts and self.emf[k] < 0.0):
                share[k], offset[k] = self.freewheel(k, True)
            elif self.emf[k] > high or k in starts:
                share[k], offset[k] = self.freewheel(k, False)
            else:
                alive[k] = False
        return Phase(alive, share, offset)

    def freewheel(self, k: int, flows_on: bool) -> tuple[float, float]:
        """s and v of a bridge that is off."""
        drop = self.bridges[k].drop
        if self.bridges[k].mode == "diode":
            return (0.0, -drop) if flows_on else (1.0, drop)
        return (-1.0, -2.0 * drop) if flows_on else (1.0, 2.0 * drop)

    def equations(self, phase: Phase) -> tuple[np.ndarray, np.ndarray]:
        """A and b of di/dt = A i + b."""
        s = phase.share
        matrix = -np.diag(self.resistance) - self.shared * np.outer(s, s)
        force = s * self.source + phase.offset - self.emf
        matrix, force = matrix / self.inductance[:, None], force / self.inductance
        matrix[~phase.alive], force[~phase.alive] = 0.0, 0.0
        matrix[:, ~phase.alive] = 0.0
        return matrix, force

    def event(
        self,
        phase: Phase,
        is_on: list[bool],
        current: np.ndarray,
        matrix: np.ndarray,
        force: np.ndarray,
        left: float,
    ) -> tuple[float, int | None, bool]:
        """Time until a diode's current ends or begins, its bridge, if it begins; else (`left`, None, False)."""
        first: tuple[float, int | None, bool] = (left, None, False)
        for k, each in enumerate(self.bridges):
            if is_on[k] or each.mode == "slow":
                continue
            direction = current[k] if current[k] != 0.0 else force[k]

            def margin(time: float, k: int = k, direction: float = direction) -> float:
                there = solution(matrix, force, current, time)
                if phase.alive[k]:
                    return math.copysign(1.0, direction) * float(there[k])
                low, high = self.window(k, self.terminal(there, phase.share))
                return min(self.emf[k] - low, high - self.emf[k])

            times = np.linspace(0.0, first[0], _GRID)[1:]
            values = [margin(time) for time in times]
            for j, value in enumerate(values):
                if value < 0.0:
                    before = times[j - 1] if j else 1e-3 * times[0]
                    if margin(before) <= 0.0:
                        break
                    when = float(brentq(margin, before, times[j], xtol=1e-18, rtol=1e-14))
                    first = (when, k, not phase.alive[k])
                    break
        return first

    def integrals(
        self, phase: Phase, current: np.ndarray, matrix: np.ndarray, force: np.ndarray, time: float
    ) -> np.ndarray:
        """∫ i, ∫ i² and ∫ s i dt over a phase, by Gauss and Legendre in pieces of half a time constant."""
        quickest = float(np.abs(np.diag(matrix)).max()) + 1e-12
        pieces = max(1, math.ceil(2.0 * time * quickest))
        width, sums = time / pieces, np.zeros((3, len(current)))
        for piece in range(pieces):
            for node, weight in zip(_NODES, _WEIGHTS, strict=True):
                at = (piece + 0.5 * (1.0 + node)) * width
                there = solution(matrix, force, current, at)
                there[~phase.alive] = 0.0
                sums += 0.5 * width * weight * np.array([there, there**2, phase.share * there])
        return sums


def solution(matrix: np.ndarray, force: np.ndarray, current: np.ndarray, time: float) -> np.ndarray:
    """The currents [A] of di/dt = A i + b after a time [s]."""
    values, vectors = np.linalg.eig(matrix)
    start, drive = np.linalg.solve(vectors, current), np.linalg.solve(vectors, force)
    grown = np.where(values == 0.0, time, np.expm1(values * time) / np.where(values == 0.0, 1.0, values))
    result: np.ndarray = np.real(vectors @ (np.exp(values * time) * start + grown * drive))
    return result
