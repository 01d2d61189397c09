"""The gate with an ECU, which opens it, closes it onto an obstacle, detects that by the currents and speeds of its
motors, reverses, then opens and closes it fully. Prints what happened, writes recordings and a picture, and judges
itself.

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
from liftgate_hil.cli.exit_codes import DEMO_EXIT_CODES
from liftgate_hil.cli.run import ending, exit_code_of, print_summary, raise_error
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.teller import Teller
from liftgate_hil.cli.with_ecu import run_loop
from liftgate_hil.dashboard.listening import hold_token
from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE
from liftgate_hil.errors import ConfigError, number_of, printable
from liftgate_hil.judging.verdict import FAIL, INCONCLUSIVE

if TYPE_CHECKING:
    from liftgate_hil.drive.result import Result
    from liftgate_hil.plan.setup import Setup
    from liftgate_hil.report.pinch import PinchEvent
    from liftgate_hil.report.run_plot import DrawnObstacle

_MOST_ROWS = 100_000  # rows of the picture, at most
_USUAL_EVERY = 10  # of a run of unknown length, one row in so many is kept
_FREE_DEG = 5.0  # a reversal must move back by more than this
_MOVED_DEG = 1.0  # a gate that moves by less only settles
_JUDGED = "parts/demo_judged"  # the demo with its expectations
_LEARNED = "parts/demo_learned"  # the same, for a reference ECU that has learned the gate
_NOT_REAL_TIME = "not in real time: the machine was too busy"  # marks a picture
_DOES_NOT_COUNT = "this run does not count"  # the same
_TOO_BUSY = "liftgate-hil demo: this machine was too busy for real time"
_AGAIN = (
    "The run is repeated on the free clock, which needs no real time; liftgate-hil doctor checks whether this "
    "machine is fit for real time"
)
_ON_THE_FREE_CLOCK = {
    "clock": "free", "bus": None, "interface": None, "channel": None, "serial": None, "realtime": False,
    "cpu": None, "dashboard": False, "listen": None, "read_only": False,
}  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    options.add_run(parser, REFERENCE)
    parser.add_argument("--ecu-serial", metavar="PORT[@BAUD]", help="the other end of --serial, for the ECU")
    parser.add_argument(
        "--output",
        default=".",
        metavar="FOLDER",
        help="folder for demo.log, demo.csv and demo.png, created if missing; default: .",
    )
    parser.add_argument("--no-record", action="store_true", help="write no demo.log, demo.csv and demo.png")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    stopped = StopSignals()
    folder, page = _folder(args), args
    if args.dashboard:
        hold_token()  # so that the page of a repeated run has that of the first one
    is_whole = args.scenario in (None, "demo") and args.duration is None
    is_ours, mark = args.ecu == REFERENCE, ""
    judged = _LEARNED if is_ours else _JUDGED
    args.scenario = judged if is_whole else args.scenario or "demo"
    shown = _shown(args, stopped, is_whole)
    if shown.is_given_up and not shown.summary.ticks:  # the precondition was not reached
        return exit_code_of(shown, DEMO_EXIT_CODES)
    busy = ""
    if is_whole and not _is_stopped(args, shown, stopped):
        busy = options.as_flags(busy_with(shown, is_ours))
    if busy and args.ecu == ON_A_BUS:
        print(f"{_TOO_BUSY}: {busy}. The run says nothing about the ECU", file=sys.stderr, flush=True)
        mark = _DOES_NOT_COUNT
    elif busy:
        print(f"{_TOO_BUSY}: {busy}. {_AGAIN}", file=sys.stderr, flush=True)
        mark = _NOT_REAL_TIME
        args = argparse.Namespace(**{**vars(args), **_ON_THE_FREE_CLOCK})
        shown = _shown(args, stopped, is_whole)
    is_stopped = _is_stopped(args, shown, stopped)
    reasons = failures(shown, event_of(shown), is_ours) if is_whole and not is_stopped else []
    if reasons and not mark:
        mark = _DOES_NOT_COUNT
    _present(args, shown, stopped, folder, mark)
    if is_stopped:
        time, whole = shown.summary.model_time_s, _whole(args)
        print(f"liftgate-hil demo: stopped at {time:.3f} s of {whole:g} s", file=sys.stderr)
        return stopped.exit_code
    if busy and args.ecu == ON_A_BUS:
        return DEMO_EXIT_CODES[INCONCLUSIVE]
    if busy and page.dashboard and not page.no_record:
        _show_on_page(page, folder)
    for reason in reasons:
        print(f"liftgate-hil demo: failed: {reason}", file=sys.stderr)
    last = "" if reasons or args.quiet or args.json else _last_line(page.scenario, shown, is_whole, bool(busy))
    if last:
        print(printable(last))
    return 1 if reasons else exit_code_of(shown, DEMO_EXIT_CODES)


def _last_line(scenario: str | None, shown: Result, is_whole: bool, is_repeated: bool) -> str:
    """Return what the output of a run that has not failed ends with; "": the expectations say it."""
    if is_whole:
        where = " (repeated on the free clock)" if is_repeated else ""
        return f"the demo has passed{where}: the gate met the rod, was reversed, and was latched at the end"
    if scenario in (None, "demo"):
        return "not judged: the demo was shortened, and the ECU had learned nothing before"
    return "" if shown.expectations else f"not judged: {scenario} states no expectations"


def _shown(args: argparse.Namespace, stopped: StopSignals, is_whole: bool) -> Result:
    """Run the demo and return its result. Raises LiftgateError."""
    wire = options.wire_choice(args)
    every = _every(args, options.setup_of(args))
    shown = run_loop(
        args, stopped, DEMO_EXIT_CODES, wire if wire.is_given else None, every, gives_up_late=is_whole
    )
    raise_error(args, shown, stopped)
    return shown


def _show_on_page(args: argparse.Namespace, folder: Path) -> None:
    """Serve the page of the repeated run, at the address of the first one, until it is stopped.

    Raises ConfigError.
    """
    from liftgate_hil.cli import dashboard

    print("liftgate-hil demo: the page shows the repeated run; Ctrl-C ends it", file=sys.stderr, flush=True)
    given = ["--recording", str(folder / "demo.csv"), "--vehicle", options.setup_of(args).vehicle_name]
    given += ["--listen", args.listen or options.LISTEN, *["--read-only"] * args.read_only]
    parser = argparse.ArgumentParser()
    dashboard.add_arguments(parser)
    dashboard.run(parser.parse_args(given))


def _present(args: argparse.Namespace, shown: Result, stopped: StopSignals, folder: Path, mark: str) -> None:
    """Write the pictures of the result `shown` and print it; `mark` is put into the pictures' title.

    --no-record, --quiet and --json each leave out a part. `stopped` is for the report only.
    """
    event = event_of(shown)
    if not args.no_record and len(shown.trace["time_s"]) > 1:  # not stopped before it began
        teller = Teller(args.quiet, args.json)
        with teller.progress("picture"):
            _draw(options.setup_of(args), shown, event, folder, mark, teller)
    if not args.quiet and not args.json:
        _tell(args, shown, event, folder)
    if args.json:
        from liftgate_hil.report.run_report import DemoReport

        print(DemoReport(shown, *ending(args, shown, stopped), event).to_json())
    elif not args.quiet:
        print_summary(shown)


def _is_stopped(args: argparse.Namespace, shown: Result, stopped: StopSignals) -> bool:
    """Whether the run was stopped before its end."""
    whole = _whole(args)
    return whole is not None and shown.summary.model_time_s < whole and stopped()


def event_of(shown: Result) -> PinchEvent | None:
    """Return the contact with the largest pinch force, if there was one."""
    from liftgate_hil.report.pinch import pinch_event

    return pinch_event(shown.trace)


def _whole(args: argparse.Namespace) -> float | None:
    """Return the length of the whole run [s]; None: until stopped."""
    return options.setup_of(args).scenario.duration if args.duration is None else float(args.duration)


def _every(args: argparse.Namespace, setup: Setup) -> int:
    """Return the decimation of rows for the picture: 1, all rows, for the usual demo."""
    duration = setup.scenario.duration if args.duration is None else args.duration
    if duration is None:
        return _USUAL_EVERY
    return int(max(1, math.ceil(duration * args.rate / _MOST_ROWS)))


def _folder(args: argparse.Namespace) -> Path:
    """Return the output folder, which is created, and add the demo's recordings. Raises ConfigError."""
    folder = Path(args.output)
    if (args.serial is None) != (args.ecu_serial is None):
        raise ConfigError("`serial` and `ecu_serial`: allowed: both ends of the line, or neither")
    if not args.no_record:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f"`output` {args.output}: cannot be created: {error.strerror}; allowed: a folder"
            ) from error
        args.record = [*args.record, str(folder / "demo.log"), str(folder / "demo.csv")]
    return folder


