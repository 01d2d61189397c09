"""Where a run begins: its scene before the first tick, and the loop after what goes before."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING

from liftgate_hil import session
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.node import NO_ECU
from liftgate_hil.loop.precondition import gone_through
from liftgate_hil.runs.job import Parts
from liftgate_hil.runs.signs_of_life import foreign_code
from liftgate_hil.staging import staged
from liftgate_hil.stimuli.slots import CLOSED, Opening

if TYPE_CHECKING:
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.tick import LoopConfig, LoopState
    from liftgate_hil.stimuli.scene import Scene


def begin(
    parts: Parts,
    config: LoopConfig,
    adapter: Adapter,
    stopped: Callable[[], bool],
    memory: Memory | None,
    opening: Opening = CLOSED,
) -> tuple[Scene, LoopState]:
    """The scene at its time 0, open to what may be injected, and the loop there. Raises as `gone_through`."""
    setup, is_on_bus = parts.setup, adapter.kind == NO_ECU
    scene = staged(setup, parts.rig, is_on_bus, opening=opening)
    state = session.start_of(config, setup.start_angle)
    if is_on_bus:  # what goes before is on the wire
        return scene, state
    actions, guard = setup.scenario.precondition, functools.partial(foreign_code, memory)
    return scene, gone_through(config, state, scene, adapter, actions, stopped, guard)
