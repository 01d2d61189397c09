"""Flags that several subcommands share, and what they check."""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from liftgate_hil.running.options import RunOptions
    from liftgate_hil.running.setup import Setup
    from liftgate_hil.transport.can_arguments import WireChoice
    from liftgate_plant.vehicle import Vehicle

MAX_RATE = 10_000.0
LISTEN = "127.0.0.1:8765"
_ARGUMENT = re.compile(r"`([a-z][a-z_]*)`")


def as_flags(text: str) -> str:
    """Return a message of the API with its arguments, `so_named`, replaced by the flags: --so-named."""
    return _ARGUMENT.sub(lambda match: "--" + match[1].replace("_", "-"), text)


def bounded(low: float, high: float, unit: str) -> Callable[[str], float]:
    """Return an argparse type: a finite number within [low, high]."""

    def convert(value: str) -> float:
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not low <= number <= high:
            raise argparse.ArgumentTypeError(
                f"{value!r}; allowed: {low:g} to {high:g} {unit}".rstrip()
            )
        return number

    return convert


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return an argparse type: a whole number within [low, high]."""

    def convert(value: str) -> int:
        try:
            number = int(value)
        except ValueError:
            number = low - 1
        if not low <= number <= high:
            raise argparse.ArgumentTypeError(f"{value!r}; allowed: {low} to {high}")
        return number

    return convert


def add_bus(parser: argparse.ArgumentParser) -> None:
    """Add the flags for the bus or serial line."""
    parser.add_argument("--bus", metavar="INTERFACE:CHANNEL[@BITRATE]", help="e.g. socketcan:vcan0")
    parser.add_argument(
        "--serial",
        metavar="PORT[@BAUD]",
        help="instead of a bus: a device or URL of pyserial, e.g. /dev/ttyUSB0@921600",
    )
    parser.add_argument("-i", "--interface", help="python-can's own way to name the bus")
    parser.add_argument("-c", "--channel", help="python-can's own way to name the bus")
    parser.add_argument(
        "-b", "--bitrate", type=whole(1, 100_000_000), help="bit/s; default: the rig's"
    )
    parser.add_argument("--fd", action="store_true", help="open the bus for CAN FD")
    parser.add_argument(
        "--rig", metavar="NAME|FILE", help="how it is wired; default: the scenario's, else liftgate"
    )


def wire_choice(args: argparse.Namespace) -> WireChoice:
    """Return the choice of bus or line from the flags of `add_bus`."""
    from liftgate_hil.transport.can_arguments import WireChoice

    return WireChoice(
        bus=args.bus,
        serial=args.serial,
        interface=args.interface,
        channel=args.channel,
        bitrate=args.bitrate,
        is_fd=args.fd,
    )


def run_options(args: argparse.Namespace) -> RunOptions:
    """Return the options from the flags of `add_loop` and `add_output`. Raises ConfigError."""
    from liftgate_hil.config.arguments import size_of
    from liftgate_hil.formats.open import check_file
    from liftgate_hil.running.options import RunOptions

    return RunOptions(
        rate=args.rate,
        clock=args.clock,
        duration=args.duration,
        overrun_limit=args.overrun_limit,
        wall_timeout=args.wall_timeout,
        records=tuple(check_file("record", name) for name in args.record),
        record_limit=size_of("record_limit", args.record_limit),
        record_keep=args.record_keep,
        record_when=tuple(args.record_when),
        record_before=args.record_before,
        record_after=args.record_after,
        realtime=args.realtime,
        cpu=args.cpu,
    )


def add_setup(parser: argparse.ArgumentParser) -> None:
    """Add the flags for vehicle, scenario, initial angle and seed."""
    add_vehicle(parser, None, "default: the scenario's, else suv")
    parser.add_argument("--scenario", metavar="NAME|FILE", help="what happens over time")
    parser.add_argument(
        "--initial",
        metavar="closed|open|ANGLE_deg",
        help="where the gate starts; default: the scenario's, else closed",
    )
    parser.add_argument(
        "--seed",
        type=whole(0, 2**32 - 1),
        help="of noise and of what differs from run to run; default: the scenario's, else 0",
    )


def setup_of(args: argparse.Namespace) -> Setup:
    """Return the setup from the flags of `add_setup`. Raises ConfigError."""
    from liftgate_hil.running.setup import setup_of, variant_of

    return setup_of(
        args.scenario,
        vehicle=args.vehicle,
        settings=args.settings,
        initial=args.initial,
        seed=args.seed,
        variant=variant_of(args.draw, args.ideal),
    )


def add_vehicle(
    parser: argparse.ArgumentParser, default: str | None = "suv", told: str = "default: suv"
) -> None:
    """Add the flags for the vehicle."""
    parser.add_argument("--vehicle", default=default, metavar="NAME|FILE", help=told)
    parser.add_argument(
        "--set",
        dest="settings",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="replace a value of the vehicle file, e.g. environment.road_slope_deg=8 (repeatable)",
    )
    parser.add_argument(
        "--draw",
        type=whole(0, 2**32 - 1),
        metavar="SEED",
        help="one car of the vehicle file's [spread]; default: the file's own values",
    )
    parser.add_argument(
        "--ideal",
        action="store_true",
        help="without noise, ripple and errors of sensors, torsion and source resistance",
    )


def vehicle_of(args: argparse.Namespace) -> Vehicle:
    """Return the vehicle from the flags of `add_vehicle`. Raises ConfigError."""
    from liftgate_hil.running.setup import vehicle_from

    return vehicle_from(args.vehicle, args.settings, draw=args.draw, ideal=args.ideal)


def add_loop(parser: argparse.ArgumentParser) -> None:
    """Add the flags for the loop."""
    add_rate(parser)
    parser.add_argument(
        "--clock",
        choices=("realtime", "free", "lockstep"),
        default="realtime",
        help="wall time; as fast as it goes; one command period per command frame",
    )
    parser.add_argument(
        "--duration",
        type=bounded(1e-3, 1e9, "s"),
        metavar="S",
        help="model time; default: the scenario's, else until stopped",
    )
    parser.add_argument(
        "--overrun-limit",
        type=bounded(1e-3, 3600.0, "s"),
        default=1.0,
        metavar="S",
        help="end with an error when the loop falls this far behind; default: 1",
    )
    parser.add_argument(
        "--wall-timeout",
        type=bounded(1e-3, 1e9, "s"),
        metavar="S",
        help="end with an error when lockstep has waited this long for a command; default: for ever",
    )
    add_realtime(parser)


def add_rate(parser: argparse.ArgumentParser) -> None:
    """Add the flag for the rate of the loop."""
    parser.add_argument(
        "--rate",
        type=bounded(200.0, MAX_RATE, "Hz"),
        default=1000.0,
        metavar="HZ",
        help="ticks per second, 200 to 10000; default: 1000",
    )


def add_realtime(parser: argparse.ArgumentParser) -> None:
    """Add the flags for what the program requests of the machine."""
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="ask for FIFO scheduling, locked memory and a CPU; what is refused is told",
    )
    parser.add_argument(
        "--cpu",
        type=whole(0, 1023),
        metavar="N",
        help="the CPU for --realtime; default: an isolated one, else the last",
    )


def add_ecu(parser: argparse.ArgumentParser, default: str, has_bus: bool = True) -> None:
    """Add the flag for the ECU; with `has_bus` it may also be one on the bus."""
    parser.add_argument(
        "--ecu",
        default=default,
        metavar="reference|LIBRARY|MODULE:CLASS" + ("|bus" if has_bus else ""),
        help="what closes the loop: ours, a C library, a Python class"
        + (", one on the bus" if has_bus else "")
        + f"; default: {default}",
    )


def ecu_of(args: argparse.Namespace) -> str:
    """Return the value of `--ecu`; its module may also be in the working directory."""
    if ":" in args.ecu:
        # Last, so that installed modules take precedence.
        sys.path.append(str(Path.cwd()))
    return str(args.ecu)


def add_listen(parser: argparse.ArgumentParser, default: str | None = LISTEN) -> None:
    """Add the flags for the address of the page, and for read-only access."""
    parser.add_argument(
        "--listen",
        default=default,
        metavar="HOST:PORT",
        help=f"of the page; port 0 is any that is free; default: {LISTEN}",
    )
    parser.add_argument("--read-only", action="store_true", help="the page commands nothing")


def add_dashboard(parser: argparse.ArgumentParser) -> None:
    """Add the flags for the operator's page of a run."""
    parser.add_argument(
        "--dashboard",
        action="store_true",
        help="serve the operator's page of this run, see liftgate-hil dashboard",
    )
    add_listen(parser, None)


