"""The emulator with an ECU: the gate opens, closes onto an obstacle, is detected by motor current, reverses, then
opens and closes fully. Prints what happened, writes recordings and a picture, and judges itself.

Without a bus both run in this process: on the free clock as machine code, else on a virtual bus. On any other
bus the ECU is a second process. On a serial line it needs a port of its own, the line's other end: --ecu-serial.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from liftgate_hil.cli import options
from liftgate_hil.cli.with_ecu import Events, on_a_bus
from liftgate_hil.errors import ConfigError, LiftgateError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from liftgate_hil.loop.statistics import Summary

_EVERY = 10  # rows of the picture
# The reference ECU presses 142 N on the demo's rod, a drive that stalls over 500 N; EN 12453 (doors of buildings)
# lets 400 N pass for a moment.
_MOST_FORCE = 400.0  # N
_FREE_DEG = 5.0  # a reversal opens the gate by more
_MOST_MISSED = 0.01  # share of ticks; more makes a machine unfit (see doctor)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags."""
    options.add_bus(parser)
    options.add_setup(parser)
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


class Shown(NamedTuple):
    """What a demo showed."""

    vehicle: str
    summary: Summary
    events: Events
    pinch_force: float  # N, the largest
    pinch_time: float  # s
    columns: Mapping[str, NDArray[np.float64]]  # of every tenth row


def run(args: argparse.Namespace) -> int:
    """The command."""
    from liftgate_hil.cli.run import report

    folder = _folder(args)
    has_bus = args.bus is not None or args.interface is not None or args.serial is not None
    args.scenario = args.scenario or "demo"
    if not has_bus and args.clock == "free":
        shown = _as_machine_code(args)
    else:
        args.bus = args.bus if has_bus else "virtual:demo"
        shown = _on_a_bus(args)
    _tell(args, shown, folder)
    report(args, shown.summary)
    return _judge(args, shown)


def _folder(args: argparse.Namespace) -> Path:
    """Where it writes; adds the demo's recordings. Raises ConfigError."""
    folder = Path(args.output)
    if not folder.is_dir():
        raise ConfigError(f"`output` {args.output}: no such folder; allowed: one that exists")
    if (args.serial is None) != (args.ecu_serial is None):
        raise ConfigError("`serial` and `ecu_serial`: allowed: both ends of the line, or neither")
    if not args.no_record:
        args.record = [*args.record, str(folder / "demo.log"), str(folder / "demo.csv")]
    return folder


def _as_machine_code(args: argparse.Namespace) -> Shown:
    """Gate and ECU in one process, as fast as it goes."""
    from liftgate_hil import runs
    from liftgate_hil.cli.run import announcer
    from liftgate_hil.loop.episode import run_stretch

    job = runs.Job(
        scenario=args.scenario,
        ecu=options.ecu_of(args),
        vehicle=args.vehicle,
        rig=args.rig,
        settings=tuple(args.settings),
        initial=args.initial,
        seed=args.seed,
        options=options.run_options(args),
        trace=_EVERY,
    )
    name = runs.resolve(job).setup.vehicle_name
    announcer(args)(run_stretch, f"{name} on no bus")
    result = runs.execute(job, options.StopSignals())
    if result.verdict == "error":
        raise LiftgateError(result.reason)
    return Shown(
        name,
        result.summary,
        [(event.time, event.text) for event in result.events],
        result.maxima["pinch_force_n"],
        result.pinch_time_s,
        result.trace,
    )


def _on_a_bus(args: argparse.Namespace) -> Shown:
    """On a bus, virtual or real."""
    from liftgate_hil.cli.run import announcer, speaker
    from liftgate_hil.emulator import Emulator
    from liftgate_hil.loop.closed_loop import Extremes, Trace, watcher
    from liftgate_hil.session import rig_of
    from liftgate_hil.transport.find import find_way

    setup = options.setup_of(args)
    rig = rig_of(args.rig, setup.scenario)
    extremes, trace = Extremes(), Trace(_EVERY)
    emulator = Emulator(
        setup=setup,
        rig=rig,
        way=find_way(options.wire_choice(args), rig),
        options=options.run_options(args),
        watch=watcher([extremes, trace]),
        say=speaker(args),
        stopped=options.StopSignals(),
        announce=announcer(args),
    )
    summary, events = on_a_bus(args, emulator)
    force = extremes.maximum("pinch_force_n")
    return Shown(setup.vehicle_name, summary, events, force, extremes.pinch_time, trace.columns())


def _tell(args: argparse.Namespace, shown: Shown, folder: Path) -> None:
    """Print what happened, and draw it."""
    import numpy as np

    from liftgate_hil.report.run_plot import plot_run

    columns, events = shown.columns, shown.events
    if len(columns["time_s"]) < 2:
        return  # stopped before it began
    if not args.no_record:
        reversals = [(time, "reversal") for time, text in events if "reversing" in text]
        plot_run(folder / "demo.png", columns, reversals, f"liftgate-hil demo: {shown.vehicle}")
    if args.quiet or args.json:
        return
    for time, text in events:
        angle = float(np.interp(time, columns["time_s"], columns["gate_angle_deg"]))
        print(f"{time:7.3f} s  {angle:6.2f} deg  {text}")
    if shown.pinch_force > 0.0:
        print(f"pinch force at most {shown.pinch_force:.1f} N, at {shown.pinch_time:.3f} s")
    if not args.no_record:
        names = ", ".join(str(folder / f"demo.{kind}") for kind in ("log", "csv", "png"))
        print(f"written: {names}")


def _judge(args: argparse.Namespace, shown: Shown) -> int:
    """The exit code: 1 where the whole demo did not show what it is there to show. One that was stopped, or with
    another scenario, is not judged.
    """
    from liftgate_hil.session import scenario_from

    if args.scenario != "demo" or args.duration is not None:
        return 0
    if shown.summary.model_time_s < (scenario_from("demo").duration or 0.0):
        return 0
    reasons = failures(shown, tells=args.ecu == "reference")
    for reason in reasons:
        print(f"liftgate-hil demo: failed: {reason}", file=sys.stderr)
    return 1 if reasons else 0


def failures(shown: Shown, tells: bool) -> list[str]:
    """What a whole demo did not do as it should; an ECU of ours `tells` that it reverses."""
    found = []
    force, columns, summary = shown.pinch_force, shown.columns, shown.summary
    if not force > 0.0:
        found.append("the gate never met the obstacle")
    elif not _is_freed(shown):
        found.append("the gate did not reverse")
    if force > _MOST_FORCE:
        found.append(f"pinch force {force:.1f} N; allowed: up to {_MOST_FORCE:.0f} N")
    if tells and not any("reversing" in text for _, text in shown.events):
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


def _is_freed(shown: Shown) -> bool:
    """Whether the gate opened again after it had pressed hardest."""
    import numpy as np

    times, angles = shown.columns["time_s"], shown.columns["gate_angle_deg"]
    pressed = np.interp(shown.pinch_time, times, angles)
    return bool(angles[times > shown.pinch_time].max(initial=-np.inf) > pressed + _FREE_DEG)
