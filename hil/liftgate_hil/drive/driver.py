"""Base class of drivers, each of which runs a plan on one kind of clock; and the recordings of a run."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from liftgate_hil.formats.guarded import Say, failures_of
from liftgate_hil.formats.open import open_writers
from liftgate_hil.isolate.recorders import RecordingSink
from liftgate_hil.judging.judge import Judge
from liftgate_hil.loop.refusal_texts import RefusalTexts
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.plan.recording_trigger import Triggered

if TYPE_CHECKING:
    from liftgate_hil.drive.stepping import StepsAgain
    from liftgate_hil.ecu.adapter import Adapter
    from liftgate_hil.formats.content import Content
    from liftgate_hil.loop.observers import Sink
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.tick import LoopState
    from liftgate_hil.operate.attachment.server import RunEnd
    from liftgate_hil.plan.plan import Plan
    from liftgate_hil.stimuli.stimulus_plan import StimulusPlan


class Recordings:
    """Recording files of a run, open until the stack is left.

    `sinks` write the run's rows and frames to them; there is none where nothing is recorded. No wall
    clock applies: the recordings are the same every time.
    """

    def __init__(self, plan: Plan, content: Content, say: Say, stack: contextlib.ExitStack) -> None:
        request = plan.request
        self.writers = open_writers(request.recordings, content, request.limit(), say, stack)
        self._triggered = None if plan.trigger is None else Triggered(plan.trigger)
        sink = RecordingSink(self.writers, content, self._triggered)
        stack.callback(sink.flush)  # before the files are closed
        self.sinks: list[Sink] = [sink] if self.writers else []

    def mark(self, time_s: float, text: str) -> bool:
        """Write an operator's mark at a time [s] of the run to its recordings; False: a recording has failed."""
        for each in self.writers:
            each.write_mark(time_s, text)
        return not any(each.failure for each in self.writers)

    def note(self, summary: Summary) -> None:
        """Enter files and windows of the recordings in the run's summary; complete once the stack is closed."""
        summary.recordings = [file for each in self.writers for file in each.files]
        if self._triggered is not None:
            summary.recording_windows = self._triggered.count


class Driver:
    """Base class of drivers. Order of calls: `prepare`, `begin`, `advance`, `finish`, `summary`, `tell_end`.

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
        """Open the resources needed until the result has been reported; leaving the `stack` closes them.

        Raises ConfigError, TransportError, and what `after_precondition` raises.
        """

    def begin(self, stack: contextlib.ExitStack) -> None:
        """Open all other resources of the run, closed with the `stack`, and run its precondition.

        Raises ConfigError, TransportError, PreconditionError, RecordingError, and what an ECU's code raises.
        """
        raise NotImplementedError

    def advance(self, ticks: int | None) -> None:
        """Run until `ticks` ticks after time 0 are done (None: without limit), or the run is stopped.

        Raises OverrunError, PlantDivergedError, EcuError.
        """
        raise NotImplementedError

    def finish(self) -> None:
        """Switch the motors off and pass the remaining rows and frames to the sinks, also after a failed run."""
        raise NotImplementedError

    def summary(self) -> Summary:
        """Return the summary of the run; its figures of recordings are complete once the stack is closed."""
        raise NotImplementedError

    def recording_failures(self) -> list[str]:
        """Return why recordings are incomplete, one text each."""
        return [] if self.recordings is None else failures_of(self.recordings.writers)

    def not_made(self, has_failed: bool) -> str:
        """Return, after the run, which of the scenario's stimuli could not be applied; "": all were."""
        return ""

    def steps_again(self, summary: Summary) -> StepsAgain | None:
        """Return the function that simulates the run again with earlier and later commands; None: impossible."""
        return None

    def tell_end(self, end: RunEnd) -> None:
        """Tell attached clients, if any, how the run has ended."""

    def completed(self, summary: Summary, state: LoopState, stimuli: StimulusPlan) -> Summary:
        """Complete a run's summary with the counts and texts of refused and discarded frames, and return it."""
        plan = self.plan
        began_s = int(stimuli.origin[0]) * plan.start.config.step
        texts = RefusalTexts(plan.rig, plan.start.config, began_s, is_bus=plan.way is not None)
        texts.tell(summary, state.reception)
        received = summary.received
        summary.discarded = min(received.lost, self.adapter.in_flight)  # by the counter of the next frame
        summary.received = received._replace(lost=received.lost - summary.discarded)
        return summary
