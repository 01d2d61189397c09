"""The gate on a bus: reads the ECU's duty and direction, runs the physical model, answers with motor current,
Hall counts and gate angle, until stopped or for --duration.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from liftgate_hil.cli import options
from liftgate_hil.errors import ConfigError, RecordingError

if TYPE_CHECKING:
    from pathlib import Path

    from liftgate_hil.config.rig import Rig
    from liftgate_hil.config.scenario import Scenario
    from liftgate_hil.loop.python_loop import Peer
    from liftgate_hil.loop.statistics import Summary
    from liftgate_hil.loop.tick import LoopConfig, LoopState
    from liftgate_hil.snapshot import Snapshot
    from liftgate_plant.vehicle import Vehicle


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags."""
    options.add_bus(parser)
    options.add_vehicle(parser)
    options.add_loop(parser)
    options.add_output(parser)


def run(args: argparse.Namespace) -> int:
    """The command."""
    from liftgate_hil import session

    vehicle = session.vehicle_from(args.vehicle, args.settings)
    rig = session.rig_from(args.rig)
    scenario = session.scenario_from(args.scenario)
    summary = emulate(args, vehicle, rig, scenario, say=speaker(args))
    report(args, summary)
    return 0


def emulate(
    args: argparse.Namespace,
    vehicle: Vehicle,
    rig: Rig,
    scenario: Scenario,
    peers: Sequence[Peer] = (),
    watch: Callable[[Snapshot], None] | None = None,
    say: Callable[[str], None] = print,
) -> Summary:
    """Run the emulator until it is over; closes everything it opened."""
    from liftgate_hil import session
    from liftgate_hil.loop.datagrams import POSSIBLE
    from liftgate_hil.loop.tick import initial_loop
    from liftgate_hil.recording.open import check_record
    from liftgate_plant.dynamics import initial_state

    _check_cpu(args)
    stop = options.StopSignals()
    records = [check_record(name) for name in args.record]
    if len({path.resolve() for path in records}) < len(records):
        raise ConfigError(f"--record {', '.join(args.record)}: allowed: a file once")
    bench = session.bench_of(vehicle, rig, scenario.timeline, args.rate, args.seed)
    state = initial_loop(bench, initial_state(bench.plant, 0.0, latched=True))
    duration = args.duration if args.duration is not None else scenario.duration
    ticks = None if duration is None else max(1, math.ceil(duration * args.rate - 1e-9))
    emulation = Emulation(args, bench, state, rig, vehicle.drives, records, ticks, stop, say)
    if args.clock == "realtime" and POSSIBLE:
        return emulation.hard(peers, watch)
    return emulation.portable(peers, watch)


def _check_cpu(args: argparse.Namespace) -> None:
    """Raises ConfigError where --cpu cannot be had."""
    if args.cpu is None:
        return
    if not args.realtime:
        raise ConfigError(f"--cpu {args.cpu}: allowed: together with --realtime")
    if hasattr(os, "sched_getaffinity") and args.cpu not in os.sched_getaffinity(0):
        from liftgate_hil.loop.priority import allowed_cpus

        raise ConfigError(f"--cpu {args.cpu}: allowed here: {allowed_cpus()}")


