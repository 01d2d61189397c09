"""The composition root: objects from files and values, and a run of the emulator on a bus.

No flags, no printing, no signal handlers: the command line, pytest and the rest of the API are users of this file.
"""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.config.arguments import number_of, seed_of, texts_of, time_of
from liftgate_hil.config.rig import Rig, load_rig
from liftgate_hil.config.scenario import Scenario, load_scenario, no_scenario
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.toml import show
from liftgate_hil.config.vehicle import load_vehicle
from liftgate_hil.errors import ConfigError, RecordingError
from liftgate_hil.loop.tick import LoopConfig, LoopState, initial_loop, no_frames
from liftgate_plant.dynamics import initial_state
from liftgate_plant.vehicle import Vehicle, load_of, plant_of

if TYPE_CHECKING:
    from liftgate_hil.loop.python_loop import Peer, Watch
    from liftgate_hil.loop.statistics import Summary
    from liftgate_hil.transport.find import Way

NS = 1_000_000_000
CLOCKS = ("realtime", "free", "lockstep")
RATES = (200.0, 10_000.0)  # Hz


def vehicle_from(name: str | Path, settings: Sequence[str] = ()) -> Vehicle:
    """The vehicle of a shipped name or a path, with KEY=VALUE settings put over it. Raises ConfigError."""
    return load_vehicle(find_config("vehicles", str(name)), settings)


def rig_from(name: str | Path) -> Rig:
    """The rig of a shipped name or a path. Raises ConfigError."""
    return load_rig(find_config("rigs", str(name)))


def scenario_from(
    name: str | Path | None, parameters: Mapping[str, float] | None = None
) -> Scenario:
    """The scenario of a shipped name or a path with its parameters replaced, or none. Raises ConfigError."""
    if name is None:
        return no_scenario()
    return load_scenario(find_config("scenarios", str(name)), parameters or {})


def vehicle_of(vehicle: str | Path | Vehicle, settings: Sequence[str] = ()) -> Vehicle:
    """The vehicle of a name or a path, with settings put over it, or one that there is. Raises ConfigError."""
    settings = texts_of("settings", settings)
    if isinstance(vehicle, str | Path):
        return vehicle_from(str(vehicle), settings)
    if not isinstance(vehicle, Vehicle):
        raise ConfigError(f"`vehicle` {show(vehicle)}: allowed: a shipped name, a file, a Vehicle")
    if settings:
        raise ConfigError(
            f"`settings` {', '.join(settings)}: allowed with a vehicle by its name or file"
        )
    return vehicle


def rig_of(rig: str | Path | Rig) -> Rig:
    """The rig of a name or a path, or one that there is. Raises ConfigError."""
    if isinstance(rig, str | Path):
        return rig_from(str(rig))
    if not isinstance(rig, Rig):
        raise ConfigError(f"`rig` {show(rig)}: allowed: a shipped name, a file, a Rig")
    return rig


def scenario_of(
    scenario: str | Path | Scenario | None, parameters: Mapping[str, float] | None = None
) -> Scenario:
    """The scenario of a name or a path, with its parameters replaced, or one that there is. Raises ConfigError."""
    if isinstance(scenario, str | Path):
        return scenario_from(str(scenario), parameters)
    if scenario is not None and not isinstance(scenario, Scenario):
        raise ConfigError(
            f"`scenario` {show(scenario)}: allowed: a shipped name, a file, a Scenario, or None"
        )
    if parameters:
        raise ConfigError(
            f"`parameters` {', '.join(parameters)}: allowed with a scenario by its name or file"
        )
    return no_scenario() if scenario is None else scenario


def angle_from(initial: float | str, open_angle: float, others: str = "") -> float:
    """The angle [rad] of "closed", "open" (`open_angle`, rad) or degrees; `others` are allowed besides.

    Raises ConfigError.
    """
    named = {"closed": 0.0, "open": open_angle}
    if isinstance(initial, str) and initial in named:
        return named[initial]
    try:
        degrees = math.nan if isinstance(initial, bool) else float(initial)
    except (TypeError, ValueError):
        degrees = math.nan
    top = math.degrees(open_angle)
    if not 0.0 <= degrees <= top:
        raise ConfigError(
            f"`initial` {initial}: allowed: {others}closed, open, or 0 to {top:g} degrees"
        )
    return math.radians(degrees)


