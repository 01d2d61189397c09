"""Is this machine fit for real time? Looks at kernel, limits, CPUs, buses and software, measures how late the
emulator's own loop is woken, and says how to mend what isn't ok.

Exit code 0: fit, perhaps with warnings; 1: something makes real time impossible.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.plan.request import RunRequest

if TYPE_CHECKING:
    from liftgate_hil.doctor.check import Check


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    parser.add_argument(
        "--duration",
        type=options.bounded(0.1, 86_400.0, "s"),
        default=2.0,
        metavar="S",
        help="duration of each lateness measurement; default: 2; an hour shows rare delays",
    )
    options.add_flags(parser, RunRequest, "rate", *options.MACHINE)
    parser.add_argument("--quiet", action="store_true", help="print only checks that are not ok")
    parser.add_argument("--json", action="store_true", help="print checks and figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.doctor.examination import DoctorReport, Examination

    teller = Teller(args.quiet, args.json)

    def tell(check: Check) -> None:
        if not args.json and (check.level != "ok" or not args.quiet):
            with teller.aside():
                print("\n".join(check.lines()), flush=True)

    def say(text: str, seconds: float) -> None:
        if not args.json:
            teller.say(text)
        progress.lasts(seconds, "measuring")

    with teller.progress("doctor") as progress:
        found = Examination(args.rate, args.duration, bool(args.realtime), args.cpu, tell, say)
        found.run()
    if args.json:
        print(DoctorReport(not found.problems(), tuple(found.checks), found.figures).to_json(indent=1))
    return 1 if found.problems() else 0
