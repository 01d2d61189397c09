"""Is this machine fit for real time? Looks at kernel, limits, CPUs, buses and software, measures how late the
emulator's own loop is woken, and says how to mend what isn't ok.

Exit code 0: fit, perhaps with warnings; 1: something makes real time impossible.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from liftgate_hil.cli.command import Call, add_flags, add_printed
from liftgate_hil.doctor.request import DoctorRequest

if TYPE_CHECKING:
    from liftgate_hil.doctor.check import Check


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `doctor` to its parser."""
    add_flags(parser, DoctorRequest)
    add_printed(parser, "print only checks that are not ok", "print checks and figures as JSON")


def run(call: Call) -> int:
    """Run the subcommand `doctor` (is this machine fit for real time?) and return its exit code; 1: it is not."""
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.doctor.examination import DoctorReport, Examination

    request, teller = call.request(DoctorRequest), Teller(call.is_quiet, call.is_json)

    def tell(check: Check) -> None:
        if not call.is_json and (check.level != "ok" or not call.is_quiet):
            with teller.aside():
                print("\n".join(check.lines()), flush=True)

    def say(text: str, seconds: float) -> None:
        if not call.is_json:
            teller.say(text)
        progress.lasts(seconds, "measuring")

    with teller.progress("doctor") as progress:
        found = Examination(request, tell, say)
        found.run()
    if call.is_json:
        print(DoctorReport(not found.problems(), tuple(found.checks), found.figures).to_json(indent=1))
    return 1 if found.problems() else 0
