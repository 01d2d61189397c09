"""The operator's page of a running emulator, or of a recording: a web page of this machine, for those who have its
address with the token. Runs until it is stopped; a run that has ended is followed by the next one on its bus.

Scripts ask the same server: GET /api/state, GET /api/about (what can be commanded, with ranges), POST
/api/command, WS /api/stream, each with ?token=…. Each start has a new token, unless LIFTGATE_HIL_TOKEN is set
in the environment.
"""

from __future__ import annotations

import argparse
import socket
import sys

from liftgate_hil.cli.command import Call, add_flags
from liftgate_hil.cli.terminal.streams import put_line
from liftgate_hil.dashboard.request import DashboardRequest, address_of
from liftgate_hil.errors import printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `dashboard` to its parser."""
    add_flags(parser, DashboardRequest)


def run(call: Call) -> int:
    """Run the subcommand `dashboard` (serve the operator's page until stopped) and return its exit code."""
    serve_page(call.request(DashboardRequest))
    return 0


def serve_page(request: DashboardRequest) -> None:
    """Print the address of a dashboard page, and serve the page until it is stopped. Raises ConfigError."""
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.dashboard.opening import check_installed, source_of, starter_of

    check_installed()
    from liftgate_hil.dashboard.deference import giving_way
    from liftgate_hil.dashboard.listening import bound, new_token, url_of
    from liftgate_hil.dashboard.server import Page
    from liftgate_hil.dashboard.serving import serve

    host, port = address_of(request.listen)
    token = new_token()
    wire = None if request.descriptor is None else socket.socket(fileno=request.descriptor)
    if wire is not None:  # of a run, which is about to begin, and handles signals itself
        put_line(printable(url_of(wire, host, token)), sys.stdout)
    starter, source = starter_of(request), source_of(request, Teller(is_quiet=False).progress)
    with giving_way(), wire or bound((host, port)) as listening:
        page = Page(source, request.read_only, starter, wire is not None)
        address = printable(url_of(listening, host, token))
        serve(page, listening, host, token, lambda: put_line(address, sys.stdout) if wire is None else None)
