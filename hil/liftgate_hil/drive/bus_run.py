"""Run on a bus, as far as it is the same on every clock: wire, observers, and the precondition on the wire."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from liftgate_hil.config.vehicle_choice import WireChoice
from liftgate_hil.drive.execution import Execution
from liftgate_hil.drive.precondition import phases_of
from liftgate_hil.drive.stepping import CommandLog
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.ecu.peer import Peer
from liftgate_hil.isolate.signs_of_life import ProgressSink, foreign_code
from liftgate_hil.judging.judge import Judge
from liftgate_hil.loop.listener import Relay
from liftgate_hil.operate.attachment.acting import Acting
from liftgate_hil.operate.attachment.description import Description
from liftgate_hil.operate.attachment.server import Server
from liftgate_hil.operate.ecu_reset import restarts_of
from liftgate_hil.operate.further_recording import FurtherRecording
from liftgate_hil.operate.observers import Observers, observers_of
from liftgate_hil.plan.job import PRIVATE_BUS
from liftgate_hil.plan.plan import Plan
from liftgate_hil.plan.request import NS
from liftgate_hil.plan.stimulation import off_not_made, reset_not_made
from liftgate_hil.stimuli.restbus import hand_over
from liftgate_hil.stimuli.stimulus_plan import OFF_A_REAL_BUS, StimulusPlan
from liftgate_hil.transport.find import find_way, open_transport

if TYPE_CHECKING:
    from liftgate_hil.drive.precondition import Phase
    from liftgate_hil.judging.verdict import Verdict
    from liftgate_hil.loop.listener import Listener
    from liftgate_hil.loop.observers import Sink
    from liftgate_hil.loop.progress_monitor import ProgressMonitor
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.tick import LoopState
    from liftgate_hil.operate.ecu_reset import Restarts
    from liftgate_hil.operate.further_recording import Mark
    from liftgate_hil.plan.job import Job
    from liftgate_hil.transport.base import Line, Transport
    from liftgate_hil.transport.find import Way

    Wire = TypeVar("Wire", Line, Transport)
    # Goes on from a state until it is stopped: the state then.
    Going = Callable[[LoopState, Callable[[], bool]], LoopState]


@dataclass
class BusRun:
    """Run on a bus that is about to begin; `prepare` moves its `state` on to the scenario's time 0."""

    execution: Execution
    way: Way
    stimuli: StimulusPlan
    state: LoopState
    phases: Sequence[Phase]  # before time 0, on the wire
    peers: Sequence[Peer]  # the ECU, where it is in this process
    sinks: Sequence[Sink]
    log: CommandLog | None  # of the ECU's commands, where the gate may have to be stepped again
    observers: Observers
    restarts: Restarts | None
    listener: Listener

    @property
    def plan(self) -> Plan:
        """The plan that is run."""
        return self.execution.plan

    @property
    def is_real(self) -> bool:
        """Whether the bus is not a virtual one: others may be on it, and a `bus_off` fault cannot be made."""
        return not self.way.is_interface("virtual")

    def opened(self, open_wire: Callable[[Way], Wire], stack: contextlib.ExitStack) -> Wire:
        """Open the wire; leaving the `stack` closes it. Raises TransportError.

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
        """Let clients attach to the loop's memory, where they may; return the recording that they may start.

        `own_mark` writes a mark to the run's own recordings; the stack completes the recording.
        """
        plan, way = self.plan, self.way
        further = FurtherRecording(plan, channel, way.interface, memory, self.listener, own_mark)
        stack.callback(further.close)
        about = Description(plan.setup, plan.rig, plan.request, channel, way.bitrate(plan.rig), bool(self.peers))
        self.observers.let_in(about, memory, further)
        return further

    def monitor(self) -> ProgressMonitor:
        """Return the monitor that reports the progress, once time 0 is known."""
        from liftgate_hil.loop.progress_monitor import ProgressMonitor

        return ProgressMonitor(
            self.plan.rig,
            self.plan.config,
            self.state.reception,
            self.listener,
            self.execution.adapter.events,
            ticks_before=int(self.stimuli.origin[0]),
            apart=self.way.apart,
            within="" if self.peers else self.way.within,
            why_full=self.way.why_full,
        )

    def prepare(self, begun: Callable[[Phase, bool], Going]) -> bool:
        """Run the phases before time 0, which is where the last one ends; return whether there were any.

        All are ready before the first one runs, so that the bus is silent for no longer than it takes to go on.
        `begun` begins one, and is told whether it is the first. Raises PreconditionError.
        """
        restbus, stopped = None, self.execution.stopped
        going = [(phase, begun(phase, place == 0)) for place, phase in enumerate(self.phases)]
        for phase, go in going:
            self.listener.say(f"before the scenario: {phase.end.what}")
            phase.stimuli.origin[0] = self.state.tick
            if restbus is not None:
                hand_over(restbus, phase.stimuli.restbus)
            restbus = phase.stimuli.restbus
            with contextlib.closing(phase.end):
                self.state = go(self.state, lambda end=phase.end: stopped() or end.is_over())  # type: ignore[misc]
        if restbus is not None:
            hand_over(restbus, self.stimuli.restbus)
            self.stimuli.origin[0] = self.state.tick
        return bool(going)

    def not_made(self, has_failed: bool) -> str:
        """Return, after the run, which of the scenario's stimuli could not be applied; "": all were."""
        found = [reset_not_made(self.stimuli, self.plan.rig)]
        if self.is_real:
            found.append(off_not_made(self.plan.setup.scenario, self.observers.injected))
        if self.restarts is not None and not has_failed:
            found.append(self.restarts.not_made())
        return "; ".join(filter(None, found))


