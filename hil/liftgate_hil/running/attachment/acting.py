"""What acts on the gate now, for a drawing: the obstacle in its way, and how much force its springs have left."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from liftgate_hil.loop.tick import panel_obstacle
from liftgate_hil.stimuli.held_values import HELD_OBSTACLE
from liftgate_hil.stimuli.timeline import obstacle_at
from liftgate_plant.compiler import picked
from liftgate_plant.constants import constants_of, numbers_of

if TYPE_CHECKING:
    from liftgate_hil.codec.receive import Reception
    from liftgate_hil.loop.tick import LoopConfig
    from liftgate_hil.stimuli.stimulus_plan import StimulusPlan
    from liftgate_plant.obstacle import Obstacle
    from liftgate_plant.vehicle import Vehicle


@dataclass(frozen=True)
class Acting:
    """What acts on a run's gate, by the stimuli and the reception that its loop reads and writes in place."""

    vehicle: Vehicle
    config: LoopConfig
    stimuli: StimulusPlan
    reception: Reception

    def at(self, time_s: float) -> dict[str, Any]:
        """Return it at a time [s] of the scenario.

        `obstacle` has angle_deg, distance [m] and meets, None: there is none; `spring_health` the share of its
        force that each drive's spring has.
        """
        rod = self._obstacle(time_s)
        return {"obstacle": None if rod.stiffness == 0.0 else _described(rod), "spring_health": self._springs()}

    def _obstacle(self, time_s: float) -> Obstacle:
        """Return the obstacle with the precedence of a tick: what was commanded, a panel's, the scenario's."""
        commanded: Obstacle = picked(self.stimuli.held, HELD_OBSTACLE)
        if not math.isnan(commanded.stiffness):
            return commanded
        below = obstacle_at(self.stimuli.timeline, self.stimuli.moments, time_s)
        found: Obstacle = panel_obstacle(self.config, self.reception.values, below)
        return found

    def _springs(self) -> dict[str, float]:
        names = list(numbers_of(constants_of(self.vehicle)))
        sides = ("left", "right")[: self.vehicle.drives]
        row = self.stimuli.faults.row
        return {side: float(row[names.index(f"plant.{side}.spring.health")]) for side in sides}


def _described(rod: Obstacle) -> dict[str, Any]:
    return {
        "angle_deg": round(math.degrees(rod.angle), 9),
        "distance": float(rod.distance),
        "meets": "closing" if rod.direction > 0.0 else "opening",
    }
