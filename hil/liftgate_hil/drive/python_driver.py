"""Driver of a run on a bus in the Python loop: in lockstep, or on the free clock."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING

from liftgate_hil.drive.bus_driver import BusDriver
from liftgate_hil.drive.driver import Recordings
from liftgate_hil.loop.lockstep import Lockstep, run_lockstep
from liftgate_hil.loop.python_loop import Loop, run_free
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.plan.provenance import content_of
from liftgate_hil.transport.find import open_transport

if TYPE_CHECKING:
    from liftgate_hil.drive.bus_driver import Going
    from liftgate_hil.drive.precondition import Phase
    from liftgate_hil.loop.observers import Sink
    from liftgate_hil.loop.tick import LoopState
    from liftgate_hil.transport.base import Transport


class PythonDriver(BusDriver):
    """Driver of a run on its bus in the Python loop, with `clock` free or lockstep."""

    _loop: Loop | None = None
    _before_start = 0  # frames that came before the first phase was ready
    _summary: Summary | None = None

    def begin(self, stack: contextlib.ExitStack) -> None:
        """Open the bus and the recordings, run the phases before time 0, and compile the loop.

        Raises ConfigError, TransportError, PreconditionError.
        """
        plan = self.plan
        transport = self.opened(open_transport, stack)
        channel, say = self.channel(transport), self.listener.alarm
        self.recordings = recordings = Recordings(plan, content_of(plan, channel, self.way.interface), say, stack)
        sinks = [*self.sinks, *recordings.sinks, *self._sinks_of_clients(channel, recordings, stack)]
        has_run = self.run_phases(functools.partial(self._phase_begun, transport))
        self._loop = loop = Loop(
            config=self.start.config,
            state=self.start.state,
            stimuli=self.start.stimuli,
            transport=transport,
            peers=self.peers,
            sinks=sinks,
            monitor=self.monitor(),
            observers=self.observers.in_order(),
            bitrate=self.way.bitrate(plan.rig),
            command=plan.rig.command_identifier(),
            before_start=self._before_start,
        )
        self.listener.starts(f"{plan.setup.vehicle_name} on {channel}")
        loop.begin(is_first=not has_run)
        self.listener.ready()

    def _sinks_of_clients(self, channel: str, recordings: Recordings, stack: contextlib.ExitStack) -> list[Sink]:
        """Let clients attach to a new memory; return a list of the sink that fills it; empty: none may attach."""
        from liftgate_hil.loop.realtime_run import memory_for
        from liftgate_hil.loop.rings import RingSink

        server = self.observers.server
        if server is None:
            return []
        memory = memory_for(self.plan.request.rate)
        stack.callback(memory.close)
        further = self.let_in(channel, memory, recordings.mark, stack)
        return [RingSink(memory, lambda: server.is_attended() or further.is_on)]

    def _phase_begun(self, transport: Transport, phase: Phase, is_first: bool) -> Going:
        """Begin a phase before time 0, and return the function that runs it from a state until it is stopped."""
        before = Loop(
            self.start.config,
            self.start.state,
            phase.stimuli,
            transport,
            sinks=[phase.end],
            command=self.plan.rig.command_identifier(),
        )
        before.begin(is_first)
        self._before_start += before.before_start

        def go(state: LoopState, stopped: Callable[[], bool]) -> LoopState:
            before.state = state
            self._clocked(before, None, stopped)
            return before.state

        return go

    def _clocked(self, loop: Loop, ticks: int | None, stopped: Callable[[], bool]) -> None:
        """Run the loop on the clock of the request until `ticks` are done (None: no limit) or it is stopped."""
        request, rig = self.plan.request, self.plan.rig
        if request.clock == "free" or self.peers:
            # Peers in this process are in step by themselves, those that are silent, too.
            run_free(loop, ticks, stopped)
        else:
            lockstep = Lockstep(
                command=rig.command_identifier(),
                ticks_per_command=max(1, round(rig.command_cycle_ms() * 1e-3 * request.rate)),
                wall_timeout=request.wall_timeout,
                say=self.listener.say,
            )
            run_lockstep(loop, lockstep, ticks, stopped)

    def advance(self, ticks: int | None) -> None:
        """Run until `ticks` ticks after time 0 are done (None: without limit), or the run is stopped."""
        assert self._loop is not None
        try:
            self._clocked(self._loop, ticks, self.stopped)
        finally:
            self.observers.end()

    def finish(self) -> None:
        """Run one more tick with the motors off, and store the summary of the run."""
        assert self._loop is not None
        try:
            self._loop.finish()
        finally:  # a plant that has diverged does so again
            summary = self._loop.summary(self.plan.request.clock)
            self._summary = self.completed(summary, self.start.state, self.start.stimuli)

    def summary(self) -> Summary:
        """Return the summary of the run."""
        found = self._summary or Summary(clock=self.plan.request.clock)
        if self.recordings is not None:
            self.recordings.note(found)
        self.observers.note(found)
        return found
