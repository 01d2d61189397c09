"""A script that lets a shell complete subcommands, flags, files, and the names of shipped vehicles, rigs and
scenarios. It is static: completing starts no Python. It is made anew after an update.
"""

from __future__ import annotations

import argparse

from liftgate_hil.cli.command import Call

SHELLS = ("bash", "zsh", "fish")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `completion` to its parser."""
    parser.add_argument("shell", choices=SHELLS, help="print the script for this shell")


def run(call: Call) -> int:
    """Run the subcommand `completion` (print a shell's completion script) and return its exit code."""
    from liftgate_hil.cli.completion_script import script

    print(script(call.values["shell"]))
    return 0
