"""Convert a recording into another format, by the suffix of OUT_FILE. Every value and every frame is kept as it
was. What OUT_FILE cannot hold is left out and reported; if it could hold something only in another form, nothing
is written.

With --rig there is a row for each time at which a frame arrived; a signal has the value of its message's last
frame.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from liftgate_hil.cli.options import add_flags, given_in
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.conversion.request import ConvertRequest
from liftgate_hil.errors import number_of, printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    add_flags(parser, ConvertRequest)
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    stopped = StopSignals()  # stops between two blocks; an unfinished file is removed
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.conversion.convert import converted
    from liftgate_hil.formats.target import set_aside_text

    request = ConvertRequest.of(**given_in(args, ConvertRequest))
    with Teller(args.quiet).progress("convert") as progress:

        def tell(rows: int, frames: int) -> None:
            progress.update(text=f"{rows} rows, {frames} frames")

        done = converted(request, stopped, tell)
    if not done.is_complete:
        print(f"liftgate-hil convert: {stopped.name}: {args.target} is not written", file=sys.stderr)
        return stopped.exit_code
    if not args.quiet:
        for note in done.notes:
            print(printable(f"{args.source}: {note}"), file=sys.stderr)
        if done.aside is not None:
            print(printable(set_aside_text(Path(args.target), done.aside)), file=sys.stderr)
        counts = {"row": done.rows, "frame": done.frames, "mark": done.marks}
        what = [number_of(n, name) for name, n in counts.items() if n]
        print(printable(f"{args.target}: {', '.join(what) or 'nothing'}"))
    return 0
