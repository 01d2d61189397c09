"""The plant alone, offline, as fast as it goes: a voltage step or measured inputs in, a table out.

It starts unlatched and at rest. A sample of the input holds from its time until the next one.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from functools import partial

from liftgate_hil.cli.command import Call, add_flags, as_flags
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.errors import ConfigError
from liftgate_hil.simulation.request import SimulateRequest

_STDOUT = "-"  # as `output`


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `simulate` to its parser."""
    add_flags(parser, SimulateRequest)


def run(call: Call) -> int:
    """Run the subcommand `simulate` (the plant alone, offline, to a table) and return its exit code."""
    stopped = StopSignals()  # stops between two blocks; what has been simulated is written
    from liftgate_compiler import GivenUpError
    from liftgate_hil.cli.terminal.progress import ProgressDisplay
    from liftgate_hil.cli.terminal.screen import Screen
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.drive.compilation import reporting_compilation
    from liftgate_hil.simulation.simulate import simulated, write_table

    request = call.request(SimulateRequest)
    if str(request.output or _STDOUT) == _STDOUT:
        request = request.replaced(output=None)
        if sys.stdout is None:
            raise ConfigError("`output` -: stdout is closed; allowed: a file")
    teller = Teller(is_quiet=False)
    is_seen = request.output is None and sys.stdout.isatty()  # the table is, so that nothing else can be shown
    progress = ProgressDisplay(Screen(is_off=True), "") if is_seen else teller.progress("simulate")

    def report(time_s: float, duration_s: float) -> None:
        progress.update(time_s, duration_s, f"{time_s:.1f} s of {duration_s:g} s")

    def note(text: str) -> None:
        print(as_flags(f"liftgate-hil simulate: {text}"), file=sys.stderr)

    with progress, reporting_compilation(teller, stopped), contextlib.suppress(GivenUpError):
        found = simulated(request, partial(write_table, sys.stdout.buffer), stopped, report, teller.say, note)
        if found.is_complete:
            if request.output is not None and sys.stderr is not None and sys.stderr.isatty():  # to a person
                teller.say(f"written: {request.output}, {found.rows} rows to {found.time_s:.3f} s")
            return 0
        names = " and ".join(str(name) for name in (request.output or _STDOUT, request.edges) if name)
        print(f"liftgate-hil simulate: {names} {found.remark}", file=sys.stderr)
    return stopped.exit_code
