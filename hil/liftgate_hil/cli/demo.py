"""The emulator with an ECU: the gate opens, closes onto an obstacle, is detected by motor current, reverses, then
opens and closes fully. Prints what happened, writes recordings and a picture, and judges itself.

Without a bus both run in this process: on the free clock as machine code, else on a virtual bus. On any other
bus the ECU is a second process. On a serial line it needs a port of its own, the line's other end: --ecu-serial.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from liftgate_hil.cli import options
from liftgate_hil.errors import ConfigError, LiftgateError

if TYPE_CHECKING:
    from liftgate_hil.loop.closed_loop import Extremes, Trace
    from liftgate_hil.loop.statistics import Summary
    from liftgate_hil.session import Emulator

_EVENT = re.compile(r"^ecu\s+([\d.]+) s  (.*)$")
_EVERY = 10  # rows of the picture
# The reference ECU presses 142 N on the demo's rod; a drive that stalls presses over 500 N.
_MOST_FORCE = 200.0  # N
_MOST_MISSED = 0.01  # share of ticks; more makes a machine unfit (see doctor)

Events = list[tuple[float, str]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags."""
    options.add_bus(parser)
    options.add_vehicle(parser)
    options.add_loop(parser)
    options.add_output(parser)
    options.add_ecu(parser, "reference")
    parser.add_argument(
        "--ecu-serial", metavar="PORT[@BAUD]", help="the other end of --serial, for the ECU"
    )
    parser.add_argument(
        "--output", default=".", metavar="FOLDER", help="for demo.log, demo.csv and demo.png"
    )
    parser.add_argument(
        "--no-record", action="store_true", help="write no demo.log, demo.csv and demo.png"
    )


def run(args: argparse.Namespace) -> int:
    """The command."""
    from liftgate_hil import session
    from liftgate_hil.cli.run import report
    from liftgate_hil.loop.closed_loop import Extremes, Trace
    from liftgate_hil.transport.find import find_way

    folder = _folder(args)
    has_bus = args.bus is not None or args.interface is not None or args.serial is not None
    args.scenario = args.scenario or "demo"
    extremes, trace = Extremes(), Trace(_EVERY)
    if not has_bus and args.clock == "free":
        summary, events = _as_machine_code(args, extremes, trace)
    else:
        if not has_bus:
            args.bus = "virtual:demo"
        rig = session.rig_from(args.rig)
        emulator = _emulator(args, find_way(options.wire_choice(args), rig), extremes, trace)
        summary, events = _on_a_bus(args, emulator)
    _tell(args, extremes, trace, events, folder)
    report(args, summary)
    return _judge(args, summary, extremes, trace, events)


def _folder(args: argparse.Namespace) -> Path:
    """Where it writes; adds the demo's recordings. Raises ConfigError."""
    folder = Path(args.output)
    if not folder.is_dir():
        raise ConfigError(f"output {args.output}: no such folder; allowed: one that exists")
    if (args.serial is None) != (args.ecu_serial is None):
        raise ConfigError("serial and ecu-serial: allowed: both ends of the line, or neither")
    if not args.no_record:
        args.record = [*args.record, str(folder / "demo.log"), str(folder / "demo.csv")]
    return folder


def _as_machine_code(
    args: argparse.Namespace, extremes: Extremes, trace: Trace
) -> tuple[Summary, Events]:
    """Both in this process, as fast as it goes."""
    from liftgate_hil import runs
    from liftgate_hil.cli.run import announcer
    from liftgate_hil.loop.episode import run_stretch

    announcer(args)(run_stretch, "no bus")
    job = runs.Job(
        scenario=args.scenario,
        ecu=args.ecu,
        vehicle=args.vehicle,
        rig=args.rig,
        settings=tuple(args.settings),
        options=options.run_options(args),
    )
    result = runs.run_anywhere(job, [extremes, trace], options.StopSignals())
    if result.verdict == "error":
        raise LiftgateError(result.reason)
    return result.summary, [(event.time, event.text) for event in result.events]


def _emulator(args: argparse.Namespace, way: Any, extremes: Extremes, trace: Trace) -> Emulator:
    from liftgate_hil import session
    from liftgate_hil.cli.run import announcer, speaker
    from liftgate_hil.loop.closed_loop import watcher

    return session.Emulator(
        vehicle=session.vehicle_from(args.vehicle, args.settings),
        rig=session.rig_from(args.rig),
        scenario=session.scenario_from(args.scenario),
        way=way,
        options=options.run_options(args),
        watch=watcher([extremes, trace]),
        say=speaker(args),
        stopped=options.StopSignals(),
        announce=announcer(args),
    )


def _on_a_bus(args: argparse.Namespace, emulator: Emulator) -> tuple[Summary, Events]:
    """On a virtual bus with the ECU in this process, on any other one with the ECU as a second process."""
    from liftgate_hil.ecu.find import adapter_for
    from liftgate_hil.ecu.peer import Peer
    from liftgate_hil.transport.find import open_transport

    drives = emulator.vehicle.drives
    if emulator.way.is_interface("virtual"):
        with contextlib.ExitStack() as stack:
            wire = open_transport(emulator.way)
            stack.callback(wire.close)
            adapter = stack.enter_context(adapter_for(args.ecu, emulator.rig, drives))
            emulator.peers = [Peer(adapter, wire, emulator.scenario.requests)]
            summary = emulator.run()
            return summary, [(event.time, event.text) for event in adapter.events()]
    if args.clock == "free":
        raise ConfigError("clock free: allowed without a bus, or on a virtual one")
    if args.ecu == "bus":
        return emulator.run(), []
    with _ecu_process(args, drives) as child:
        summary = emulator.run()
        child.terminate()
        return summary, _events_of(child, args.ecu)