def address_of(text: str) -> tuple[str, int]:
    """Return host and port of HOST:PORT. Raises ConfigError."""
    from liftgate_hil.errors import ConfigError

    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not host or not (port.isascii() and port.isdecimal()) or int(port) > 65535:
        raise ConfigError(f"`listen` {text}: allowed: HOST:PORT, such as {LISTEN}; port 0 to 65535")
    return host, int(port)


def add_output(parser: argparse.ArgumentParser) -> None:
    """Add the flags for recordings and printed output."""
    parser.add_argument(
        "--record",
        action="append",
        default=[],
        metavar="FILE",
        help="write a recording; the suffix picks the format: .csv .parquet the plant, .log .asc .blf .trc "
        "the bus, .mf4 .mcap both (repeatable)",
    )
    parser.add_argument(
        "--record-limit",
        metavar="SIZE",
        help="begin a new file at this size, e.g. 500MB: run.0001.csv, run.0002.csv, …",
    )
    parser.add_argument(
        "--record-keep",
        type=whole(2, 10**9),
        metavar="N",
        help="of these files keep the last N; default: all",
    )
    parser.add_argument(
        "--record-when",
        action="append",
        default=[],
        metavar="CONDITION",
        help='record only around the ticks in which this is true, e.g. "pinch_force_n > 5", in the language of '
        "scenarios (repeatable: any of them)",
    )
    for name in ("before", "after"):
        parser.add_argument(
            f"--record-{name}",
            type=bounded(0.0, 600.0, "s"),
            metavar="S",
            help=f"and so long {name} that; default: 1",
        )
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
