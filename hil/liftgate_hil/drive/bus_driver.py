"""Common part of the drivers of runs on a bus, for every clock: wire, observers, precondition on the wire."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from liftgate_hil.config.choices import WireChoice
from liftgate_hil.config.rig_fit import NS
from liftgate_hil.drive.driver import Driver
from liftgate_hil.drive.precondition import phases_of
from liftgate_hil.drive.stepping import CommandLog, StepsAgain, relevant_frames
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.ecu.peer import Peer
from liftgate_hil.isolate.isolation import ProgressSink, foreign_code
from liftgate_hil.judging.verdict import ERROR, INCONCLUSIVE, STOPPED
from liftgate_hil.loop.listener import Relay
from liftgate_hil.loop.precondition import after_precondition
from liftgate_hil.operate.attachment.description import Description
from liftgate_hil.operate.attachment.drawing import Acting
from liftgate_hil.operate.attachment.server import RunEnd, Server
from liftgate_hil.operate.ecu_reset import restarts_of
from liftgate_hil.operate.further_recording import FurtherRecording
from liftgate_hil.operate.observers import Observers, observers_of
from liftgate_hil.plan.request import PRIVATE_BUS
from liftgate_hil.plan.stimulation import off_not_made, reset_not_made
from liftgate_hil.stimuli.restbus import hand_over
from liftgate_hil.stimuli.stimulus_plan import OFF_A_REAL_BUS
from liftgate_hil.transport.find import find_way, open_transport

if TYPE_CHECKING:
    from liftgate_hil.drive.precondition import Phase
    from liftgate_hil.judging.verdict import Verdict
    from liftgate_hil.loop.episode import LoopStart
    from liftgate_hil.loop.listener import Listener
    from liftgate_hil.loop.progress_monitor import ProgressMonitor
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.statistics import Summary
    from liftgate_hil.loop.tick import LoopState
    from liftgate_hil.operate.ecu_reset import Restarts
    from liftgate_hil.operate.further_recording import Mark
    from liftgate_hil.plan.request import Job
    from liftgate_hil.transport.base import Line, Transport
    from liftgate_hil.transport.find import Way

    Wire = TypeVar("Wire", Line, Transport)
    # Runs a phase from a state until the given function returns True; returns the state then.
    Going = Callable[[LoopState, Callable[[], bool]], LoopState]


class BusDriver(Driver):
    """Base class of the drivers of a run on a bus.

    `prepare` makes wire, peers and observers; `begin` moves `start` on to the scenario's time 0.
    """

    way: Way
    start: LoopStart
    peers: Sequence[Peer] = ()  # the ECU, where it is in this process
    phases: Sequence[Phase] = ()  # before time 0, on the wire
    observers = Observers()
    restarts: Restarts | None = None
    listener: Listener
    log: CommandLog | None = None  # of the ECU's commands, where the gate may have to be stepped again
    begun: LoopStart | None = None  # time 0, once it is known; never changed
    is_prepared = False

    @property
    def is_real(self) -> bool:
        """Whether the bus is not python-can's `virtual`: others may use it, and no `bus_off` is made."""
        return not self.way.is_interface("virtual")

    def prepare(self, stack: contextlib.ExitStack) -> None:
        """Find the bus (else a virtual one), run an in-process ECU's precondition; make peers, observers, server.

        Raises ConfigError, TransportError, and what `after_precondition` raises.
        """
        plan, job, rig, memory = self.plan, self.plan.job, self.plan.rig, self.memory
        server = None
        if job.attachable_as is not None:
            server = _server_of(job, tuple if self.judge is None else self.judge.so_far)
            stack.callback(server.close)
        self.listener = server or job.listener
        self.way = plan.way or find_way(WireChoice(bus=f"virtual:run-{id(plan):x}"), rig)
        self.start = plan.start.with_own_arrays()
        is_inside = job.request.ecu != ON_A_BUS
        if is_inside and (actions := plan.setup.scenario.precondition):  # that of an ECU on a bus is on the wire
            guard = partial(foreign_code, memory)
            self.start = after_precondition(self.start, self.adapter, actions, self.stopped, guard)
        stimuli = self.start.stimuli
        if is_inside:
            wire = open_transport(self.way)
            stack.callback(wire.close)
            requests, guard = (stimuli.requests, stimuli.moments), partial(foreign_code, memory)
            before_ns = int(stimuli.origin[0]) * round(NS / plan.request.rate)
            self.peers = [Peer(self.adapter, wire, requests, guard, before_ns)]
        if self.is_real and any(each.kind == "bus_off" for each in plan.setup.scenario.faults):
            stimuli.not_made[OFF_A_REAL_BUS] = 1
        waits = plan.request.clock != "realtime"
        if not self.peers:
            self.phases = list(phases_of(plan.setup, rig, self.start.config.step))
            self.restarts = restarts_of(rig, stimuli, self.listener.say, waits, self.stopped)
        if self.restarts is not None:
            stack.callback(self.restarts.stop)
        self.observers = observers_of(
            plan, stimuli, self.is_real, self.listener, self.peers, self.restarts, server
        )
        if server is not None:
            server.acting = Acting(plan.setup.vehicle, self.start.config, stimuli, self.start.state.reception)
        self.log = CommandLog() if self.judge is not None and not waits else None
        self.sinks = [*self.sinks, *([self.log] if self.log else []), *([ProgressSink(memory)] if memory else [])]
        self.is_prepared = True

    def opened(self, open_wire: Callable[[Way], Wire], stack: contextlib.ExitStack) -> Wire:
        """Open the wire by `open_wire(way)`; leaving the `stack` closes it. Raises TransportError.

        For a UDP multicast bus the listener is told whether it reaches the network or this machine only.
        """
        wire = open_wire(self.way)
        stack.callback(wire.close)
        if self.way.reach:
            self.listener.say(f"{wire.name} {self.way.reach}")
        return wire

    def channel(self, wire: Line | Transport) -> str:
        """Return the name of the bus in recordings."""
        return wire.name if self.plan.way else PRIVATE_BUS

    def let_in(
        self, channel: str, memory: Memory, own_mark: Mark, stack: contextlib.ExitStack
    ) -> FurtherRecording:
        """Let clients attach to the loop's memory, if permitted; return the recording that they may start.

        `own_mark` writes a mark to the run's own recordings; the stack completes the recording.
        """
        plan, way = self.plan, self.way
        further = FurtherRecording(plan, channel, way.interface, memory, self.listener, own_mark)
        stack.callback(further.close)
        about = Description(plan.setup, plan.rig, plan.request, channel, way.bitrate(plan.rig), bool(self.peers))
        self.observers.let_in(about, memory, further)
        return further

    def monitor(self) -> ProgressMonitor:
        """Return the monitor that reports the run's progress; to be called once time 0 is known."""
        from liftgate_hil.loop.progress_monitor import ProgressMonitor

        return ProgressMonitor(
            self.plan.rig,
            self.start.config,
            self.start.state.reception,
            self.listener,
            self.adapter.events,
            ticks_before=int(self.start.stimuli.origin[0]),
            apart=self.way.apart,
            within="" if self.peers else self.way.within,
            why_full=self.way.why_full,
        )

    def run_phases(self, begun: Callable[[Phase, bool], Going]) -> bool:
        """Run the phases of the precondition, which end at time 0; return whether there were any.

        All are ready before the first one runs, so that the bus is silent for no longer than it takes to go on.
        `begun(phase, is_first)` prepares one and returns the function that runs it. Raises PreconditionError.
        """
        restbus = None
        stimuli, state = self.start.stimuli, self.start.state
        going = [(phase, begun(phase, place == 0)) for place, phase in enumerate(self.phases)]
        for phase, go in going:
            self.listener.say(f"before the scenario: {phase.end.what}")
            phase.stimuli.origin[0] = state.tick
            if restbus is not None:
                hand_over(restbus, phase.stimuli.restbus)
            restbus = phase.stimuli.restbus
            with contextlib.closing(phase.end):
                state = go(state, lambda end=phase.end: self.stopped() or end.is_over())  # type: ignore[misc]
        if restbus is not None:
            hand_over(restbus, stimuli.restbus)
            stimuli.origin[0] = state.tick
        self.start = self.start._replace(state=state)
        self.begun = self.start.with_own_arrays()
        return bool(going)

    def not_made(self, has_failed: bool) -> str:
        """Return, after the run, which of the scenario's stimuli could not be applied; "": all were."""
        if not self.is_prepared:
            return ""
        found = [reset_not_made(self.start.stimuli, self.plan.rig)]
        if self.is_real:
            found.append(off_not_made(self.plan.setup.scenario, self.observers.injected))
        if self.restarts is not None and not has_failed:
            found.append(self.restarts.not_made())
        return "; ".join(filter(None, found))

    def steps_again(self, summary: Summary) -> StepsAgain | None:
        """Return the function that simulates a real-time run again; None: impossible, as after injected faults."""
        frames = None if self.log is None else self.log.frames()
        if self.judge is None or self.log is None or self.begun is None or frames is None:
            return None
        if summary.injections or summary.commands:
            return None  # they act between two ticks, nobody knows between which
        plan = self.plan
        return StepsAgain(
            begun=self.begun,
            frames=relevant_frames(plan.rig, frames, self.judge.expected, self.begun.stimuli),
            ticks=summary.ticks - 1,
            rig=plan.rig,
            drives=plan.setup.vehicle.drives,
            expected=self.judge.expected,
            rate=plan.request.rate,
            end=self.judge.end,
            angles=self.log.angles(),
            stopped=self.stopped,
        )

    def tell_end(self, end: RunEnd) -> None:
        """Tell attached clients, if any, how the run has ended."""
        server = self.observers.server
        if server is None:
            return
        is_stopped = self.stopped() and end.verdict != ERROR
        code = self.plan.job.exit_codes.get(STOPPED if is_stopped else end.ending)
        # Expectations that are decided all the same stand.
        if is_stopped and (end.verdict == INCONCLUSIVE or not end.expectations):
            end = end._replace(ending=STOPPED)
        server.ends(end._replace(exit_code=code))


def _server_of(job: Job, verdicts: Callable[[], Sequence[Verdict]]) -> Server:
    """Return the server for a run's clients, in front of the job's listener; redirect a Relay there to it."""
    relay = job.listener
    assert job.attachable_as is not None
    server = Server(relay.listener if isinstance(relay, Relay) else relay, job.attachable_as, verdicts)
    if isinstance(relay, Relay):
        relay.listener = server
    return server
