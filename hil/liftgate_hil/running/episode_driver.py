"""The driver of a run in machine code: gate and ECU in this process, waiting for nobody."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.content import Content
from liftgate_hil.judging.judge import Judge
from liftgate_hil.loop.begun import Begun
from liftgate_hil.loop.closed_loop import Episode
from liftgate_hil.loop.observers import Sink
from liftgate_hil.loop.progress_monitor import ProgressMonitor
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.running.job import PRIVATE_BUS, identity_of_ecu
from liftgate_hil.running.plan import Plan
from liftgate_hil.running.provenance import origin_of
from liftgate_hil.running.recording_sink import RecordingSink
from liftgate_hil.running.recording_trigger import Triggered
from liftgate_hil.running.signs_of_life import foreign_code
from liftgate_hil.running.start import started
from liftgate_hil.signals import columns_of

if TYPE_CHECKING:
    from liftgate_hil.formats.guarded import GuardedWriter
    from liftgate_hil.loop.rings import Memory


class EpisodeDriver:
    """Runs a plan as fast as it goes; see `driver.Driver`. Others may see the loop's `memory`."""

    def __init__(
        self,
        plan: Plan,
        adapter: Adapter,
        sinks: Sequence[Sink],
        stopped: Callable[[], bool],
        memory: Memory | None,
    ) -> None:
        self._plan, self._adapter, self._sinks = plan, adapter, sinks
        self._stopped, self._memory = stopped, memory
        self._recorders: list[GuardedWriter] = []
        self._triggered: Triggered | None = None
        self._episode: Episode | None = None
        self._has_failed = False
        self.begun: Begun | None = None  # no bench is late here: no gate is stepped again

    def begin(self, stack: contextlib.ExitStack) -> None:
        """Open the recordings, go through the precondition, and compile."""
        from liftgate_hil.formats.open import open_writers

        if self._plan.ticks is None:
            raise ConfigError("`duration`: missing; allowed: in the scenario, or given")
        plan, job, memory = self._plan, self._plan.job, self._memory
        about = origin_of(plan, identity_of_ecu(job, plan.setup))
        content = Content(columns_of(plan.setup.vehicle.drives), PRIVATE_BUS, about=about)
        options, say = plan.options, job.listener.say
        self._recorders = open_writers(options.records, content, options.limit(), say, stack)
        self._triggered = None if plan.trigger is None else Triggered(plan.trigger)
        recording = RecordingSink(self._recorders, sieve=self._triggered)
        stack.callback(recording.flush)
        sinks = [*self._sinks, recording] if self._recorders else self._sinks
        stimuli, start = started(plan, self._adapter, self._stopped, memory)
        reads_the_bus = any(isinstance(each, Judge) and each.reads_the_bus for each in sinks)
        self._episode = episode = Episode(
            plan.config,
            start,
            stimuli,
            self._adapter,
            sinks,
            is_recorded=bool(self._recorders) or reads_the_bus,
            memory=memory,
        )
        # Too fast for a story: the result has it.
        before, reception = int(stimuli.origin[0]), episode.state.reception
        episode.monitor = ProgressMonitor(
            plan.rig, plan.config, reception, job.listener, ticks_before=before
        )
        stack.callback(episode.close)
        job.listener.starts(f"{plan.setup.vehicle_name} on no bus")
        if plan.way is not None:
            say("nothing is on the bus: with `clock` free gate and ECU are alone")
        episode.begin()

    def advance(self, ticks: int | None, stopped: Callable[[], bool]) -> None:
        """Run until so many ticks are done."""
        assert self._episode is not None
        assert ticks is not None
        self._has_failed = True
        with foreign_code(self._memory):
            self._episode.run(ticks, stopped)
        self._has_failed = False

    def finish(self) -> None:
        """Tick once more with the motors off, where nothing has gone wrong."""
        if self._episode is not None and not self._has_failed:
            with foreign_code(self._memory):
                self._episode.finish()

    def summary(self) -> Summary:
        """The figures of the run."""
        if self._episode is None:
            return Summary(clock="free")
        summary = self._episode.summary(self._plan.rig.bitrate)
        summary.recordings = [file for each in self._recorders for file in each.files]
        if self._triggered is not None:
            summary.recording_windows = self._triggered.count
        return summary

    def recording_failures(self) -> list[str]:
        """Why recordings are not complete."""
        from liftgate_hil.formats.guarded import failures_of

        return failures_of(self._recorders)
