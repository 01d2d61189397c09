"""The emulator with the reference ECU: the gate opens, closes onto an obstacle, is detected by motor current,
reverses, then opens and closes fully. Prints what happened, writes recordings and a picture.

On a virtual bus both run in this process; on any other bus the ECU is a second process. On a serial line it needs
a port of its own, the line's other end: --ecu-serial.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.errors import ConfigError, LiftgateError
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_EVENT = re.compile(r"^ecu\s+([\d.]+) s  (.*)$")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags."""
    options.add_bus(parser)
    options.add_vehicle(parser)
    options.add_loop(parser)
    options.add_output(parser)
    parser.add_argument(
        "--ecu-serial", metavar="PORT[@BAUD]", help="the other end of --serial, for the ECU"
    )
    parser.add_argument(
        "--output", default=".", metavar="FOLDER", help="for demo.log, demo.csv and demo.png"
    )


class Story:
    """What a run showed: every tenth row for the picture, and the plant's side of the story."""

    def __init__(self) -> None:
        self.rows: list[NDArray[np.float64]] = []
        self.pinch_force = 0.0
        self.pinch_time = 0.0
        self._count = 0

    def watch(self, row: NDArray[np.float64]) -> None:
        """Take a tick."""
        force = float(row[COLUMN_PLACE["pinch_force_n"]])
        if force > self.pinch_force:
            self.pinch_force, self.pinch_time = force, float(row[COLUMN_PLACE["time_s"]])
        if self._count % 10 == 0:
            self.rows.append(row)
        self._count += 1


def run(args: argparse.Namespace) -> int:
    """The command."""
    from liftgate_hil import session
    from liftgate_hil.cli.run import announcer, report, speaker
    from liftgate_hil.transport.find import find_way, open_transport

    folder = Path(args.output)
    if not folder.is_dir():
        raise ConfigError(f"--output {args.output}: no such folder; allowed: one that exists")
    if (args.serial is None) != (args.ecu_serial is None):
        raise ConfigError("--serial and --ecu-serial: allowed: both ends of the line, or neither")
    if args.bus is None and args.interface is None and args.serial is None:
        args.bus = "virtual:demo"
    args.scenario = args.scenario or "demo"
    args.record = [*args.record, str(folder / "demo.log"), str(folder / "demo.csv")]
    vehicle = session.vehicle_from(args.vehicle, args.settings)
    rig = session.rig_from(args.rig)
    scenario = session.scenario_from(args.scenario)
    way = find_way(options.wire_choice(args), rig)
    story = Story()
    emulator = session.Emulator(
        vehicle=vehicle,
        rig=rig,
        scenario=scenario,
        way=way,
        options=options.run_options(args),
        watch=story.watch,
        say=speaker(args),
        stopped=options.StopSignals(),
        announce=announcer(args),
    )
    with contextlib.ExitStack() as stack:
        if way.is_interface("virtual"):
            from liftgate_hil.ecu.controller import Controller
            from liftgate_hil.ecu.node import EcuNode

            wire = open_transport(way)
            stack.callback(wire.close)
            controller = Controller(vehicle.drives)
            node = EcuNode(rig, wire, controller, vehicle.drives, scenario.requests)
            emulator.peers = [node]
            summary = emulator.run()
            events = [(event.time, event.text) for event in controller.events]
        else:
            if args.clock == "free":
                raise ConfigError(
                    "--clock free: allowed with the ECU in a second process: realtime, lockstep"
                )
            child = stack.enter_context(_ecu_process(args, vehicle.drives))
            summary = emulator.run()
            child.terminate()
            events = _events_of(child)
    _tell(args, story, events, folder)
    report(args, summary)
    # The whole demo without a reversal is a failure; one that was stopped, or another scenario, is not.
    whole = args.scenario == "demo" and summary.model_time_s >= (scenario.duration or 0.0)
    return 1 if whole and not any("reversing" in text for _, text in events) else 0


@contextlib.contextmanager
def _ecu_process(args: argparse.Namespace, drives: int) -> Iterator[subprocess.Popen[str]]:
    """`liftgate-hil ecu` on the same bus; ended with this process."""
    command = [
        sys.executable,
        "-m",
        "liftgate_hil",
        "ecu",
        "--rig",
        args.rig,
        "--scenario",
        args.scenario,
    ]
    command += ["--drives", str(drives)]
    for flag in ("bus", "interface", "channel", "bitrate"):
        value = getattr(args, flag)
        if value is not None:
            command += [f"--{flag}", str(value)]
    if args.ecu_serial is not None:
        command += ["--serial", args.ecu_serial]
    if args.fd:
        command.append("--fd")
    child = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        yield child
    finally:
        child.kill()
        child.wait()


def _events_of(child: subprocess.Popen[str]) -> list[tuple[float, str]]:
    stream: IO[str] | None = child.stderr
    assert stream is not None
    lines = stream.read().splitlines()
    matches = [match for line in lines if (match := _EVENT.match(line))]
    if not matches:
        detail = " ".join(lines)[:300] or "it said nothing"
        raise LiftgateError(f"the ECU's process did not take part: {detail}")
    return [(float(match[1]), match[2]) for match in matches]


def _tell(
    args: argparse.Namespace, story: Story, events: Sequence[tuple[float, str]], folder: Path
) -> None:
    """Print what happened, and draw it."""
    import numpy as np

    from liftgate_hil.report.run_plot import plot_run

    if len(story.rows) < 2:
        return  # stopped before it began
    rows = np.array(story.rows)
    columns = {name: rows[:, COLUMN_PLACE[name]] for name in COLUMNS}
    reversals = [(time, "reversal") for time, text in events if "reversing" in text]
    plot_run(folder / "demo.png", columns, reversals, f"liftgate-hil demo: {args.vehicle}")
    if args.quiet or args.json:
        return
    for time, text in events:
        angle = float(np.interp(time, columns["time_s"], columns["gate_angle_deg"]))
        print(f"{time:7.3f} s  {angle:6.2f} deg  {text}")
    if story.pinch_force > 0.0:
        print(f"pinch force at most {story.pinch_force:.1f} N, at {story.pinch_time:.3f} s")
    print(f"written: {', '.join(str(folder / f'demo.{kind}') for kind in ('log', 'csv', 'png'))}")
