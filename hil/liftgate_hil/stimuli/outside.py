"""Stimuli that act during one tick, as one value: timeline, and the values that commands hold.

Precedence for a quantity: the scenario's profile, over it the bus panel, over both the API and the dashboard. The
panel's frames are read by the tick itself.
"""

from __future__ import annotations

from typing import NamedTuple

from liftgate_compiler import compilable, picked
from liftgate_hil.signals import Timing
from liftgate_hil.stimuli.held_values import HELD_OBSTACLE, HELD_SURROUNDINGS, HELD_TIMING
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan
from liftgate_hil.stimuli.timeline import obstacle_at, profiles_over, supply_rise_over
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.signals import Surroundings


class Outside(NamedTuple):
    """Stimuli that act during one tick."""

    profiles: Surroundings  # the scenario's, their mean over the tick; NaN: none
    supply_rise: float  # V, rise of the scenario's supply over the tick
    obstacle: Obstacle  # the scenario's; stiffness 0: none
    commanded: Surroundings  # by API or dashboard; NaN: none
    commanded_obstacle: Obstacle  # stiffness NaN: none
    timing: Timing  # timing reported by the loop
    ticks_before: int  # plant steps done before the scenario's time 0
    ticks_missed: int  # so far
    is_silent: bool  # makes up for a missed tick and sends nothing
    is_stop: bool  # the last tick: motors off, every message once more


@compilable
def outside_at(
    stimuli: StimulusPlan, time: float, step: float, ticks_missed: int, is_silent: bool, is_stop: bool
) -> Outside:
    """Return the stimuli that act during the step [s] from a time on."""
    timeline, held = stimuli.timeline, stimuli.held
    return Outside(
        profiles=profiles_over(timeline, time, step),
        supply_rise=supply_rise_over(timeline, time, step),
        obstacle=obstacle_at(timeline, stimuli.moments, time),
        commanded=picked(held, HELD_SURROUNDINGS),
        commanded_obstacle=picked(held, HELD_OBSTACLE),
        timing=picked(held, HELD_TIMING),
        ticks_before=stimuli.origin[0],
        ticks_missed=ticks_missed,
        is_silent=is_silent,
        is_stop=is_stop,
    )
