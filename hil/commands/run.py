"""The gate on a bus: reads the ECU's duty and direction, runs the physical model, answers with motor current,
Hall counts and gate angle, until stopped or for --duration.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from hil.commands import options
from hil.errors import ConfigError

if TYPE_CHECKING:
    from hil.config.rig import Rig
    from hil.config.scenario import Scenario
    from hil.loop.run import Loop, Peer
    from hil.loop.statistics import Summary
    from hil.loop.tick import Snapshot
    from hil.transport.base import Transport
    from plant.vehicle import Vehicle


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags."""
    options.add_bus(parser)
    options.add_vehicle(parser)
    options.add_loop(parser)
    options.add_output(parser)


def run(args: argparse.Namespace) -> int:
    """The command."""
    from hil import build
    from hil.transport.find import open_transport

    vehicle = build.vehicle_from(args.vehicle, args.settings)
    rig = build.rig_from(args.rig)
    scenario = build.scenario_from(args.scenario)
    transport = open_transport(args, rig)
    summary = emulate(args, vehicle, rig, scenario, transport, say=speaker(args))
    report(args, summary)
    return 0


def emulate(
    args: argparse.Namespace,
    vehicle: Vehicle,
    rig: Rig,
    scenario: Scenario,
    transport: Transport,
    peers: Sequence[Peer] = (),
    watch: Callable[[Snapshot], None] | None = None,
    say: Callable[[str], None] = print,
) -> Summary:
    """Run the emulator on an open transport until it is over; closes everything it opened."""
    from hil import build
    from hil.loop.run import Loop
    from hil.loop.tick import initial_loop, tick
    from hil.recording.open import check_record, open_recorder
    from plant import compiler
    from plant.dynamics import initial_state

    stop = options.StopSignals()
    with contextlib.ExitStack() as stack:
        stack.callback(transport.close)
        records = [check_record(name) for name in args.record]
        if len({path.resolve() for path in records}) < len(records):
            raise ConfigError(f"--record {', '.join(args.record)}: allowed: a file once")
        bench = build.bench_of(vehicle, rig, scenario.program, args.rate, args.seed)
        # Only wall time has an epoch; the other clocks' recordings are the same every time.
        epoch = time.time() if args.clock == "realtime" else 0.0
        recorders = []
        for path in records:
            recorder = open_recorder(path, vehicle.drives, transport.name, epoch)
            stack.callback(recorder.close)
            recorders.append(recorder)
        state = initial_loop(bench, initial_state(bench.plant, 0.0, latched=True))
        loop = Loop(bench, state, transport, recorders, peers, watch, rig.bitrate)
        if not compiler.is_cached(tick):
            say("compiling the model (once for this version and machine) …")
        loop.begin()
        say(f"{args.vehicle} on {transport.name}, {args.rate:g} Hz, clock {args.clock}")
        summary = _run(args, loop, rig, scenario, stop)
    return summary


def _run(
    args: argparse.Namespace,
    loop: Loop,
    rig: Rig,
    scenario: Scenario,
    stop: Callable[[], bool],
) -> Summary:
    from hil.loop.clock import RealtimeClock
    from hil.loop.run import run_clocked, run_free, run_lockstep

    duration = args.duration if args.duration is not None else scenario.duration
    ticks = None if duration is None else max(1, math.ceil(duration * args.rate - 1e-9))
    lateness = None
    try:
        if args.clock == "realtime":
            clock = RealtimeClock(loop.bench.step_ns, round(args.overrun_limit * 1e9))
            lateness = clock.lateness
            run_clocked(loop, clock, ticks, stop)
        elif args.clock == "free":
            run_free(loop, ticks, stop)
        else:
            period = max(1, round(rig.command_cycle_ms() * 1e-3 * args.rate))
            identifier = rig.command_identifier()
            run_lockstep(loop, identifier, period, ticks, stop)
    finally:
        loop.finish()
    return loop.summary(args.clock, lateness)


def report(args: argparse.Namespace, summary: Summary) -> None:
    """Say how it went."""
    if args.json:
        print(json.dumps(summary.as_dict()))
    elif not args.quiet:
        print("\n".join(summary.lines()))


def speaker(args: argparse.Namespace) -> Callable[[str], None]:
    """Where progress is told: stderr, unless silenced."""
    silent = args.quiet or args.json

    def say(text: str) -> None:
        if not silent:
            print(text, file=sys.stderr, flush=True)

    return say
