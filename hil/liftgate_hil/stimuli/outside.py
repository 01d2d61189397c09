"""All that acts from outside during one tick, as one value: timeline, and what was posted while the loop runs.

What acts on one quantity: the scenario's profile, over it the bus panel, over both the API and the page. The
panel's frames are read by the tick itself.
"""

from __future__ import annotations

from typing import NamedTuple

from liftgate_hil.signals import Timing
from liftgate_hil.stimuli.mailbox import HELD_OBSTACLE, HELD_SURROUNDINGS, HELD_TIMING
from liftgate_hil.stimuli.scene import Scene
from liftgate_hil.stimuli.timeline import (
    obstacle_at,
    profiles_over,
    supply_rise_over,
)
from liftgate_plant.compiler import compilable, picked
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.signals import Surroundings


class Outside(NamedTuple):
    """One tick's."""

    profiles: Surroundings  # the scenario's, their mean over the tick; NaN: not said
    supply_rise: float  # V, of the scenario's supply over the tick
    obstacle: Obstacle  # the scenario's; stiffness 0: none
    posted: Surroundings  # by API or page; NaN: not said
    posted_obstacle: Obstacle  # stiffness NaN: not said
    timing: Timing  # what the loop says of itself
    ticks_before: int  # plant steps done before the scenario's time 0
    ticks_missed: int  # so far
    is_silent: bool  # makes up for a missed tick: sends nothing
    is_stop: bool  # the last tick: motors off, every message once more


@compilable
def outside_at(
    scene: Scene,
    time: float,
    step: float,
    ticks_missed: int,
    is_silent: bool,
    is_stop: bool,
) -> Outside:
    """What acts during the step [s] from a time on."""
    timeline, held = scene.timeline, scene.held
    return Outside(
        profiles=profiles_over(timeline, time, step),
        supply_rise=supply_rise_over(timeline, time, step),
        obstacle=obstacle_at(timeline, scene.moments, time),
        posted=picked(held, HELD_SURROUNDINGS),
        posted_obstacle=picked(held, HELD_OBSTACLE),
        timing=picked(held, HELD_TIMING),
        ticks_before=scene.origin[0],
        ticks_missed=ticks_missed,
        is_silent=is_silent,
        is_stop=is_stop,
    )