@contextlib.contextmanager
def _ecu_process(args: argparse.Namespace, drives: int) -> Iterator[subprocess.Popen[str]]:
    """`liftgate-hil ecu` on the same bus; ended with this process."""
    command = [sys.executable, "-P", "-m", "liftgate_hil", "ecu", "--rig", args.rig]
    command += ["--scenario", args.scenario, "--drives", str(drives), "--ecu", args.ecu]
    for flag in ("bus", "interface", "channel", "bitrate"):
        value = getattr(args, flag)
        if value is not None:
            command += [f"--{flag}", str(value)]
    if args.ecu_serial is not None:
        command += ["--serial", args.ecu_serial]
    command += [flag for flag in ("--fd", "--realtime") if getattr(args, flag.strip("-"))]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        yield child
    finally:
        child.kill()
        child.wait()


def _events_of(child: subprocess.Popen[str], ecu: str) -> Events:
    stream: IO[str] | None = child.stderr
    assert stream is not None
    lines = stream.read().splitlines()
    matches = [match for line in lines if (match := _EVENT.match(line))]
    if not matches and ecu == "reference":
        detail = " ".join(lines)[:300] or "it said nothing"
        raise LiftgateError(f"the ECU's process did not take part: {detail}")
    return [(float(match[1]), match[2]) for match in matches]


def _tell(
    args: argparse.Namespace,
    extremes: Extremes,
    trace: Trace,
    events: Sequence[tuple[float, str]],
    folder: Path,
) -> None:
    """Print what happened, and draw it."""
    import numpy as np

    from liftgate_hil.report.run_plot import plot_run

    columns = trace.columns()
    if len(columns["time_s"]) < 2:
        return  # stopped before it began
    if not args.no_record:
        reversals = [(time, "reversal") for time, text in events if "reversing" in text]
        plot_run(folder / "demo.png", columns, reversals, f"liftgate-hil demo: {args.vehicle}")
    if args.quiet or args.json:
        return
    for time, text in events:
        angle = float(np.interp(time, columns["time_s"], columns["gate_angle_deg"]))
        print(f"{time:7.3f} s  {angle:6.2f} deg  {text}")
    if extremes.maximum("pinch_force_n") > 0.0:
        print(
            f"pinch force at most {extremes.maximum('pinch_force_n'):.1f} N, at "
            f"{extremes.pinch_time:.3f} s"
        )
    if not args.no_record:
        names = ", ".join(str(folder / f"demo.{kind}") for kind in ("log", "csv", "png"))
        print(f"written: {names}")


def _judge(
    args: argparse.Namespace,
    summary: Summary,
    extremes: Extremes,
    trace: Trace,
    events: Sequence[tuple[float, str]],
) -> int:
    """The exit code: 1 where the whole demo did not show what it is there to show. One that was stopped, or with
    another scenario, is not judged.
    """
    from liftgate_hil.session import scenario_from

    if args.scenario != "demo" or args.duration is not None:
        return 0
    if summary.model_time_s < (scenario_from("demo").duration or 0.0):
        return 0
    reasons = failures(summary, extremes, trace, events, tells=args.ecu == "reference")
    for reason in reasons:
        print(f"liftgate-hil demo: failed: {reason}", file=sys.stderr)
    return 1 if reasons else 0


def failures(
    summary: Summary,
    extremes: Extremes,
    trace: Trace,
    events: Sequence[tuple[float, str]],
    tells: bool,
) -> list[str]:
    """What a whole demo did not do as it should; an ECU of ours `tells` that it reverses."""
    import numpy as np

    found = []
    columns = trace.columns()
    force = extremes.maximum("pinch_force_n")
    if not force > 0.0:
        found.append("the gate never met the obstacle")
    if force > _MOST_FORCE:
        found.append(f"pinch force {force:.1f} N; allowed: up to {_MOST_FORCE:.0f} N")
    after = columns["time_s"] > extremes.pinch_time
    met = np.interp(extremes.pinch_time, columns["time_s"], columns["gate_angle_deg"])
    freed = columns["gate_angle_deg"][after].max(initial=-np.inf) > met + 5.0
    if force > 0.0 and not freed:
        found.append("the gate did not reverse")
    if tells and not any("reversing" in text for _, text in events):
        found.append("the ECU did not detect the obstacle")
    if columns["latched"][-1] < 0.5:
        angle = columns["gate_angle_deg"][-1]
        found.append(f"the gate did not close and latch at the end (it stands at {angle:.1f} deg)")
    if summary.command_timeouts:
        found.append(f"{summary.command_timeouts} command time-outs: the ECU was too late")
    if summary.overruns > _MOST_MISSED * summary.ticks:
        share = 100.0 * summary.overruns / summary.ticks
        found.append(
            f"{share:.1f} % of the ticks missed; allowed: up to {100.0 * _MOST_MISSED:g} % "
            "(liftgate-hil doctor says what to do)"
        )
    return found