def _draw(setup: Setup, shown: Result, event: PinchEvent | None, folder: Path, mark: str, teller: Teller) -> None:
    """Write the picture. Raises ConfigError."""
    from liftgate_hil.report.run_plot import RunPicture, plot_run
    from liftgate_hil.signals import columns_of

    title = f"liftgate-hil demo: {setup.vehicle_name}, clock {shown.summary.clock}"
    picture = RunPicture(
        title=f"{title} ({mark})" if mark else title,
        columns={name: shown.trace[name] for name in columns_of(setup.vehicle.drives)},
        event=event,
        obstacles=_obstacles(setup),
        marks=[(each.time, "ECU reverses") for each in shown.events if "reversing" in each.text],
    )
    try:
        plot_run(folder / "demo.png", picture, teller.say)
    except OSError as error:
        raise ConfigError(f"`output` {folder}: demo.png: {error.strerror}") from error


def _obstacles(setup: Setup) -> list[DrawnObstacle]:
    """Return the obstacles of the scenario, as they are drawn."""
    from liftgate_hil.report.run_plot import DrawnObstacle

    return [
        DrawnObstacle(math.degrees(each.obstacle.angle), each.start.time, each.end.time)
        for each in setup.scenario.stimuli.obstacles
    ]


def _tell(args: argparse.Namespace, shown: Result, event: PinchEvent | None, folder: Path) -> None:
    """Print what happened."""
    import numpy as np

    columns = shown.trace
    if len(columns["time_s"]) < 2:
        return
    # In real time the events have been printed as they happened.
    events = [] if args.clock == "realtime" else shown.events
    for each in events:
        angle = float(np.interp(each.time, columns["time_s"], columns["gate_angle_deg"]))
        print(f"{each.time:7.3f} s  {angle:6.2f} deg  {each.text}")
    if event is not None:
        print("\n".join(event.lines()))
    if not args.no_record:
        print(f"picture: {folder / 'demo.png'}")


