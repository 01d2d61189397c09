"""The driver of a run on a bus in the Python loop: in lockstep, or on the free clock."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING

from liftgate_hil.drive.recordings import Recordings
from liftgate_hil.loop.begun import Begun
from liftgate_hil.loop.lockstep import Lockstep, run_lockstep
from liftgate_hil.loop.python_loop import Loop, run_free
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.plan.provenance import content_of
from liftgate_hil.transport.find import open_transport

if TYPE_CHECKING:
    from liftgate_hil.drive.bus_run import BusRun, Going
    from liftgate_hil.drive.precondition import Phase
    from liftgate_hil.loop.observers import Sink
    from liftgate_hil.loop.tick import LoopState
    from liftgate_hil.transport.base import Transport


class PythonDriver:
    """Runs a plan on its bus in the Python loop; see `driver.Driver`."""

    def __init__(self, run: BusRun) -> None:
        self._run = run
        self._recordings: Recordings | None = None
        self._loop: Loop | None = None
        self._before_start = 0  # frames that came before the first phase was ready
        self._summary = Summary(clock=run.plan.request.clock)
        self.begun: Begun | None = None

    def begin(self, stack: contextlib.ExitStack) -> None:
        """Open the bus and the recordings, run the phases before time 0, and compile the loop.

        Raises ConfigError, TransportError, PreconditionError.
        """
        run, plan = self._run, self._run.plan
        transport = run.opened(open_transport, stack)
        channel, say = run.channel(transport), run.listener.alarm
        self._recordings = Recordings(plan, content_of(plan, channel, run.way.interface), say, stack)
        sinks = [*run.sinks, *self._recordings.sinks, *self._shown(channel, stack)]
        has_run = run.prepare(functools.partial(self._phase_begun, transport))
        self._loop = loop = Loop(
            config=plan.config,
            state=run.state,
            stimuli=run.stimuli,
            transport=transport,
            peers=run.peers,
            sinks=sinks,
            monitor=run.monitor(),
            observers=run.observers.in_order(),
            bitrate=run.way.bitrate(plan.rig),
            command=plan.rig.command_identifier(),
            before_start=self._before_start,
        )
        run.listener.starts(f"{plan.setup.vehicle_name} on {channel}")
        loop.begin(is_first=not has_run)
        run.listener.ready()
        self.begun = Begun.at(plan.config, run.state, run.stimuli)

    def _shown(self, channel: str, stack: contextlib.ExitStack) -> list[Sink]:
        """Return the sink that fills the memory which attached clients read; none where no client may attach."""
        from liftgate_hil.loop.realtime_run import memory_for
        from liftgate_hil.loop.rings import RingSink

        run, server = self._run, self._run.observers.server
        if server is None:
            return []
        memory = memory_for(run.plan.request.rate)
        stack.callback(memory.close)
        assert self._recordings is not None
        further = run.let_in(channel, memory, self._recordings.mark, stack)
        return [RingSink(memory, lambda: server.is_attended() or further.is_on)]

    def _phase_begun(self, transport: Transport, phase: Phase, is_first: bool) -> Going:
        """Begin a phase before time 0, and return the function that runs it from a state until it is stopped."""
        before = Loop(
            self._run.plan.config,
            self._run.state,
            phase.stimuli,
            transport,
            sinks=[phase.end],
            command=self._run.plan.rig.command_identifier(),
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
        request, rig = self._run.plan.request, self._run.plan.rig
        if request.clock == "free" or self._run.peers:
            # Peers in this process are in step by themselves, those that are silent, too.
            run_free(loop, ticks, stopped)
        else:
            lockstep = Lockstep(
                command=rig.command_identifier(),
                ticks_per_command=max(1, round(rig.command_cycle_ms() * 1e-3 * request.rate)),
                wall_timeout=request.wall_timeout,
                say=self._run.listener.say,
            )
            run_lockstep(loop, lockstep, ticks, stopped)

    def advance(self, ticks: int | None, stopped: Callable[[], bool]) -> None:
        """Run until so many ticks are done (None: without limit), or the run is stopped."""
        assert self._loop is not None
        try:
            self._clocked(self._loop, ticks, stopped)
        finally:
            self._run.observers.end()

    def finish(self) -> None:
        """Run one more tick with the motors off, and take the figures of the run."""
        loop, clock = self._loop, self._run.plan.request.clock
        assert loop is not None
        try:
            loop.finish()
        finally:  # a plant that has diverged does so again
            summary = loop.summary(clock)
            self._summary = self._run.execution.told(summary, self._run.state, self._run.stimuli)

    def summary(self) -> Summary:
        """The figures of the run."""
        if self._recordings is not None:
            self._recordings.note(self._summary)
        return self._summary

    def recording_failures(self) -> list[str]:
        """Why recordings are not complete."""
        return [] if self._recordings is None else self._recordings.failures()
