"""A picture of a recording: columns over time, both drives' in one panel. Bus logs are drawn with --rig.

liftgate-hil plot run.csv
liftgate-hil plot run.mf4 --columns left_current_a,sensed_left_current_a --from 12.3 --to 12.6 --output run.svg
liftgate-hil plot run.blf --rig liftgate --columns Gate.Angle,LeftDrive.MotorCurrent
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli import recordings
from liftgate_hil.errors import printable

if TYPE_CHECKING:
    from liftgate_hil.conversion.table import Window


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    parser.add_argument("recording", metavar="FILE", help="a recording, or a bus log of another tool")
    recordings.add_columns(parser, "angle, currents, pinch force and voltage, or the first few")
    recordings.add_picture(parser, "FILE.png")
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from liftgate_hil.cli.teller import Teller

    window = recordings.window_of(args)
    target = recordings.check_picture(args.output or f"{args.recording}.png", [args.recording])
    with Teller(args.quiet).progress("plot"):
        _draw(args, window, target)
    if not args.quiet:
        print(printable(f"written: {target}"))
    return 0


def _draw(args: argparse.Namespace, window: Window, target: Path) -> None:
    """Draw the recording into the file `target`. Raises ConfigError."""
    from liftgate_hil.conversion import picture
    from liftgate_hil.conversion.table import chosen, columns_in, open_table

    table = open_table(Path(args.recording), args.rig)
    names = chosen(table, recordings.columns_of(args)) or picture.usual_columns(table)
    panels = picture.panels_of(names, table)
    columns = columns_in(table, names, window)
    title = Path(args.recording).name
    units = {name: table.signals[name].unit for name in names}
    figure = picture.run_picture(title, columns, panels, units)
    picture.write_picture(target, figure, title, ", ".join(names))
