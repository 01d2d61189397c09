"""The driver of a run in machine code: gate and ECU in this process, waiting for nobody."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from liftgate_hil.drive.execution import Execution
from liftgate_hil.drive.recordings import Recordings
from liftgate_hil.errors import ConfigError
from liftgate_hil.isolate.signs_of_life import foreign_code
from liftgate_hil.judging.judge import Judge
from liftgate_hil.loop.begun import Begun
from liftgate_hil.loop.episode import Episode
from liftgate_hil.loop.progress_monitor import ProgressMonitor
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.plan.job import PRIVATE_BUS
from liftgate_hil.plan.provenance import content_of


class EpisodeDriver:
    """Runs a plan as fast as it goes; see `driver.Driver`."""

    def __init__(self, execution: Execution) -> None:
        self._execution = execution
        self._recordings: Recordings | None = None
        self._episode: Episode | None = None
        self._stimuli = execution.plan.stimuli
        self._has_failed = False
        self.begun: Begun | None = None  # no bench is late here: no gate is stepped again

    def begin(self, stack: contextlib.ExitStack) -> None:
        """Open the recordings, run the scenario's precondition, and compile the episode.

        Raises ConfigError if the run has no duration, and the errors of the precondition.
        """
        plan, execution = self._execution.plan, self._execution
        if plan.ticks is None:
            raise ConfigError("`duration`: missing; allowed: in the scenario, or as an argument")
        listener = plan.job.listener
        self._recordings = Recordings(plan, content_of(plan, PRIVATE_BUS), listener.alarm, stack)
        stimuli, state = execution.start()
        self._stimuli = stimuli
        sinks = [*execution.sinks, *self._recordings.sinks]
        reads_the_bus = any(isinstance(each, Judge) and each.reads_the_bus for each in sinks)
        self._episode = episode = Episode(
            plan.config,
            state,
            stimuli,
            execution.adapter,
            sinks,
            is_recorded=bool(self._recordings.sinks) or reads_the_bus,
            memory=execution.memory,
        )
        # Messages of progress are of no use at this speed; the result has the same.
        before, reception = int(stimuli.origin[0]), episode.state.reception
        episode.monitor = ProgressMonitor(plan.rig, plan.config, reception, listener, ticks_before=before)
        stack.callback(episode.close)
        listener.starts(f"{plan.setup.vehicle_name} without a bus")
        if plan.way is not None:
            listener.say("note: with `clock` free and the ECU in this process no bus is opened: `bus` is ignored")
        episode.begin()

    def advance(self, ticks: int | None, stopped: Callable[[], bool]) -> None:
        """Run until so many ticks are done."""
        assert self._episode is not None
        assert ticks is not None
        self._has_failed = True
        with foreign_code(self._execution.memory):
            self._episode.run(ticks, stopped)
        self._has_failed = False

    def finish(self) -> None:
        """Tick once more with the motors off, where nothing has gone wrong."""
        if self._episode is not None and not self._has_failed:
            with foreign_code(self._execution.memory):
                self._episode.finish()

    def summary(self) -> Summary:
        """The figures of the run."""
        if self._episode is None or self._recordings is None:
            return Summary(clock="free")
        summary = self._episode.summary(self._execution.plan.rig.bitrate)
        self._recordings.note(summary)
        return self._execution.told(summary, self._episode.state, self._stimuli)

    def recording_failures(self) -> list[str]:
        """Why recordings are not complete."""
        return [] if self._recordings is None else self._recordings.failures()
