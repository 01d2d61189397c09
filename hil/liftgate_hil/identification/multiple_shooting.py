"""Multiple shooting, a start for the search where the initial vehicle is far off.

The data are cut into short segments, each of which begins at the measured state. The effect of a parameter error
accumulates along a simulation, so that the loss of a long one has many minima (a simulated gate that never starts
to move says nothing about its travel). Over a short segment errors stay small, and the loss is nearly a parabola:
multiple shooting with the states fixed (Bock 1983).
"""

from __future__ import annotations

import math

import numpy as np

from liftgate_hil.identification.data import Data, Floats, part_of
from liftgate_hil.identification.initial_condition import InitialCondition, is_closed
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.residuals import local_line
from liftgate_hil.identification.statistics import fit_percent
from liftgate_hil.identification.trajectory import REST
from liftgate_plant import gate, rigid
from liftgate_plant.dynamics import Plant
from liftgate_plant.rows import AT
from liftgate_plant.vehicle import plant_of

_LENGTH = 0.25  # s, duration of a segment, at least
_SAMPLES = 20  # rows of a segment, at least
_MOST = 50  # segments of an experiment, at most; evenly spread, they are enough for a start


def in_segments(problem: Problem) -> Problem | None:
    """Return the problem with data in segments; None without position and speed, or if all of it is latched."""
    plant = plant_of(problem.vehicle)
    segments: list[Data] = []
    beginnings: list[InitialCondition] = []
    for number, data in enumerate(problem.data):
        path = _path(problem, plant, number, data)
        if path is None:
            return None
        zeros = {name: _zero(problem, number, name) for name in data.outputs if "position" in name}
        for first, last in _edges(data):
            angle = rigid.angle_at(plant.link, plant.left.travel * float(path[0][first]))
            held = np.searchsorted(data.rows, data.times[first], side="right") - 1
            if data.inputs[held, AT.latch_released] == 0.0 and is_closed(math.degrees(angle)):
                continue  # the latch holds the gate, wherever the drives push
            segments.append(part_of(data, first, last, zeros))
            left, right, speed = (float(column[first]) for column in path)
            start = REST._replace(balanced=1.0, speed=speed, left_position=left, right_ahead=right - left)
            beginnings.append(InitialCondition(start, ()))
    if not segments:
        return None
    return problem.on(segments, beginnings=beginnings)


def _edges(data: Data) -> list[tuple[int, int]]:
    """Return (first, last) sample of each segment, last exclusive; if there are many, an even selection."""
    edges, first = [], 0
    while first < len(data.times) - 2:
        last = int(np.searchsorted(data.times, data.times[first] + _LENGTH))
        last = min(max(last, first + _SAMPLES), len(data.times))
        edges.append((first, last))
        first = last - 1
    if len(edges) <= _MOST:
        return edges
    return [edges[k] for k in np.linspace(0, len(edges) - 1, _MOST).astype(int)]


def _zero(problem: Problem, number: int, name: str) -> float:
    """Return the initial value [rev] of a position counter's unknown zero; 0 if its zero is not estimated."""
    wanted = name.replace("_position_rev", "_offset")
    for unknown in problem.beginnings[number].unknowns:
        if unknown.name == wanted:
            return unknown.value
    return 0.0


def _path(problem: Problem, plant: Plant, number: int, data: Data) -> tuple[Floats, Floats, Floats] | None:
    """Return smoothed left and right position [rev], speed [rev/s]; None: neither positions nor speeds."""
    found = {}
    for side in ("left", "right"):
        position = data.outputs.get(f"{side}_position_rev")
        if position is not None and np.sum(np.isfinite(position)) > 2:
            there = np.isfinite(position)
            zero = _zero(problem, number, f"{side}_position_rev")
            found[side] = local_line(data.times[there], position[there] - zero, data.times)
    if not found:
        return _path_of_speed(problem, plant, number, data)
    left = found.get("left", found.get("right"))
    right = found.get("right", left)
    assert left is not None
    assert right is not None
    return left[0], right[0], left[1]


def _path_of_speed(
    problem: Problem, plant: Plant, number: int, data: Data
) -> tuple[Floats, Floats, Floats] | None:
    for side in ("left", "right"):
        speed = data.outputs.get(f"{side}_speed_rps")
        if speed is not None and np.sum(np.isfinite(speed)) > 2:
            there = np.isfinite(speed)
            smooth, _ = local_line(data.times[there], speed[there], data.times)
            start = problem.beginnings[number].start
            begin = start.left_position
            if start.balanced == 0.0:
                begin = gate.extension(plant.link, start.angle) / plant.left.travel
            way = np.cumsum(np.diff(data.times) * 0.5 * (smooth[1:] + smooth[:-1]))
            position = begin + np.concatenate([[0.0], way])
            return position, position, smooth
    return None


def is_far_off(problem: Problem, errors: Floats, worst_percent: float) -> bool:
    """Whether the NRMSE fit of any measured motion is below `worst_percent`; `errors` are measured − predicted.

    The motion is that of the positions and the angle, or of the speeds where there are none of these.
    """
    for kind in (("_position_rev", "_angle_deg"), ("_speed_rps",)):
        fits = []
        for k, name in enumerate(problem.outputs):
            there = np.isfinite(problem.measured[:, k])
            if name.endswith(kind) and np.any(there):
                measured = problem.measured[there, k]
                fits.append(fit_percent(measured, measured - errors[there, k]))
        if known := [each for each in fits if not math.isnan(each)]:
            return min(known) < worst_percent
    return False
