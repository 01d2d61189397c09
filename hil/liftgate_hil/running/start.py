"""Where a run starts: its stimuli before the first tick, and the loop after the precondition."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING

from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.node import NO_ECU
from liftgate_hil.loop.precondition import gone_through
from liftgate_hil.loop.tick import copied
from liftgate_hil.running.plan import Plan
from liftgate_hil.running.setup import start_of
from liftgate_hil.running.signs_of_life import foreign_code

if TYPE_CHECKING:
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.tick import LoopState
    from liftgate_hil.stimuli.stimulus_plan import StimulusPlan


def started(
    plan: Plan, adapter: Adapter, stopped: Callable[[], bool], memory: Memory | None
) -> tuple[StimulusPlan, LoopState]:
    """The stimuli at time 0, a copy of the plan's, and the loop there, after the precondition with an ECU in this
    process. Raises as `gone_through`.
    """
    setup, stimuli = plan.setup, copied(plan.stimuli)
    state = start_of(plan.config, setup.start_angle)
    if adapter.kind == NO_ECU:  # its precondition is on the wire
        return stimuli, state
    actions, guard = setup.scenario.precondition, functools.partial(foreign_code, memory)
    return stimuli, gone_through(plan.config, state, stimuli, adapter, actions, stopped, guard)