def failures(shown: Result, event: PinchEvent | None, is_ours: bool) -> list[str]:
    """Return the failures of a whole demo.

    An ECU that `is_ours` must also report its reversal as an event. In real time it is late only where its machine
    is, which the scenario's tolerance covers; another one must be in time.
    """
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
    if is_ours and not any("reversing" in event.text for event in shown.events):
        found.append("the ECU did not detect the obstacle")
    if columns["latched"][-1] < 0.5:
        angle = columns["gate_angle_deg"][-1]
        found.append(f"the gate did not close and latch at the end (it stands at {angle:.1f} deg)")
    if summary.command_timeouts and not (is_ours and summary.clock == "realtime"):
        found.append(f"{number_of(summary.command_timeouts, 'command time-out')}: the ECU was too late")
    if not found and shown.verdict == FAIL:
        found.append(shown.reason)
    return found


def busy_with(shown: Result, is_ours: bool) -> str:
    """Return the reason why a run in real time does not count because the machine was too busy; "": it counts.

    A reason is a verdict that the machine's lateness may have decided, and, with an ECU that `is_ours` and so is
    late only where its machine is, any failure of a late run. Such a run is repeated on the free clock.
    """
    if shown.summary.clock != "realtime":
        return ""
    verdicts = shown.expectations.values()
    doubtful = [each for each in verdicts if each.verdict == INCONCLUSIVE]
    is_failed = bool(failures(shown, event_of(shown), is_ours))
    late = shown.late.removeprefix("the bench was late: ")
    if doubtful:
        return late or f"{doubtful[0].name}: {doubtful[0].reason}"
    return late if is_failed and is_ours else ""


def _standstill(shown: Result) -> list[str]:
    """Return why a gate never moved, as far as the commands show it; empty where it moved."""
    accepted, angles = shown.summary.received.accepted, shown.trace["gate_angle_deg"]
    if angles.max() - angles.min() >= _MOVED_DEG:
        return []
    if accepted:
        return [f"{number_of(accepted, 'command')} accepted, and no drive moved"]
    return [shown.summary.silence_reported()]
