"""The gate on a bus: opens the wire, runs in real time or on a clock that waits for nobody, records."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import RecordingError
from liftgate_hil.session import NS, RunOptions, Setup, loop_config_of, start_of, ticks_of

if TYPE_CHECKING:
    from liftgate_hil.loop.python_loop import Peer, Watch
    from liftgate_hil.loop.statistics import Summary
    from liftgate_hil.transport.find import Way


def _never() -> bool:
    return False


def _nothing(text: str) -> None:
    pass


@dataclass
class Emulator:
    """The gate on a bus, about to run; `run` opens the wire, runs to the end and closes all that it opened.

    `watch` gets each row (ROW_WIDTH,) of signals.COLUMNS, `say` what happens to the link, `stopped` is asked
    whether to end.
    """

    setup: Setup
    rig: Rig
    way: Way
    options: RunOptions = field(default_factory=RunOptions)
    peers: Sequence[Peer] = ()
    watch: Watch | None = None
    say: Callable[[str], None] = _nothing
    stopped: Callable[[], bool] = _never
    announce: Callable[[Callable[..., Any], str], None] | None = (
        None  # entry point, what runs where
    )

    def run(self) -> Summary:
        """Raises ConfigError, TransportError, OverrunError, PlantDivergedError, RecordingError."""
        from liftgate_hil.loop.datagrams import POSSIBLE

        self.options.check()
        options, setup = self.options, self.setup
        self.config = loop_config_of(setup.vehicle, self.rig, options.rate, setup.seed)
        self.state = start_of(self.config, setup.start_angle)
        duration = setup.scenario.duration if options.duration is None else options.duration
        self.ticks = ticks_of(duration, options.rate)
        if options.clock == "realtime" and POSSIBLE:
            return self._in_real_time()
        return self._in_python()

    def _announce(self, entry: Callable[..., Any], name: str) -> None:
        if self.announce is not None:
            self.announce(entry, f"{self.setup.vehicle_name} on {name}")

    def _in_real_time(self) -> Summary:
        """Without the interpreter lock."""
        from liftgate_hil.loop.priority import Realtime
        from liftgate_hil.loop.realtime_loop import run_realtime
        from liftgate_hil.loop.realtime_run import RealtimeRun, memory_for
        from liftgate_hil.recording.process import RecorderProcess
        from liftgate_hil.transport.find import open_line

        options = self.options
        with contextlib.ExitStack() as stack:
            line = open_line(self.way)
            stack.callback(line.close)
            memory = memory_for(options.rate)
            stack.callback(memory.close)
            recorder = None
            if options.records:
                recorder = RecorderProcess(
                    options.records, memory, self.setup.vehicle.drives, line.name
                )
                stack.callback(recorder.close)
            loop = RealtimeRun(
                config=self.config,
                state=self.state,
                timeline=self.setup.scenario.timeline,
                line=line,
                memory=memory,
                rig=self.rig,
                bitrate=self.way.bitrate(self.rig),
                limit_ns=round(options.overrun_limit * NS),
                say=self.say,
                peers=self.peers,
                watch=self.watch,
                realtime=Realtime(options.cpu) if options.realtime else None,
            )
            self._announce(run_realtime, line.name)
            loop.begin()
            if recorder is not None:
                recorder.wait_until_ready()
            loop.run(self.ticks, self.stopped)
            # The counts of the line and the recorder are whole only when they are closed.
            stack.close()
            return loop.summary(recorder.lost_rows if recorder is not None else 0)

    def _in_python(self) -> Summary:
        """On a clock that waits for nobody, or where the real-time loop cannot be."""
        from liftgate_hil.loop.python_loop import Loop, scheduled_tick
        from liftgate_hil.recording.open import open_recorder
        from liftgate_hil.transport.find import open_transport

        options, rig = self.options, self.rig
        with contextlib.ExitStack() as stack:
            transport = open_transport(self.way)
            stack.callback(transport.close)
            # Only wall time has an epoch; the other clocks' recordings are the same every time.
            epoch = time.time() if options.clock == "realtime" else 0.0
            recorders = []
            for path in options.records:
                recorder = open_recorder(path, self.setup.vehicle.drives, transport.name, epoch)
                stack.callback(recorder.close)
                recorders.append(recorder)
            loop = Loop(
                config=self.config,
                state=self.state,
                timeline=self.setup.scenario.timeline,
                transport=transport,
                recorders=recorders,
                peers=self.peers,
                watch=self.watch,
                bitrate=self.way.bitrate(rig),
            )
            self._announce(scheduled_tick, transport.name)
            loop.begin()
            try:
                timing = self._clocked(loop)
            finally:
                loop.finish()
        failures = [recorder.failure for recorder in recorders if recorder.failure]
        if failures:
            raise RecordingError("; ".join(failures))
        return loop.summary(options.clock, timing)

    def _clocked(self, loop: Any) -> Any:
        """Run the Python loop on the clock that was asked for; its timing."""
        from liftgate_hil.loop.clock import RealtimeClock
        from liftgate_hil.loop.histogram import distribution
        from liftgate_hil.loop.python_loop import Lockstep, run_clocked, run_free, run_lockstep
        from liftgate_hil.loop.statistics import Timing

        options, rig = self.options, self.rig
        if options.clock == "realtime":
            clock = RealtimeClock(self.config.step_ns, round(options.overrun_limit * NS))
            run_clocked(loop, clock, self.ticks, self.stopped)
            return Timing(distribution(clock.lateness))
        if options.clock == "free":
            run_free(loop, self.ticks, self.stopped)
        else:
            lockstep = Lockstep(
                command=rig.command_identifier(),
                ticks_per_command=max(1, round(rig.command_cycle_ms() * 1e-3 * options.rate)),
                wall_timeout=options.wall_timeout,
                say=self.say if not self.peers else _nothing,
            )
            run_lockstep(loop, lockstep, self.ticks, self.stopped)
        return Timing()
