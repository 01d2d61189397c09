"""Execution of a plan in this process: the ECU and the sinks of one run, and how it is stopped and watched."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from liftgate_hil.ecu.node import NO_ECU
from liftgate_hil.isolate.signs_of_life import foreign_code
from liftgate_hil.judging.judge import Judge
from liftgate_hil.loop.precondition import after_precondition
from liftgate_hil.loop.refusal_texts import RefusalTexts
from liftgate_hil.loop.tick import copied
from liftgate_hil.plan.loop_start import start_of

if TYPE_CHECKING:
    from liftgate_hil.drive.shared_starts import SharedStarts
    from liftgate_hil.ecu.adapter import Adapter
    from liftgate_hil.loop.observers import Sink
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.statistics import Summary
    from liftgate_hil.loop.tick import LoopState
    from liftgate_hil.plan.plan import Plan
    from liftgate_hil.stimuli.stimulus_plan import StimulusPlan


@dataclass(frozen=True)
class Execution:
    """Run of a plan in this process, as each driver is given it."""

    plan: Plan
    adapter: Adapter  # of the ECU in this process; of none, where the ECU is on a bus
    sinks: Sequence[Sink]
    stopped: Callable[[], bool]
    memory: Memory | None  # of the loop, where another process watches it
    starts: SharedStarts | None = None  # states after preconditions, where many runs share them

    @property
    def judge(self) -> Judge | None:
        """The judge among the sinks; None: there is nothing to judge."""
        return next((each for each in self.sinks if isinstance(each, Judge)), None)

    def start(self) -> tuple[StimulusPlan, LoopState]:
        """Return a copy of the plan's stimuli, and the state of the loop, both at time 0. Raises as `started`."""
        stimuli = copied(self.plan.stimuli)
        return stimuli, self.started(stimuli)

    def told(self, summary: Summary, state: LoopState, stimuli: StimulusPlan) -> Summary:
        """Return the summary of a run, with what it has on refused frames filled in."""
        plan = self.plan
        began_s = int(stimuli.origin[0]) * plan.config.step
        texts = RefusalTexts(plan.rig, plan.config, began_s, is_bus=plan.way is not None)
        texts.tell(summary, state.reception)
        received = summary.received
        summary.discarded = min(received.lost, self.adapter.in_flight)  # by the counter of the next frame
        summary.received = received._replace(lost=received.lost - summary.discarded)
        return summary

    def started(self, stimuli: StimulusPlan) -> LoopState:
        """Return the state of the loop at time 0, where `stimuli` begin.

        An ECU in this process goes through the precondition; that of an ECU on a bus is on the wire. Raises as
        `after_precondition`.
        """
        plan = self.plan
        state = start_of(plan.config, plan.setup.start_angle)
        if self.adapter.kind == NO_ECU:
            return state
        if self.starts is not None and self.starts.restore(plan, self.adapter, stimuli):
            return self.starts.loop_state()
        actions = plan.setup.scenario.precondition
        before = copied(stimuli) if self.starts is not None and actions else None
        config, adapter, guard = plan.config, self.adapter, partial(foreign_code, self.memory)
        state = after_precondition(config, state, stimuli, adapter, actions, self.stopped, guard)
        if self.starts is not None and before is not None:
            self.starts.keep(plan, adapter, before, stimuli, state)
        return state
