"""The gate on a bus: opens the wire, runs in real time or on a clock that waits for nobody, records."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from liftgate_hil.attachment.description import Description
from liftgate_hil.attendance import Attendance
from liftgate_hil.config.rig import Rig
from liftgate_hil.listener import Listener
from liftgate_hil.loop.begun import Begun
from liftgate_hil.loop.statistics import Summary, Timing
from liftgate_hil.origin import ON_THE_BUS, origin_of
from liftgate_hil.recording.content import Content
from liftgate_hil.session import NS, RunOptions, Setup, loop_config_of, ticks_of
from liftgate_hil.signals import columns_of
from liftgate_hil.staging import trigger_in
from liftgate_hil.stimuli import mailbox
from liftgate_hil.stimuli.restbus import going_on
from liftgate_hil.stimuli.scene import Scene

if TYPE_CHECKING:
    from liftgate_hil.ecu.events import Event
    from liftgate_hil.loop.clock import RealtimeClock
    from liftgate_hil.loop.lookout import Lookout
    from liftgate_hil.loop.python_loop import Loop, Peer
    from liftgate_hil.loop.recorder import Taker
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.tick import LoopState
    from liftgate_hil.preparation import Phase
    from liftgate_hil.transport.base import Line, Transport
    from liftgate_hil.transport.find import Way

    Wire = TypeVar("Wire", Line, Transport)
    # Goes on from a state until it is stopped: the state then.
    Going = Callable[[LoopState, Callable[[], bool]], LoopState]


def _never() -> bool:
    return False


def _no_events(told: int) -> Sequence[Event]:
    return ()


@dataclass
class Emulator:
    """The gate on a bus, about to run; `run` opens the wire, runs to the end and closes all that it opened.

    `stopped` is asked whether to end; `summary` is that of the last run, also of one that failed.
    """

    setup: Setup
    rig: Rig
    way: Way
    scene: Scene
    start: LoopState  # where the scene begins
    options: RunOptions = field(default_factory=RunOptions)
    phases: Iterable[Phase] = ()  # that go before the scene, on the wire
    peers: Sequence[Peer] = ()
    takers: Sequence[Taker] = ()
    ecu: Mapping[str, Any] = field(default_factory=ON_THE_BUS.copy)  # see ecu.identity
    channel: str = ""  # what recordings call the wire, where not by its own name
    listener: Listener = field(default_factory=Listener)
    events: Callable[[int], Sequence[Event]] = _no_events  # of the ECU in this process, see Lookout
    stopped: Callable[[], bool] = _never
    attendance: Attendance = field(default_factory=Attendance)
    begun: Begun | None = None  # where the scene began, once it has
    _before_start: int = 0  # frames that came before the first phase of a loop in Python was ready

    def run(self) -> None:
        """Raises ConfigError, TransportError, OverrunError, PlantDivergedError, RecordingError."""
        from liftgate_hil.loop.datagrams import POSSIBLE

        self.options.check()
        options, setup = self.options, self.setup
        self.config = loop_config_of(setup.vehicle, self.rig, options.rate, setup.seed)
        self.state = self.start
        duration = setup.scenario.duration if options.duration is None else options.duration
        self.ticks = ticks_of(duration, options.rate)
        self.summary = Summary(clock=options.clock)
        try:
            if options.clock == "realtime" and POSSIBLE:
                self._in_real_time()
            else:
                self._in_python()
        finally:
            self.attendance.note(self.summary)

    def _opened(self, open_wire: Callable[[Way], Wire], stack: contextlib.ExitStack) -> Wire:
        """The wire, closed with the stack; tells how far it reaches."""
        wire = open_wire(self.way)
        stack.callback(wire.close)
        if self.way.reach:
            self.listener.say(f"{wire.name} {self.way.reach}")
        return wire

    def _in_real_time(self) -> None:
        """Without the interpreter lock."""
        from liftgate_hil.loop.priority import Realtime
        from liftgate_hil.loop.realtime_run import RealtimeRun, memory_for
        from liftgate_hil.recording.process import RecorderProcess
        from liftgate_hil.transport.find import open_line

        options = self.options
        loop = recorder = None
        try:
            with contextlib.ExitStack() as stack:
                line = self._opened(open_line, stack)
                name = self.channel or line.name

                realtime = Realtime(options.cpu) if options.realtime else None

                def made(scene: Scene, memory: Memory) -> RealtimeRun:
                    stack.callback(memory.close)
                    return RealtimeRun(
                        config=self.config,
                        state=self.state,
                        scene=scene,
                        line=line,
                        memory=memory,
                        rig=self.rig,
                        bitrate=self.way.bitrate(self.rig),
                        limit_ns=round(options.overrun_limit * NS),
                        say=self.listener.say,
                        realtime=realtime,
                    )

                def begun(phase: Phase, is_first: bool) -> Going:
                    before = made(phase.scene, memory_for(options.rate))
                    before.takers, before.is_last = [phase.end], False
                    before.is_first = is_first
                    before.begin()

                    def go(state: LoopState, stopped: Callable[[], bool]) -> LoopState:
                        before.state = state
                        before.run(None, stopped)
                        return before.state

                    return go

                loop = made(self.scene, memory_for(options.rate))
                loop.peers, loop.takers = self.peers, self.takers
                loop.attendants = self.attendance.attendants()
                post = functools.partial(mailbox.post_all, loop.memory.shared.box[0])
                self.attendance.let_in(self._description(name), loop.memory, post, stack)
                if options.records:
                    content, limit = self._content(name), options.limit()
                    recorder = RecorderProcess(
                        options.records,
                        content,
                        limit,
                        loop.memory,
                        self.listener.say,
                        trigger_in(self.setup, self.rig, options),
                    )
                    stack.callback(recorder.close)
                self.listener.starts(f"{self.setup.vehicle_name} on {name}")
                loop.begin()
                if recorder is not None:
                    recorder.wait_until_ready()
                has_run = self._prepare(begun)
                loop.state, loop.lookout = self.state, self._lookout()
                loop.is_first = not has_run
                self.begun = Begun.at(self.config, self.state, self.scene)
                loop.run(self.ticks, self.stopped)
        finally:
            # The counts of the line and the recorder are whole only when they are closed.
            if loop is not None:
                self.summary = loop.summary()
                self.summary.apart = self.way.apart
            if recorder is not None:
                self.summary.recording_lost_rows = recorder.lost_rows
                self.summary.recordings = recorder.files
                self.summary.recording_windows = recorder.windows

    def _in_python(self) -> None:
        """On a clock that waits for nobody, or where the real-time loop cannot be."""
        from liftgate_hil.loop.clock import RealtimeClock
        from liftgate_hil.loop.histogram import distribution
        from liftgate_hil.loop.python_loop import Loop
        from liftgate_hil.loop.recorder import RecordingTaker
        from liftgate_hil.recording.guarded import raise_failures
        from liftgate_hil.recording.open import open_recorders
        from liftgate_hil.recording.trigger import Triggered
        from liftgate_hil.transport.find import open_transport

        options, rig = self.options, self.rig
        with contextlib.ExitStack() as stack:
            transport = self._opened(open_transport, stack)
            # Only wall time has an epoch; the other clocks' recordings are the same every time.
            epoch_ns = time.time_ns() if options.clock == "realtime" else 0
            name = self.channel or transport.name
            recorders = open_recorders(
                options.records, self._content(name), options.limit(), self.listener.say, stack
            )
            trigger = trigger_in(self.setup, rig, options)
            triggered = None if trigger is None else Triggered(trigger)
            recording = RecordingTaker(recorders, epoch_ns, triggered)

            def pace() -> RealtimeClock:
                return RealtimeClock(self.config.step_ns, round(options.overrun_limit * NS))

            def begun(phase: Phase, is_first: bool) -> Going:
                before = Loop(
                    self.config,
                    self.state,
                    phase.scene,
                    transport,
                    takers=[phase.end],
                    command=rig.command_identifier(),
                )
                before.begin(is_first)
                self._before_start += before.before_start

                def go(state: LoopState, stopped: Callable[[], bool]) -> LoopState:
                    before.state = state
                    self._clocked(before, pace(), None, stopped)
                    return before.state

                return go

            takers = [*self.takers, *([recording] if recorders else []), *self._shown(name, stack)]
            has_run = self._prepare(begun)
            loop = Loop(
                config=self.config,
                state=self.state,
                scene=self.scene,
                transport=transport,
                peers=self.peers,
                takers=takers,
                lookout=self._lookout(),
                attendants=self.attendance.attendants(),
                bitrate=self.way.bitrate(rig),
                command=rig.command_identifier(),
                before_start=self._before_start,
            )
            self.listener.starts(f"{self.setup.vehicle_name} on {name}")
            loop.begin(is_first=not has_run)
            clock = pace()
            self.begun = Begun.at(self.config, self.state, self.scene)
            try:
                self._clocked(loop, clock, self.ticks, self.stopped)
            finally:
                try:
                    loop.finish()
                finally:  # a plant that has diverged does so again
                    recording.flush()
                    timing = Timing(distribution(clock.lateness))
                    self.summary = loop.summary(options.clock, timing)
                    self.summary.apart = self.way.apart
                    if triggered is not None:
                        self.summary.recording_windows = triggered.count
        self.summary.recordings = [file for each in recorders for file in each.files]
        raise_failures(recorders)

    def _shown(self, channel: str, stack: contextlib.ExitStack) -> list[Taker]:
        """Who shows those who are attached what a loop in Python does."""
        from liftgate_hil.loop.realtime_run import memory_for
        from liftgate_hil.loop.rings import RingTaker

        host = self.attendance.host
        if host is None:
            return []
        memory = memory_for(self.options.rate)
        stack.callback(memory.close)
        self.attendance.let_in(self._description(channel), memory, self._hold, stack)
        return [RingTaker(memory, host.is_attended)]

    def _hold(self, values: Mapping[str, float]) -> bool:
        """What acts from the next tick on, of a loop in this thread."""
        mailbox.hold(self.scene.held, values)
        return True

    def _description(self, channel: str) -> Description:
        """What those who attach are told."""
        bitrate, is_here = self.way.bitrate(self.rig), bool(self.peers)
        return Description(self.setup, self.rig, self.options, channel, bitrate, is_here)

    def _content(self, channel: str) -> Content:
        """What recordings hold."""
        about = origin_of(self.setup, self.rig, self.options, self.ecu, self.way.interface)
        return Content(columns_of(self.setup.vehicle.drives), channel, about=about)

    def _lookout(self) -> Lookout:
        from liftgate_hil.loop.lookout import Lookout

        before = int(self.scene.origin[0])
        return Lookout(
            self.rig,
            self.config,
            self.state.reception,
            self.listener,
            self.events,
            ticks_before=before,
            apart=self.way.apart,
        )

    def _prepare(self, begun: Callable[[Phase, bool], Going]) -> bool:
        """Run the phases before the scene, which begins where they end; whether there were any. All are ready
        before the first one runs, so that the bus is silent for no longer than it takes to go on. `begun` makes
        one, and is told whether it is the first. Raises PreconditionError.
        """
        restbus = None
        going = [(phase, begun(phase, place == 0)) for place, phase in enumerate(self.phases)]
        for phase, go in going:
            self.listener.say(f"before the scenario: {phase.end.what}")
            phase.scene.origin[0] = self.state.tick
            if restbus is not None:
                going_on(restbus, phase.scene.restbus)
            restbus = phase.scene.restbus
            with contextlib.closing(phase.end):
                self.state = go(self.state, lambda end=phase.end: self.stopped() or end.is_over())  # type: ignore[misc]
        if restbus is not None:
            going_on(restbus, self.scene.restbus)
            self.scene.origin[0] = self.state.tick
        return bool(going)

    def _clocked(
        self,
        loop: Loop,
        clock: RealtimeClock,
        ticks: int | None,
        stopped: Callable[[], bool],
    ) -> None:
        """Run the Python loop on the clock that was asked for."""
        from liftgate_hil.loop.lockstep import Lockstep, run_lockstep
        from liftgate_hil.loop.python_loop import run_clocked, run_free

        options, rig = self.options, self.rig
        if options.clock == "realtime":
            run_clocked(loop, clock, ticks, stopped)
        elif options.clock == "free" or self.peers:
            # Peers in this process are in step by themselves, those that are silent, too.
            run_free(loop, ticks, stopped)
        else:
            lockstep = Lockstep(
                command=rig.command_identifier(),
                ticks_per_command=max(1, round(rig.command_cycle_ms() * 1e-3 * options.rate)),
                wall_timeout=options.wall_timeout,
                say=self.listener.say,
            )
            run_lockstep(loop, lockstep, ticks, stopped)
