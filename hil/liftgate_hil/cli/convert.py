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

from liftgate_hil.cli.command import Call, add_flags, add_printed
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.conversion.request import ConvertRequest
from liftgate_hil.errors import number_of, printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `convert` to its parser."""
    add_flags(parser, ConvertRequest)
    add_printed(parser)


def run(call: Call) -> int:
    """Run the subcommand `convert` (a recording to another format) and return its exit code."""
    stopped = StopSignals()  # stops between two blocks; an unfinished file is removed
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.conversion.convert import converted
    from liftgate_hil.formats.target import set_aside_text

    request = call.request(ConvertRequest)
    with Teller(call.is_quiet).progress("convert") as progress:

        def tell(rows: int, frames: int) -> None:
            progress.update(text=f"{rows} rows, {frames} frames")

        done = converted(request, stopped, tell)
    if not done.is_complete:
        print(f"liftgate-hil convert: {stopped.name}: {request.target} is not written", file=sys.stderr)
        return stopped.exit_code
    if not call.is_quiet:
        for note in done.notes:
            print(printable(f"{request.source}: {note}"), file=sys.stderr)
        if done.aside is not None:
            print(printable(set_aside_text(Path(request.target), done.aside)), file=sys.stderr)
        counts = {"row": done.rows, "frame": done.frames, "mark": done.marks}
        what = [number_of(n, name) for name, n in counts.items() if n]
        print(printable(f"{request.target}: {', '.join(what) or 'nothing'}"))
    return 0
