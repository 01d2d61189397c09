"""Driver of a run: begins, advances and finishes a plan on one kind of clock, with its ECU and its sinks."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from liftgate_hil.judging.judge import Judge
from liftgate_hil.loop.refusal_texts import RefusalTexts
from liftgate_hil.loop.statistics import Summary

if TYPE_CHECKING:
    from liftgate_hil.drive.recordings import Recordings
    from liftgate_hil.drive.stepping import StepsAgain
    from liftgate_hil.ecu.adapter import Adapter
    from liftgate_hil.loop.observers import Sink
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.tick import LoopState
    from liftgate_hil.operate.attachment.server import RunEnd
    from liftgate_hil.plan.plan import Plan
    from liftgate_hil.stimuli.stimulus_plan import StimulusPlan


class Driver:
    """Base class of the drivers. Its life: `prepare`, `begin`, `advance`, `finish`, `summary`, `tell_end`.

    `adapter` is that of the ECU in this process, of none where the ECU is on a bus. `memory` is that of the loop,
    where another process watches it.
    """

    def __init__(
        self,
        plan: Plan,
        adapter: Adapter,
        sinks: Sequence[Sink] = (),
        stopped: Callable[[], bool] = lambda: False,
        memory: Memory | None = None,
    ) -> None:
        self.plan, self.adapter, self.sinks, self.stopped, self.memory = plan, adapter, sinks, stopped, memory
        self.judge = next((each for each in sinks if isinstance(each, Judge)), None)
        self.recordings: Recordings | None = None  # in this process

    def prepare(self, stack: contextlib.ExitStack) -> None:
        """Open what is needed until the result is told, closed with the stack.

        Raises ConfigError, TransportError, and what `started` raises.
        """

    def begin(self, stack: contextlib.ExitStack) -> None:
        """Open all else that the run needs, closed with the stack, and go through its precondition. Raises
        ConfigError, TransportError, PreconditionError, RecordingError, and what an ECU's code raises.
        """
        raise NotImplementedError

    def advance(self, ticks: int | None) -> None:
        """Run until so many ticks after time 0 are done (None: without limit), or the run is stopped. Raises
        OverrunError, PlantDivergedError, EcuError.
        """
        raise NotImplementedError

    def finish(self) -> None:
        """Switch the motors off and hand on what is left, also after a run that failed."""
        raise NotImplementedError

    def summary(self) -> Summary:
        """Return the figures of the run; those of recordings are whole once the stack is closed."""
        raise NotImplementedError

    def recording_failures(self) -> list[str]:
        """Return why recordings are incomplete, one text each."""
        return [] if self.recordings is None else self.recordings.failures()

    def not_made(self, has_failed: bool) -> str:
        """Return, after the run, which of the scenario's stimuli could not be applied; "": all were."""
        return ""

    def steps_again(self, summary: Summary) -> StepsAgain | None:
        """Return what steps the gate again, where the bench may have been late; None: it cannot be stepped."""
        return None

    def tell_end(self, end: RunEnd) -> None:
        """Tell attached clients, where there are any, how the run has ended."""

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
