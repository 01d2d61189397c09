"""Driver of a run in real time: the loop in a thread of machine code, recordings in a process of their own."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING

from liftgate_hil.config.rig_fit import NS
from liftgate_hil.drive.bus_driver import BusDriver
from liftgate_hil.isolate.recorder_process import RecorderProcess
from liftgate_hil.loop.priority import Realtime
from liftgate_hil.loop.realtime_run import RealtimeRun, memory_for
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.plan.provenance import content_of
from liftgate_hil.transport.find import open_line

if TYPE_CHECKING:
    from liftgate_hil.drive.bus_driver import Going
    from liftgate_hil.drive.precondition import Phase
    from liftgate_hil.loop.tick import LoopState
    from liftgate_hil.stimuli.stimulus_plan import StimulusPlan
    from liftgate_hil.transport.base import Line


class RealtimeDriver(BusDriver):
    """Driver of a run on its bus in real time; closing the recorder raises the errors of recordings."""

    _realtime: Realtime | None = None
    _loop: RealtimeRun | None = None
    _recorder: RecorderProcess | None = None

    def begin(self, stack: contextlib.ExitStack) -> None:
        """Open the line, start the recorder's process, compile, and run the phases before time 0."""
        plan = self.plan
        if plan.request.realtime is not False:
            self._realtime = Realtime(plan.request.cpu, bool(plan.request.realtime))
        line = self.opened(open_line, stack)
        channel = self.channel(line)
        made = functools.partial(self._made, line, stack)
        self._loop = loop = made(self.start.stimuli)
        loop.peers, loop.sinks, loop.observers = self.peers, self.sinks, self.observers.in_order()
        self.let_in(channel, loop.memory, self._mark, stack)
        if plan.request.recordings:
            self._recorder = RecorderProcess(loop.memory, list(map(str, plan.request.recordings)))
            stack.callback(self._recorder.close)
            self._recorder.order(
                plan.request.recordings,
                content_of(plan, channel, self.way.interface),
                plan.request.limit(),
                self.listener.alarm,
                plan.trigger,
            )
        self.listener.starts(f"{plan.setup.vehicle_name} on {channel}")
        loop.begin()
        if self._realtime is not None:
            stack.callback(self._realtime.release)
            self._realtime.prepare()
        if self._recorder is not None:
            self._recorder.wait_until_ready()
        self.listener.ready()
        has_run = self.run_phases(functools.partial(self._phase_begun, made))
        loop.state, loop.monitor = self.start.state, self.monitor()
        loop.is_first = not has_run
        if plan.job.gives_up_late and self.judge is not None:
            loop.spoilt = self.judge.spoilt

    def _mark(self, time_s: float, text: str) -> bool:
        return self._recorder is None or self._recorder.mark(time_s, text)

    def _made(self, line: Line, stack: contextlib.ExitStack, stimuli: StimulusPlan) -> RealtimeRun:
        """Return a real-time run on the line with these stimuli, whose memory lasts until the stack is left."""
        plan = self.plan
        memory = memory_for(plan.request.rate)
        stack.callback(memory.close)
        return RealtimeRun(
            config=self.start.config,
            state=self.start.state,
            stimuli=stimuli,
            line=line,
            memory=memory,
            rig=plan.rig,
            bitrate=self.way.bitrate(plan.rig),
            limit_ns=round(plan.request.overrun_limit * NS),
            say=self.listener.say,
            alarm=self.listener.alarm,
            realtime=self._realtime,
        )

    def _phase_begun(self, made: Callable[[StimulusPlan], RealtimeRun], phase: Phase, is_first: bool) -> Going:
        """Prepare the real-time loop of a phase before time 0; return the function that runs it from a state."""
        before = made(phase.stimuli)
        before.sinks, before.is_last, before.is_first = [phase.end], False, is_first
        before.begin()

        def go(state: LoopState, stopped: Callable[[], bool]) -> LoopState:
            before.state = state
            before.run(None, stopped)
            return before.state

        return go

    def advance(self, ticks: int | None) -> None:
        """Run until `ticks` ticks are done (None: no limit) or the run is stopped, then one with motors off."""
        assert self._loop is not None
        try:
            self._loop.run(ticks, self.stopped)
        finally:
            self.observers.end()

    def finish(self) -> None:
        """Do nothing: the loop has switched the motors off itself, without waiting for this thread."""

    def summary(self) -> Summary:
        """Return the summary of the run.

        The counts of the line and of the recorder are final only after both are closed.
        """
        summary = Summary(clock="realtime")
        if self._loop is not None:
            summary = self.completed(self._loop.summary(), self.start.state, self.start.stimuli)
        if self._recorder is not None:
            summary.recording_lost_rows = self._recorder.lost_rows
            summary.recordings = self._recorder.files
            summary.recording_windows = self._recorder.windows
        self.observers.note(summary)
        return summary
