"""How a gate is wired: `check` shows what a rig maps and says what is wrong with it, `draft` writes a first rig
for somebody else's database.

Exit code 0: the rig fits the vehicle and the rate; 2: it doesn't, or cannot be read.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from liftgate_hil.cli.command import Call, add_flags
from liftgate_hil.errors import ConfigError, printable
from liftgate_hil.plan.request import RigCheckRequest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of both actions to the parser."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="check|draft")
    check = actions.add_parser(
        "check",
        allow_abbrev=False,
        help="what a rig maps, and whether it fits",
        description="What a rig maps, and whether it fits.",
    )
    check.add_argument("file", metavar="FILE", help="a rig, or the name of a shipped one")
    add_flags(check, RigCheckRequest)
    check.add_argument("--json", action="store_true", help="print the table as JSON")
    draft = actions.add_parser(
        "draft",
        allow_abbrev=False,
        help="a first rig for a database",
        description="A first rig for a database: certain signals are mapped, uncertain ones are left to choose.",
    )
    draft.add_argument(
        "database", metavar="DBC", help="the database: DBC, ARXML, KCD or SYM; of one with several buses FILE#BUS"
    )
    draft.add_argument("--output", metavar="FILE", help="the file to write; default, and with -: stdout")


def run(call: Call) -> int:
    """Run `rig check` (what a rig maps, if it fits) or `rig draft` (a first rig) and return the exit code."""
    if call.values["action"] == "draft":
        _draft(call.values["database"], call.values["output"])
    else:
        _check(call.values["file"], call)
    return 0


def _check(file: str, call: Call) -> None:
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.config.shipped import find_config
    from liftgate_hil.plan.rig_check import checked_rig
    from liftgate_hil.plan.rig_text import rig_lines

    path, request = find_config("rigs", file, "FILE"), call.request(RigCheckRequest)
    with Teller(is_quiet=False, is_json=call.is_json).progress(f"reading {printable(path.name)}"):
        found = checked_rig(path, request)
    if call.is_json:
        print(found.to_json(indent=1))
    else:
        for line in rig_lines(found):
            print(printable(line))
    if found.issues:
        raise ConfigError(list(found.issues))
    if not call.is_json:
        print(f"{path}: fits {found.vehicle} at {found.rate:g} Hz")


def _draft(given: str, output: str | None) -> None:
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.config.drafting.draft import drafted

    with Teller(is_quiet=False).progress(f"reading {printable(Path(given).name)}"):
        draft = drafted(given, None if output == "-" else output)
    if output in (None, "-"):
        print(draft.text, end="")
    for line in draft.lines():
        print(printable(line), file=sys.stderr)