def loop_config_of(vehicle: Vehicle, rig: Rig, rate: float, seed: int) -> LoopConfig:
    """The loop's constants, at a rate [Hz]."""
    mapped = {mapping.quantity for mapping in rig.inputs}
    return LoopConfig(
        plant=plant_of(vehicle),
        sensors=vehicle.sensors,
        load=load_of(vehicle),
        inputs=rig.input_config(),
        outputs=rig.output_config(),
        signed_left=int("left_direction" not in mapped),
        signed_right=int("right_direction" not in mapped),
        latch_mapped=int("latch_release" in mapped),
        obstacle_distance=vehicle.gate.length,
        step=1.0 / rate,
        step_ns=round(NS / rate),
        seed=seed,
        nothing=no_frames(),
    )


def start_of(config: LoopConfig, angle: float = 0.0) -> LoopState:
    """A loop whose gate rests at an angle [rad]; closed it is latched."""
    return initial_loop(config, initial_state(config.plant, angle, latched=float(angle == 0.0)))


def ticks_of(duration: float | None, rate: float) -> int | None:
    """How many ticks a duration [s] is, at least one; None: until stopped."""
    return None if duration is None else max(1, math.ceil(duration * rate - 1e-9))


@dataclass(frozen=True)
class RunOptions:
    """How a run goes, whatever runs."""

    rate: float = 1000.0  # Hz
    clock: str = "realtime"  # of CLOCKS
    duration: float | None = None  # s of model time; None: the scenario's, else until stopped
    seed: int = 0
    overrun_limit: float = 1.0  # s that the loop may fall behind
    wall_timeout: float | None = None  # s that lockstep waits for a command; None: for ever
    records: tuple[Path, ...] = ()
    realtime: bool = False  # ask for FIFO scheduling, locked memory, a CPU
    cpu: int | None = None  # which

    def check(self) -> None:
        """Raises ConfigError where one cannot be, or they cannot be had together."""
        number_of("rate", self.rate, *RATES, "Hz")
        seed_of(self.seed)
        for name in ("duration", "wall_timeout", "overrun_limit"):
            if (value := getattr(self, name)) is not None:
                time_of(name, value)
        if len({path.resolve() for path in self.records}) < len(self.records):
            names = ", ".join(str(path) for path in self.records)
            raise ConfigError(f"`record` {names}: allowed: a file once")
        if self.cpu is None:
            return
        if not self.realtime:
            raise ConfigError(f"`cpu` {self.cpu}: allowed: together with `realtime`")
        if hasattr(os, "sched_getaffinity") and self.cpu not in os.sched_getaffinity(0):
            from liftgate_hil.loop.priority import allowed_cpus

            raise ConfigError(f"`cpu` {self.cpu}: allowed here: {allowed_cpus()}")


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

    vehicle: Vehicle
    rig: Rig
    scenario: Scenario
    way: Way
    options: RunOptions = field(default_factory=RunOptions)
    start_angle: float = 0.0  # rad
    peers: Sequence[Peer] = ()
    watch: Watch | None = None
    say: Callable[[str], None] = _nothing
    stopped: Callable[[], bool] = _never
    announce: Callable[[Callable[..., Any], str], None] | None = None  # entry point, wire's name

    def run(self) -> Summary:
        """Raises ConfigError, TransportError, OverrunError, PlantDivergedError, RecordingError."""
        from liftgate_hil.loop.datagrams import POSSIBLE

        self.options.check()
        options = self.options
        self.config = loop_config_of(self.vehicle, self.rig, options.rate, options.seed)
        self.state = start_of(self.config, self.start_angle)
        duration = self.scenario.duration if options.duration is None else options.duration
        self.ticks = ticks_of(duration, options.rate)
        if options.clock == "realtime" and POSSIBLE:
            return self._in_real_time()
        return self._in_python()

    def _announce(self, entry: Callable[..., Any], name: str) -> None:
        if self.announce is not None:
            self.announce(entry, name)

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
                recorder = RecorderProcess(options.records, memory, self.vehicle.drives, line.name)
                stack.callback(recorder.close)
            loop = RealtimeRun(
                config=self.config,
                state=self.state,
                timeline=self.scenario.timeline,
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
                recorder = open_recorder(path, self.vehicle.drives, transport.name, epoch)
                stack.callback(recorder.close)
                recorders.append(recorder)
            loop = Loop(
                config=self.config,
                state=self.state,
                timeline=self.scenario.timeline,
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
