"""Data for the drawing of a gate: its geometry over its angle, and the obstacle and springs that act now."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_compiler import picked
from liftgate_hil.loop.tick import panel_obstacle
from liftgate_hil.stimuli.command_queue import HELD_OBSTACLE
from liftgate_hil.stimuli.timeline import obstacle_at
from liftgate_plant.constants import constants_of, numbers_of
from liftgate_plant.gate import GRAVITY, Point, extension, linkage
from liftgate_plant.spring import force
from liftgate_plant.vehicle import Vehicle

if TYPE_CHECKING:
    from liftgate_hil.codec.receive import Reception
    from liftgate_hil.loop.tick import LoopConfig
    from liftgate_hil.stimuli.stimulus_plan import StimulusPlan
    from liftgate_plant.obstacle import Obstacle

_ANGLES = 41  # at which the moving points are given


def geometry_of(vehicle: Vehicle) -> dict[str, Any]:
    """Return the geometry of a vehicle [m, deg] in its plane, x rearward and y up, as `GET /api/geometry` does.

    `angles_deg` (n,) are angles of the gate from closed to open; `edge`, and of each drive `gate_point`,
    `length_m` and the force `spring_n` of its spring [N], are given at each. `closed_deg` is the direction from
    the hinge to the edge of the closed gate: a point of the gate turns about the hinge by the gate's angle,
    counterclockwise (3.15 to 3.23).
    """
    gate, place = vehicle.gate, vehicle.environment
    hinge = np.array(gate.hinge)
    centre = np.array(gate.gravity_point) - hinge
    closed = math.atan2(centre[1], centre[0])
    edge = hinge + gate.length * np.array([math.cos(closed), math.sin(closed)])
    angles = np.linspace(0.0, gate.open_angle, _ANGLES)
    ends, body = _turned(gate.gate_point, hinge, angles), np.array(gate.body_point)
    link, sides = linkage(gate), (vehicle.left, vehicle.right)[: vehicle.drives]
    joints = {
        "body_point": body.tolist(),
        "gate_point": ends.tolist(),
        "length_m": np.hypot(*(ends - body).T).tolist(),
    }
    springs = [
        [
            force(each.spring, extension(link, angle), link.stroke, place.ambient_temperature)
            for angle in angles.tolist()
        ]
        for each in sides
    ]
    return {
        "hinge": hinge.tolist(),
        "closed_deg": math.degrees(closed),
        "open_angle_deg": math.degrees(gate.open_angle),
        "stops_deg": [0.0, math.degrees(gate.open_angle)],
        "length_m": gate.length,
        "thickness_m": gate.thickness,
        "weight_n": gate.mass * GRAVITY,
        "half_width_m": gate.half_width,
        "angles_deg": np.degrees(angles).tolist(),
        "edge": _turned((float(edge[0]), float(edge[1])), hinge, angles).tolist(),
        "gravity_point": _turned(gate.gravity_point, hinge, angles).tolist(),
        "drives": {
            side: {**joints, "spring_n": forces} for side, forces in zip(("left", "right"), springs, strict=False)
        },
        "stroke_m": link.stroke,
        "hand_distance_m": place.hand_distance,
        "snow_distance_m": place.snow_distance,
        "latch_distance_m": vehicle.latch.distance,
        "latch_has_positions": vehicle.latch.half > 0.0,
        "seal_distance_m": vehicle.seal.arm,
        "pinch_limit_n": gate.pinch_limit,
    }


def _turned(point: Point, hinge: Any, angles: Any) -> Any:
    """Return a point of the closed gate, turned about the hinge by each angle (n,) [rad]: (n, 2) [m]."""
    x, y = np.array(point) - hinge
    cos, sin = np.cos(angles), np.sin(angles)
    return hinge + np.column_stack([x * cos - y * sin, x * sin + y * cos])


@dataclass(frozen=True)
class Acting:
    """Obstacle and spring health of a run's gate, from stimuli and reception that its loop writes in place."""

    vehicle: Vehicle
    config: LoopConfig
    stimuli: StimulusPlan
    reception: Reception

    def at(self, time_s: float) -> Mapping[str, object]:
        """Return the obstacle and the springs' health at a time [s] of the scenario.

        `obstacle` has angle_deg, distance [m] and meets, None: there is none; `spring_health` the share of its
        force that each drive's spring has.
        """
        rod = self._obstacle(time_s)
        described = {
            "angle_deg": round(math.degrees(rod.angle), 9),
            "distance": float(rod.distance),
            "meets": "closing" if rod.direction > 0.0 else "opening",
        }
        springs = {side: float(self.stimuli.faults.row[place]) for side, place in self._places.items()}
        return {"obstacle": None if rod.stiffness == 0.0 else described, "spring_health": springs}

    def _obstacle(self, time_s: float) -> Obstacle:
        """Return the obstacle by a tick's precedence: the commanded one, a test bench panel's, the scenario's."""
        commanded: Obstacle = picked(self.stimuli.held, HELD_OBSTACLE)
        if not math.isnan(commanded.stiffness):
            return commanded
        below = obstacle_at(self.stimuli.timeline, self.stimuli.moments, time_s)
        found: Obstacle = panel_obstacle(self.config, self.reception.values, below)
        return found

    @functools.cached_property
    def _places(self) -> dict[str, int]:
        """Index of each drive's spring health among the gate's constants, by side."""
        names = list(numbers_of(constants_of(self.vehicle)))
        sides = ("left", "right")[: self.vehicle.drives]
        return {side: names.index(f"plant.{side}.spring.health") for side in sides}
