"""A folder to start from: database, vehicle, rig, scenario, tests, and an ECU in C with the header of the serial
line, with a README that tells what to do. All of it is a copy, to be changed. In a git repository what is there
is kept.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from liftgate_hil.cli.command import Call, add_printed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `init` to its parser."""
    parser.add_argument(
        "folder", metavar="FOLDER", help="the folder to create; an existing one must be empty or a git repository"
    )
    add_printed(parser)


def run(call: Call) -> int:
    """Run the subcommand `init` (create a folder of files to start from) and return its exit code."""
    from liftgate_hil.config.starter import contents, create_starter, next_steps

    folder = str(call.values["folder"])
    written = create_starter(Path(folder))
    if not call.is_quiet:
        print("\n".join([*contents(folder, written), "", *next_steps(folder)]))
    return 0
