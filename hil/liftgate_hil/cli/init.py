"""A folder to start from: database, vehicle, rig, scenario, tests, and an ECU in C with the header of the serial
line, with a README that tells what to do. All of it is a copy, to be changed. In a git repository what is there
is kept.
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import sys
from collections.abc import Sequence
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
    from liftgate_hil.config.starter import create_starter

    folder = str(call.values["folder"])
    written = create_starter(Path(folder))
    if not call.is_quiet:
        print("\n".join([*_contents(folder, written), "", *_next_steps(folder)]))
    return 0


def _contents(folder: str, written: Sequence[Path]) -> list[str]:
    """Return the list of created files, one line for each folder."""
    names: dict[Path, list[str]] = {}
    for path in written:
        names.setdefault(Path(folder, path.parent), []).append(path.name)
    return [f"written: {parent}: {', '.join(each)}" for parent, each in names.items()]


def _next_steps(folder: str) -> list[str]:
    """Return the next steps: the commands of the new folder's README, with the folder's name and this Python."""
    from liftgate_hil.config.starter import starter_readme

    heading = ""
    program, pytest, make = "liftgate-hil", "python -m pytest", "make -C ecu"
    python = Path(sys.executable)
    if Path(shutil.which("python3") or "").parent != python.parent:
        # The environment is not activated: PATH leads to another Python, without this package.
        quoted = shlex.quote(str(python))
        program, pytest = f"{quoted} -m liftgate_hil", f"{quoted} -m pytest"
        make += f" PYTHON={quoted}"
    instead = {"liftgate-hil": program, "python -m pytest": pytest, "make -C ecu": make}
    steps = ["next:", f"  cd {shlex.quote(folder)}"]
    for line in starter_readme().read_text(encoding="utf-8").splitlines():
        step = line.removeprefix("    ")
        if line.startswith("## "):
            heading = line.removeprefix("## ")
        elif step != line:
            if heading:
                steps += ["", f"  # {heading}"]
                heading = ""
            start = next((each for each in instead if step.startswith(each)), "")
            steps.append(f"  {instead.get(start, start)}{step.removeprefix(start)}")
    return steps
