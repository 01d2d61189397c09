"""Compare two recordings: the first and the largest difference of each column, with times and values, and the
root mean square, at the times that both have; and whether their frames are the same.

Exit code 0: equal within the tolerances, 1: not, 2: they cannot be compared.
"""

from __future__ import annotations

import argparse
import sys

from liftgate_hil.cli.command import Call, add_flags, add_printed
from liftgate_hil.conversion.request import CompareRequest
from liftgate_hil.errors import printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `compare` to its parser."""
    add_flags(parser, CompareRequest)
    add_printed(parser, json="print the differences as JSON")


def run(call: Call) -> int:
    """Run the subcommand `compare` on two recordings and return its exit code; 0: equal, 1: different."""
    request = call.request(CompareRequest)
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.conversion.compare import compared
    from liftgate_hil.conversion.compare_text import comparison_lines

    teller = Teller(call.is_quiet, call.is_json)
    with teller.progress("compare") as progress:
        found = compared(request, lambda text: progress.update(text=text), teller.say)
    for note in [] if call.is_quiet else found.notes:
        print(printable(f"liftgate-hil compare: note: {note}"), file=sys.stderr)
    if call.is_json:
        print(found.to_json(indent=2))
    elif not call.is_quiet:
        written = [] if request.output is None else [f"written: {request.output}"]
        for line in [*comparison_lines(found, (request.first, request.second)), *written]:
            print(printable(line))
    return 0 if found.is_equal else 1
