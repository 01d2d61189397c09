"""States of gate and ECU at the scenario's time 0, after a precondition that variants of a campaign share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.ecu.node import REFERENCE
from liftgate_hil.isolate.isolation import foreign_code
from liftgate_hil.loop.precondition import after_precondition
from liftgate_hil.loop.tick import copied

if TYPE_CHECKING:
    from liftgate_hil.ecu.adapter import Adapter
    from liftgate_hil.ecu.node import NodeState
    from liftgate_hil.loop.episode import LoopStart
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.tick import LoopState
    from liftgate_hil.plan.plan import Plan
    from liftgate_hil.stimuli.stimulus_plan import StimulusPlan


@dataclass(frozen=True)
class _Kept:
    """State after a precondition, and the values that it depends on."""

    key: tuple[Any, ...]
    loop: LoopState
    node: NodeState
    origin: int  # tick of the scenario's time 0
    in_flight: int  # frames of the ECU


class SharedStarts:
    """Cache of the state after the last precondition, for runs in one process that differ only later on.

    Obstacles, profiles, faults and requests of a scenario act from its time 0 on, so that a precondition depends
    on vehicle, seed, rig, ECU and bus traffic alone. Only the reference ECU has a state that can be copied.
    """

    def __init__(self) -> None:
        self._kept: _Kept | None = None

    def started(
        self, plan: Plan, adapter: Adapter, start: LoopStart, stopped: Callable[[], bool], memory: Memory | None
    ) -> LoopStart:
        """Return the loop at time 0 from its `start`, the plan's or a copy. Raises as `after_precondition`."""
        actions = plan.setup.scenario.precondition
        if not actions:
            return start
        if (kept := self._restored(plan, adapter, start)) is not None:
            return kept
        before = copied(start.stimuli)
        found = after_precondition(start, adapter, actions, stopped, partial(foreign_code, memory))
        self._keep(plan, adapter, before, found)
        return found

    def _restored(self, plan: Plan, adapter: Adapter, begin: LoopStart) -> LoopStart | None:
        """Restore the ECU's and the stimuli's kept state; return the loop at time 0; None: none fits this run."""
        kept = self._kept
        if kept is None or kept.key != _key_of(plan):
            return None
        adapter.state = reference_copied(kept.node)
        adapter.begins_anew(kept.origin * plan.start.config.step, kept.in_flight)
        begin.stimuli.origin[0] = kept.origin
        return begin._replace(state=copied(kept.loop))

    def _keep(self, plan: Plan, adapter: Adapter, before: StimulusPlan, after: LoopStart) -> None:
        """Keep a reference ECU's state after a precondition if only the stimuli's origin changed; else none."""
        stimuli = after.stimuli
        # When faults are looked at next is found anew at time 0, with the same result.
        faults = before.faults._replace(next=stimuli.faults.next)
        same = before._replace(origin=stimuli.origin, faults=faults)
        is_shared = adapter.kind == REFERENCE and _are_equal(stimuli, same)
        node, origin = reference_copied(adapter.state), int(stimuli.origin[0])
        kept = _Kept(_key_of(plan), copied(after.state), node, origin, adapter.in_flight)
        self._kept = kept if is_shared else None


def reference_copied(node: NodeState) -> NodeState:
    """Return a state of the reference ECU with arrays of its own; the port, which it does not use, is shared."""
    return node._replace(reference=copied(node.reference))


def _key_of(plan: Plan) -> tuple[Any, ...]:
    """Return the key of a precondition: all that it depends on but rig, ECU and rate, which all runs share."""
    setup = plan.setup
    scenario = setup.scenario
    return setup.vehicle, setup.seed, setup.start_angle, scenario.precondition, scenario.signals


def _are_equal(one: Any, other: Any) -> bool:
    """Whether two nested tuples of arrays are equal, NaN being equal to NaN."""
    if isinstance(one, np.ndarray):
        return bool(one.shape == other.shape and one.tobytes() == other.tobytes())
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(_are_equal, one, other))
    return bool(one == other)