class Emulation(NamedTuple):
    """What both kinds of loop need."""

    args: argparse.Namespace
    bench: LoopConfig
    state: LoopState
    rig: Rig
    drives: int
    records: Sequence[Path]
    ticks: int | None
    stop: Callable[[], bool]
    say: Callable[[str], None]

    def hard(self, peers: Sequence[Peer], watch: Callable[[Snapshot], None] | None) -> Summary:
        """In real time, without the interpreter lock."""
        from liftgate_hil.loop.priority import Realtime
        from liftgate_hil.loop.realtime_loop import run_hard
        from liftgate_hil.loop.realtime_run import RealtimeRun, memory_for
        from liftgate_hil.recording.process import RecorderProcess
        from liftgate_hil.transport.find import find_way, open_line

        args = self.args
        with contextlib.ExitStack() as stack:
            way = find_way(args, self.rig)
            line = open_line(way)
            stack.callback(line.close)
            memory = memory_for(args.rate)
            stack.callback(memory.close)
            recorder = None
            if self.records:
                recorder = RecorderProcess(self.records, memory, self.drives, line.name)
                stack.callback(recorder.close)
            loop = RealtimeRun(
                self.bench,
                self.state,
                line,
                memory,
                self.rig,
                way.bitrate(self.rig),
                round(args.overrun_limit * 1e9),
                self.say,
                peers,
                watch,
                realtime=Realtime(args.cpu) if args.realtime else None,
            )
            self._announce(run_hard, line.name)
            loop.begin()
            if recorder is not None:
                recorder.wait_until_ready()
            loop.run(self.ticks, self.stop)
            # The counts of the line and the recorder are whole only when they are closed.
            stack.close()
            return loop.summary(recorder.lost_rows if recorder is not None else 0)

    def portable(self, peers: Sequence[Peer], watch: Callable[[Snapshot], None] | None) -> Summary:
        """On a clock that waits for nobody, or where the real-time loop cannot be."""
        from liftgate_hil.loop.clock import RealtimeClock
        from liftgate_hil.loop.histogram import distribution
        from liftgate_hil.loop.python_loop import Loop, run_clocked, run_free, run_lockstep
        from liftgate_hil.loop.statistics import Timing
        from liftgate_hil.loop.tick import tick
        from liftgate_hil.recording.open import open_recorder
        from liftgate_hil.transport.find import find_way, open_transport

        args, rig = self.args, self.rig
        with contextlib.ExitStack() as stack:
            way = find_way(args, rig)
            transport = open_transport(way)
            stack.callback(transport.close)
            # Only wall time has an epoch; the other clocks' recordings are the same every time.
            epoch = time.time() if args.clock == "realtime" else 0.0
            recorders = []
            for path in self.records:
                recorder = open_recorder(path, self.drives, transport.name, epoch)
                stack.callback(recorder.close)
                recorders.append(recorder)
            loop = Loop(
                self.bench, self.state, transport, recorders, peers, watch, way.bitrate(rig)
            )
            self._announce(tick, transport.name)
            loop.begin()
            timing = Timing()
            try:
                if args.clock == "realtime":
                    clock = RealtimeClock(self.bench.step_ns, round(args.overrun_limit * 1e9))
                    run_clocked(loop, clock, self.ticks, self.stop)
                    timing = Timing(distribution(clock.lateness))
                elif args.clock == "free":
                    run_free(loop, self.ticks, self.stop)
                else:
                    period = max(1, round(rig.command_cycle_ms() * 1e-3 * args.rate))
                    run_lockstep(loop, rig.command_identifier(), period, self.ticks, self.stop)
            finally:
                loop.finish()
        failures = [recorder.failure for recorder in recorders if recorder.failure]
        if failures:
            raise RecordingError("; ".join(failures))
        return loop.summary(args.clock, timing)

    def _announce(self, entry: Callable[..., object], name: str) -> None:
        from liftgate_plant import compiler

        args = self.args
        if args.json:  # only what goes wrong is told beside it
            return
        if not compiler.is_cached(entry):
            self.say("compiling the model (once for this version and machine) …")
        self.say(f"{args.vehicle} on {name}, {args.rate:g} Hz, clock {args.clock}")


def report(args: argparse.Namespace, summary: Summary) -> None:
    """Say how it went."""
    if args.json:
        print(json.dumps(summary.as_dict()))
    elif not args.quiet:
        print("\n".join(summary.lines()))


def speaker(args: argparse.Namespace) -> Callable[[str], None]:
    """Where progress, and what happens to the link, is told: stderr, unless silenced."""

    def say(text: str) -> None:
        if not args.quiet:
            print(text, file=sys.stderr, flush=True)

    return say
