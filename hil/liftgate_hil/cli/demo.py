"""The emulator with an ECU: the gate opens, closes onto an obstacle, is detected by motor current, reverses, then
opens and closes fully. Prints what happened, writes recordings and a picture, and judges itself.

Without a bus both run in this process: on the free clock as machine code, else on a virtual bus. On any other
bus the ECU is a second process. On a serial line it needs a port of its own, the line's other end: --ecu-serial.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.with_ecu import run_loop
from liftgate_hil.errors import ConfigError

if TYPE_CHECKING:
    from liftgate_hil.runs import Result

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
        "--output",
        default=".",
        metavar="FOLDER",
        help="for demo.log, demo.csv and demo.png; made where there is none",
    )
    parser.add_argument(
        "--no-record", action="store_true", help="write no demo.log, demo.csv and demo.png"
    )


def run(args: argparse.Namespace) -> int:
    """The command."""
    from liftgate_hil.cli.run import report

    stopped = StopSignals()
    folder = _folder(args)
    has_wire = any(name is not None for name in (args.bus, args.interface, args.serial))
    args.scenario = args.scenario or "demo"
    shown = run_loop(args, stopped, has_wire, trace=_EVERY)
    _tell(args, shown, folder)
    report(args, shown.summary)
    return _judge(args, shown, stopped)


def _folder(args: argparse.Namespace) -> Path:
    """Where it writes; adds the demo's recordings. Raises ConfigError."""
    folder = Path(args.output)
    if (args.serial is None) != (args.ecu_serial is None):
        raise ConfigError("`serial` and `ecu_serial`: allowed: both ends of the line, or neither")
    if not args.no_record:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f"`output` {args.output}: cannot be made: {error.strerror}; allowed: a folder"
            ) from error
        args.record = [*args.record, str(folder / "demo.log"), str(folder / "demo.csv")]
    return folder


def _tell(args: argparse.Namespace, shown: Result, folder: Path) -> None:
    """Print what happened, and draw it."""
    import numpy as np

    from liftgate_hil.report.run_plot import plot_run

    columns, events = shown.trace, shown.events
    if len(columns["time_s"]) < 2:
        return  # stopped before it began
    if not args.no_record:
        reversals = [(event.time, "reversal") for event in events if "reversing" in event.text]
        title = " ".join(each for each in ("liftgate-hil demo", args.vehicle) if each)
        plot_run(folder / "demo.png", columns, reversals, title)
    if args.quiet or args.json:
        return
    for event in events:
        angle = float(np.interp(event.time, columns["time_s"], columns["gate_angle_deg"]))
        print(f"{event.time:7.3f} s  {angle:6.2f} deg  {event.text}")
    if (force := shown.maxima["pinch_force_n"]) > 0.0:
        print(f"pinch force at most {force:.1f} N, at {shown.pinch_time_s:.3f} s")
    if not args.no_record:
        print(f"picture: {folder / 'demo.png'}")


def _judge(args: argparse.Namespace, shown: Result, stopped: StopSignals) -> int:
    """The exit code: 1 where the whole demo did not show what it is there to show; the signal's where it did not
    come to its end. A part of it, or another scenario, is not judged.
    """
    from liftgate_hil.session import scenario_from

    whole = scenario_from(args.scenario).duration if args.duration is None else args.duration
    time = shown.summary.model_time_s
    if whole is not None and time < whole and stopped():
        print(f"liftgate-hil demo: stopped at {time:.3f} s of {whole:g} s", file=sys.stderr)
        return stopped.exit_code
    if args.scenario != "demo" or args.duration is not None:
        return 0
    reasons = failures(shown, tells=args.ecu == "reference")
    for reason in reasons:
        print(f"liftgate-hil demo: failed: {reason}", file=sys.stderr)
    return 1 if reasons else 0


def failures(shown: Result, tells: bool) -> list[str]:
    """What a whole demo did not do as it should; an ECU of ours `tells` that it reverses."""
    found = []
    force, columns, summary = shown.maxima["pinch_force_n"], shown.trace, shown.summary
    if not force > 0.0:
        found.append("the gate never met the obstacle")
    elif not _is_freed(shown):
        found.append("the gate did not reverse")
    if force > _MOST_FORCE:
        found.append(f"pinch force {force:.1f} N; allowed: up to {_MOST_FORCE:.0f} N")
    if tells and not any("reversing" in event.text for event in shown.events):
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


def _is_freed(shown: Result) -> bool:
    """Whether the gate opened again after it had pressed hardest."""
    import numpy as np

    times, angles = shown.trace["time_s"], shown.trace["gate_angle_deg"]
    pressed = np.interp(shown.pinch_time_s, times, angles)
    return bool(angles[times > shown.pinch_time_s].max(initial=-np.inf) > pressed + _FREE_DEG)