def _server_of(job: Job, verdicts: Callable[[], Sequence[Verdict]]) -> Server:
    """Return the server of a run; it hears what others tell the job's listener, too, where that is a relay."""
    relay = job.listener
    assert job.attachable_as is not None
    server = Server(relay.listener if isinstance(relay, Relay) else relay, job.attachable_as, verdicts)
    if isinstance(relay, Relay):
        relay.listener = server
    return server


def bus_run_of(execution: Execution, stack: contextlib.ExitStack) -> BusRun:
    """Return the run of a plan on its bus or, where it has none, on a virtual bus of this process alone.

    The stack closes what is opened here. Raises ConfigError, TransportError, and what `Execution.start` raises.
    """
    plan, memory, stopped = execution.plan, execution.memory, execution.stopped
    job, request, rig = plan.job, plan.request, plan.rig
    server = None
    if job.attachable_as is not None:
        judge = next((each for each in execution.sinks if isinstance(each, Judge)), None)
        server = _server_of(job, tuple if judge is None else judge.so_far)
        stack.callback(server.close)
    listener = server or job.listener
    way = plan.way or find_way(WireChoice(bus=f"virtual:run-{id(plan):x}"), rig)
    stimuli, state = execution.start()
    peers = []
    if job.request.ecu != ON_A_BUS:
        wire = open_transport(way)
        stack.callback(wire.close)
        requests, guard = (stimuli.requests, stimuli.moments), partial(foreign_code, memory)
        before_ns = int(stimuli.origin[0]) * round(NS / request.rate)
        peers = [Peer(execution.adapter, wire, requests, guard, before_ns)]
    is_real = not way.is_interface("virtual")
    if is_real and any(each.kind == "bus_off" for each in plan.setup.scenario.faults):
        stimuli.not_made[OFF_A_REAL_BUS] = 1
    waits = request.clock != "realtime"
    restarts = None if peers else restarts_of(rig, stimuli, listener.say, waits, stopped)
    if restarts is not None:
        stack.callback(restarts.stop)
    observers = observers_of(plan, stimuli, is_real, listener, peers, restarts, server)
    if server is not None:
        server.acting = Acting(plan.setup.vehicle, plan.config, stimuli, state.reception)
    is_judged = any(isinstance(each, Judge) for each in execution.sinks)
    log = CommandLog() if is_judged and not waits else None
    return BusRun(
        execution=execution,
        way=way,
        stimuli=stimuli,
        state=state,
        phases=[] if peers else list(phases_of(plan.setup, rig, plan.config.step)),
        peers=peers,
        sinks=[*execution.sinks, *([log] if log else []), *([ProgressSink(memory)] if memory else [])],
        log=log,
        observers=observers,
        restarts=restarts,
        listener=listener,
    )
