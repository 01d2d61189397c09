"""The emulator with an ECU: the gate opens, closes onto an obstacle, is detected by motor current, reverses, then
opens and closes fully. Prints what happened, writes recordings and a picture, and judges itself.

Without a bus both run in this process: on the free clock as machine code, else on a virtual bus. On any other
bus the ECU is a second process. On a serial line it needs a port of its own, the line's other end: --ecu-serial.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.with_ecu import run_loop
from liftgate_hil.errors import ConfigError

if TYPE_CHECKING:
    from liftgate_hil.report.pinch import PinchEvent
    from liftgate_hil.report.run_plot import DrawnObstacle
    from liftgate_hil.runs.result import Result
    from liftgate_hil.session import Setup

_MOST_ROWS = 100_000  # of the picture
_USUAL_EVERY = 10  # of a run whose length nobody knows, every so many rows
_FREE_DEG = 5.0  # what a reversal must free
_MOVED_DEG = 1.0  # more than a gate settles by
_MOST_MISSED = 0.01  # share of ticks; more makes a machine unfit (see doctor)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags."""
    options.add_bus(parser)
    options.add_setup(parser)
    options.add_loop(parser)
    options.add_output(parser)
    options.add_dashboard(parser)
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
    from liftgate_hil.report.pinch import pinch_event

    stopped = StopSignals()
    folder = _folder(args)
    has_wire = any(name is not None for name in (args.bus, args.interface, args.serial))
    args.scenario = args.scenario or "demo"
    setup = options.setup_of(args)
    shown = run_loop(args, stopped, has_wire, trace=_every(args, setup))
    event = pinch_event(shown.trace)
    if not args.no_record and len(shown.trace["time_s"]) > 1:  # not stopped before it began
        _draw(setup, shown, event, folder)
    if not args.quiet and not args.json:
        _tell(args, shown, event, folder)
    report(args, shown, stopped, pinch=None if event is None else event.as_dict())
    return _judge(args, setup, shown, event, stopped)


def _every(args: argparse.Namespace, setup: Setup) -> int:
    """Every so many rows are kept for the picture: all of the demo's."""
    duration = setup.scenario.duration if args.duration is None else args.duration
    if duration is None:
        return _USUAL_EVERY
    return int(max(1, math.ceil(duration * args.rate / _MOST_ROWS)))


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


def _draw(setup: Setup, shown: Result, event: PinchEvent | None, folder: Path) -> None:
    """The picture. Raises ConfigError."""
    from liftgate_hil.report.run_plot import RunPicture, plot_run
    from liftgate_hil.signals import columns_of

    picture = RunPicture(
        title=f"liftgate-hil demo: {setup.vehicle_name}, clock {shown.summary.clock}",
        columns={name: shown.trace[name] for name in columns_of(setup.vehicle.drives)},
        event=event,
        obstacles=_obstacles(setup),
        marks=[(each.time, "reversal") for each in shown.events if "reversing" in each.text],
    )
    try:
        plot_run(folder / "demo.png", picture)
    except OSError as error:
        raise ConfigError(f"`output` {folder}: demo.png: {error.strerror}") from error


def _obstacles(setup: Setup) -> list[DrawnObstacle]:
    """Those of the scenario."""
    from liftgate_hil.report.run_plot import DrawnObstacle

    return [
        DrawnObstacle(math.degrees(each.obstacle.angle), each.start.time, each.end.time)
        for each in setup.scenario.stimuli.obstacles
    ]


def _shares_terminal() -> bool:
    return all(stream is not None and stream.isatty() for stream in (sys.stdout, sys.stderr))


def _tell(args: argparse.Namespace, shown: Result, event: PinchEvent | None, folder: Path) -> None:
    """Print what happened."""
    import numpy as np

    columns = shown.trace
    if len(columns["time_s"]) < 2:
        return
    # On a terminal the story stands there already, told as it happened.
    events = [] if args.clock == "realtime" and _shares_terminal() else shown.events
    for each in events:
        angle = float(np.interp(each.time, columns["time_s"], columns["gate_angle_deg"]))
        print(f"{each.time:7.3f} s  {angle:6.2f} deg  {each.text}")
    if event is not None:
        print("\n".join(event.lines()))
    if not args.no_record:
        print(f"picture: {folder / 'demo.png'}")


def _judge(
    args: argparse.Namespace,
    setup: Setup,
    shown: Result,
    event: PinchEvent | None,
    stopped: StopSignals,
) -> int:
    """The exit code: 1 where the whole demo did not show what it is there to show; the signal's where it did not
    come to its end. A part of it, or another scenario, is not judged.
    """
    whole = setup.scenario.duration if args.duration is None else args.duration
    time = shown.summary.model_time_s
    if whole is not None and time < whole and stopped():
        print(f"liftgate-hil demo: stopped at {time:.3f} s of {whole:g} s", file=sys.stderr)
        return stopped.exit_code
    if args.scenario != "demo" or args.duration is not None:
        return 0
    reasons = failures(shown, event, tells=args.ecu == "reference")
    for reason in reasons:
        print(f"liftgate-hil demo: failed: {reason}", file=sys.stderr)
    return 1 if reasons else 0


def failures(shown: Result, event: PinchEvent | None, tells: bool) -> list[str]:
    """What a whole demo did not do as it should; an ECU of ours `tells` that it reverses."""
    from liftgate_hil.report.pinch import LIMITS

    found = _standstill(shown)
    columns, summary = shown.trace, shown.summary
    if event is None:
        found.append("the gate never met the obstacle")
    elif math.isnan(event.turn_s):
        found.append("the gate did not reverse")
    elif event.back_deg <= _FREE_DEG:
        found.append(
            f"the gate reversed, but moved back by {event.back_deg:.1f} deg only; allowed: more than "
            f"{_FREE_DEG:g} deg"
        )
    for limit in LIMITS:
        if event is not None and limit.is_judged and event.over(limit):
            found.append(event.fault(limit))
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


def _standstill(shown: Result) -> list[str]:
    """Why a gate never moved, as far as the commands tell it."""
    from liftgate_hil.codec.receive import rejected

    received, angles = shown.summary.received, shown.trace["gate_angle_deg"]
    if received.accepted and angles.max() - angles.min() < _MOVED_DEG:
        return [f"{received.accepted} commands were accepted, and none of them moved a drive"]
    if received.accepted or angles.max() - angles.min() >= _MOVED_DEG:
        return []
    if rejected(received):
        return [f"no command was accepted, {rejected(received)} were rejected"]
    if received.foreign:
        return [
            f"no command was accepted, {received.foreign} frames have identifiers that the rig does not receive"
        ]
    return ["no command came: the ECU sent nothing"]
