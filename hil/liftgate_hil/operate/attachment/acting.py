"""Obstacle and springs of a running gate as they are now, for its drawing, whoever put or changed them."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from liftgate_compiler import picked
from liftgate_hil.loop.tick import panel_obstacle
from liftgate_hil.stimuli.command_queue import HELD_OBSTACLE
from liftgate_hil.stimuli.timeline import obstacle_at
from liftgate_plant.constants import constants_of, numbers_of

if TYPE_CHECKING:
    from liftgate_hil.codec.receive import Reception
    from liftgate_hil.loop.tick import LoopConfig
    from liftgate_hil.stimuli.stimulus_plan import StimulusPlan
    from liftgate_plant.obstacle import Obstacle
    from liftgate_plant.vehicle import Vehicle


@dataclass(frozen=True)
class Acting:
    """Obstacle and springs of a run's gate, from the stimuli and the reception that its loop writes in place."""

    vehicle: Vehicle
    config: LoopConfig
    stimuli: StimulusPlan
    reception: Reception

    def at(self, time_s: float) -> Mapping[str, object]:
        """Return obstacle and springs at a time [s] of the scenario.

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
        """Return the obstacle with the precedence of a tick: what was commanded, a panel's, the scenario's."""
        commanded: Obstacle = picked(self.stimuli.held, HELD_OBSTACLE)
        if not math.isnan(commanded.stiffness):
            return commanded
        below = obstacle_at(self.stimuli.timeline, self.stimuli.moments, time_s)
        found: Obstacle = panel_obstacle(self.config, self.reception.values, below)
        return found

    @functools.cached_property
    def _places(self) -> dict[str, int]:
        """Places of the springs' health among the gate's constants, by drive."""
        names = list(numbers_of(constants_of(self.vehicle)))
        sides = ("left", "right")[: self.vehicle.drives]
        return {side: names.index(f"plant.{side}.spring.health") for side in sides}
