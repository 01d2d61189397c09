"""The operator's page of a running emulator, or of a recording: a web page of this machine, for those who have its
address with the token. Runs until it is stopped; a run that has ended is followed by the next one on its bus.

Scripts ask the same server: GET /api/state, GET /api/about (what can be commanded, with ranges), POST
/api/command, WS /api/stream, each with ?token=…. Each start has a new token, unless LIFTGATE_HIL_TOKEN is set
in the environment.
"""

from __future__ import annotations

import argparse
import os
import socket
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.recordings import add_reading, reading_of
from liftgate_hil.cli.streams import put_line
from liftgate_hil.errors import ConfigError, printable

if TYPE_CHECKING:
    from liftgate_hil.dashboard.live import Live
    from liftgate_hil.dashboard.recorded import RecordingSource
    from liftgate_hil.dashboard.source import NoSource
    from liftgate_hil.dashboard.starting import Starter

# What each flag goes with.
_GOES_WITH = {
    "rig": ("recording", "scenarios"), "vehicle": ("recording", "scenarios"), "bus": ("scenarios",),
    "ecu": ("scenarios",), "recording_channel": ("recording",), "timezone": ("recording",),
}  # fmt: skip
_MISSING = "not installed; allowed: with pip install 'liftgate-hil[dashboard]'"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--attach", type=options.whole(1, 2**31), metavar="PID", help="process id of a run")
    source.add_argument("--recording", metavar="FILE", help="a recording, or a bus log with --rig")
    source.add_argument(
        "--scenarios", metavar="FOLDER", help="start scenarios of this folder (pack: shipped) from the page"
    )
    parser.add_argument(
        "--rig",
        metavar="NAME|FILE",
        help="with --recording: the rig that decodes its frames; with --scenarios: its rig",
    )
    parser.add_argument(
        "--vehicle",
        metavar="NAME|FILE",
        help="with --recording: the vehicle to draw, if the file does not name it; with --scenarios: its vehicle",
    )
    add_reading(parser)
    parser.add_argument(
        "--bus",
        metavar="INTERFACE:CHANNEL",
        help="with --scenarios: the bus of the runs; default: one inside the run",
    )
    parser.add_argument(
        "--ecu", metavar="ECU", help="with --scenarios: what closes the loop, as of a run; default: reference"
    )
    options.add_listen(parser)
    # Set by a run with --dashboard: how long it may take to begin [s], and the socket to listen on.
    parser.add_argument("--patience", type=float, default=0.0, help=argparse.SUPPRESS)
    parser.add_argument("--descriptor", type=int, help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    check_installed()
    from liftgate_hil.dashboard.listening import bound, new_token, url_of

    host, port = options.address_of(args.listen)
    token = new_token()
    wire = None if args.descriptor is None else socket.socket(fileno=args.descriptor)
    if wire is not None:  # of a run, which is about to begin, and handles signals itself
        put_line(printable(url_of(wire, host, token)), sys.stdout)
    _check(args)
    starter, source = _starter(args), _source(args)
    from liftgate_hil.dashboard.deference import giving_way
    from liftgate_hil.dashboard.server import Page
    from liftgate_hil.dashboard.serving import serve

    with giving_way(), wire or bound((host, port)) as listening:
        page = Page(source, args.read_only, starter, wire is not None)
        address = printable(url_of(listening, host, token))
        serve(page, listening, host, token, lambda: put_line(address, sys.stdout) if wire is None else None)
    return 0


def check_installed() -> None:
    """Raise ConfigError where packages that the dashboard needs are missing."""
    missing = [name for name in ("starlette", "uvicorn", "websockets") if find_spec(name) is None]
    if missing:
        raise ConfigError(f"dashboard: {', '.join(missing)}: {_MISSING}")


def _check(args: argparse.Namespace) -> None:
    """Raise ConfigError for a flag that does not go with the source of the page."""
    for name, goes_with in _GOES_WITH.items():
        given = getattr(args, name)
        if given is not None and all(getattr(args, each) is None for each in goes_with):
            raise ConfigError(f"`{name}` {given}: allowed with {' or '.join(f'`{each}`' for each in goes_with)}")


def _source(args: argparse.Namespace) -> Live | RecordingSource | NoSource:
    """Return the source of the page: a recording, a client of a run, or none yet. Raises ConfigError."""
    if args.scenarios is not None:
        from liftgate_hil.dashboard.source import NoSource

        return NoSource()
    if args.recording is not None:
        from liftgate_hil.cli.teller import Teller
        from liftgate_hil.dashboard.recorded import RecordingSource

        with Teller(is_quiet=False).progress(f"reading {printable(args.recording)}"):
            return RecordingSource(Path(args.recording), args.rig, args.vehicle, reading_of(args))
    from liftgate_hil.dashboard.live import Live
    from liftgate_hil.operate.attachment.client import Client

    try:
        return Live(Client(_chosen() if args.attach is None else args.attach, args.patience))
    except ConfigError as error:
        if args.attach is None:
            raise
        raise ConfigError([f"{each}; {_running()}" for each in error.issues]) from error


def _starter(args: argparse.Namespace) -> Starter | None:
    """Return what starts the scenarios of `--scenarios`; None: the page starts none. Raises ConfigError."""
    if args.scenarios is None:
        return None
    from liftgate_hil.config.shipped import shipped_folder
    from liftgate_hil.dashboard.starting import Starter

    on_its_own = args.bus is None
    flags = ["--bus", f"virtual:page-{os.getpid()}" if on_its_own else args.bus]
    flags += ["--ecu", args.ecu or "reference"]
    for name in ("rig", "vehicle"):
        flags += [] if getattr(args, name) is None else [f"--{name}", getattr(args, name)]
    folder = Path(args.scenarios)
    return Starter(folder if folder.is_dir() else shipped_folder("scenarios", args.scenarios) or folder, flags)


def _running() -> str:
    """Return in words which runs there are."""
    from liftgate_hil.operate.attachment import endpoint

    found = ", ".join(map(str, endpoint.runs()))
    return f"running: {found}" if found else "none is running"


def _chosen() -> int:
    """Return the process id of the only run. Raises ConfigError where there is none, or several."""
    from liftgate_hil.operate.attachment import endpoint

    found = endpoint.runs()
    if len(found) == 1:
        return found[0]
    if found:
        which = ", ".join(map(str, found))
        raise ConfigError(f"`attach` missing: several runs are active; allowed: one of {which}")
    raise ConfigError(
        f"no emulator of yours is running on this machine{endpoint.unusable()}: start one "
        "(liftgate-hil --bus …), or show `recording` FILE, or start `scenarios` FOLDER from the page"
    )
