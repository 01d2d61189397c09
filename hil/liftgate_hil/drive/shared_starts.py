"""States of gate and ECU after a precondition, copied for the next runs that have the same one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.ecu.node import REFERENCE
from liftgate_hil.loop.tick import copied

if TYPE_CHECKING:
    from liftgate_hil.ecu.adapter import Adapter
    from liftgate_hil.ecu.node import NodeState
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
    """The state after the last precondition, for runs in one process that differ only in what comes after it.

    Obstacles, profiles, faults and requests of a scenario act from its time 0 on, so that a precondition depends
    on vehicle, seed, rig, ECU and bus traffic alone. Only the reference ECU has a state that can be copied.
    """

    def __init__(self) -> None:
        self._kept: _Kept | None = None

    def restore(self, plan: Plan, adapter: Adapter, stimuli: StimulusPlan) -> bool:
        """Put the ECU, and the origin of `stimuli`, into the kept state; False: there is none for this run."""
        kept = self._kept
        if kept is None or kept.key != _key_of(plan):
            return False
        adapter.state = reference_copied(kept.node)
        adapter.begins_anew(kept.origin * plan.config.step, kept.in_flight)
        stimuli.origin[0] = kept.origin
        return True

    def loop_state(self) -> LoopState:
        """Return a copy of the loop's state that was restored last."""
        assert self._kept is not None
        return copied(self._kept.loop)

    def keep(
        self, plan: Plan, adapter: Adapter, before: StimulusPlan, stimuli: StimulusPlan, loop: LoopState
    ) -> None:
        """Keep the state after a precondition, unless that has changed more of the stimuli than their origin."""
        origin = int(stimuli.origin[0])
        # When faults are looked at next is found anew at time 0, with the same result.
        faults = before.faults._replace(next=stimuli.faults.next)
        same = before._replace(origin=stimuli.origin, faults=faults)
        is_shared = adapter.kind == REFERENCE and _are_equal(stimuli, same)
        node = reference_copied(adapter.state)
        kept = _Kept(_key_of(plan), copied(loop), node, origin, adapter.in_flight)
        self._kept = kept if is_shared else None


def reference_copied(node: NodeState) -> NodeState:
    """Return a state of the reference ECU with arrays of its own; the port, which it does not use, is shared."""
    return node._replace(reference=copied(node.reference))


def _key_of(plan: Plan) -> tuple[Any, ...]:
    """Return what a precondition depends on, apart from rig, ECU and rate, which all runs here have in common."""
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
