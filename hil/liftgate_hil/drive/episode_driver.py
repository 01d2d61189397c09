"""Driver of a run in machine code, as fast as possible: gate and ECU in this process."""

from __future__ import annotations

import contextlib
from functools import partial

from liftgate_hil.drive.driver import Driver, Recordings
from liftgate_hil.errors import ConfigError
from liftgate_hil.isolate.isolation import foreign_code
from liftgate_hil.loop.episode import Episode
from liftgate_hil.loop.precondition import after_precondition
from liftgate_hil.loop.progress_monitor import ProgressMonitor
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.plan.provenance import content_of
from liftgate_hil.plan.request import PRIVATE_BUS


class EpisodeDriver(Driver):
    """Driver of a run without a bus, as fast as possible. It is never late, so that no run is simulated again."""

    _episode: Episode | None = None
    _has_failed = False

    def begin(self, stack: contextlib.ExitStack) -> None:
        """Open the recordings, run the scenario's precondition, and compile the episode.

        Raises ConfigError if the run has no duration, and the errors of the precondition.
        """
        plan = self.plan
        if plan.ticks is None:
            raise ConfigError("`duration`: missing; allowed: in the scenario, or as an argument")
        listener = plan.job.listener
        self.recordings = Recordings(plan, content_of(plan, PRIVATE_BUS), listener.alarm, stack)
        begin = plan.start.with_own_arrays()
        if actions := plan.setup.scenario.precondition:
            guard = partial(foreign_code, self.memory)
            begin = after_precondition(begin, self.adapter, actions, self.stopped, guard)
        sinks = [*self.sinks, *self.recordings.sinks]
        is_recorded = bool(self.recordings.sinks) or (self.judge is not None and self.judge.reads_the_bus)
        self._episode = episode = Episode(begin, self.adapter, sinks, is_recorded, self.memory)
        # Messages of progress are of no use at this speed; the result has the same.
        before, reception = int(begin.stimuli.origin[0]), episode.state.reception
        episode.monitor = ProgressMonitor(plan.rig, begin.config, reception, listener, ticks_before=before)
        stack.callback(episode.close)
        listener.starts(f"{plan.setup.vehicle_name} without a bus")
        if plan.way is not None:
            listener.say("note: with `clock` free and the ECU in this process no bus is opened: `bus` is ignored")
        episode.begin()

    def advance(self, ticks: int | None) -> None:
        """Run until `ticks` ticks after time 0 are done (never None here), or the run is stopped."""
        assert self._episode is not None
        assert ticks is not None
        self._has_failed = True
        with foreign_code(self.memory):
            self._episode.run(ticks, self.stopped)
        self._has_failed = False

    def finish(self) -> None:
        """Run one more tick with the motors off, unless the run has failed."""
        if self._episode is not None and not self._has_failed:
            with foreign_code(self.memory):
                self._episode.finish()

    def summary(self) -> Summary:
        """Return the summary of the run."""
        if self._episode is None or self.recordings is None:
            return Summary(clock="free")
        summary = self._episode.summary(self.plan.rig.bitrate)
        self.recordings.note(summary)
        return self.completed(summary, self._episode.state, self._episode.stimuli)
