"""How a gate is wired: `check` shows what a rig maps and says what is wrong with it, `draft` writes a first rig
for somebody else's database.

Exit code 0: the rig fits the vehicle and the rate; 2: it doesn't, or cannot be read.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli.command import Call, add_flags
from liftgate_hil.config.files import is_there
from liftgate_hil.errors import ConfigError, printable
from liftgate_hil.plan.request import RigCheckRequest

if TYPE_CHECKING:
    from liftgate_hil.config.rig_table import MappedMessage, MappedSignal
    from liftgate_hil.diagnostics.tester import Diagnostics

_MOST_UNMAPPED = 12  # signals of a message without a quantity that are named


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

    path, request = find_config("rigs", file, "FILE"), call.request(RigCheckRequest)
    with Teller(is_quiet=False, is_json=call.is_json).progress(f"reading {printable(path.name)}"):
        found = checked_rig(path, request)
    if call.is_json:
        print(found.to_json(indent=1))
    else:
        lines = _lines(found.messages)
        lines += [f"restbus {name}; protection: {how}" for name, how in found.restbus_protection.items()]
        lines += _diagnostics_lines(found.diagnostics)
        lines += [f"request {action} on a bus: {how}" for action, how in found.requests.items()]
        lines += [f"inject {what} by {how}" for what, how in found.inject.items()]
        lines += [f"note: {note}" for note in found.notes]
        for line in lines:
            print(printable(line))
    if found.issues:
        raise ConfigError(list(found.issues))
    if not call.is_json:
        print(f"{path}: fits {found.vehicle} at {found.rate:g} Hz")


def _lines(messages: list[MappedMessage]) -> list[str]:
    """Return the table of mapped messages: one line per message, and below it one line per quantity."""
    from liftgate_hil.codec.sending import SendType

    lines = []
    for each in messages:
        cycle = f", every {each.cycle_ms:g} ms" if each.cycle_ms else ""
        cycle += f", {each.send_type}" if each.send_type != SendType.CYCLIC.value else ""
        cycle += f", {each.pages} multiplexer values in turn" if each.pages > 1 else ""
        stale = f", stale after {each.timeout_ms:g} ms" if each.timeout_ms else ""
        digits, form = 8 if each.is_extended else 3, f", {each.format}" if each.format != "classic" else ""
        called = f"{each.direction} {each.message} 0x{each.identifier:0{digits}X}"
        lines.append(f"{called}, {each.length} bytes{form}{cycle}{stale}; protection: {each.protection}")
        rows = [_cells(signal) for signal in each.signals]
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        lines += ["    " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        if each.unmapped:
            shown = [f"{name} = {value}" if value else name for name, value in each.unmapped.items()]
            how = "not read" if each.direction == "received" else "sent as"
            more = f" and {len(shown) - _MOST_UNMAPPED} more" if len(shown) > _MOST_UNMAPPED else ""
            lines.append(f"    not mapped, {how}: {', '.join(shown[:_MOST_UNMAPPED])}{more}")
    return lines


def _diagnostics_lines(own: Diagnostics | None) -> list[str]:
    """Return a list with the line on how the ECU's trouble codes are read; empty without [diagnostics]."""
    from liftgate_hil.codec.frames import EXTENDED

    if own is None:
        return []
    request, response = (
        f"{name} 0x{number & ~EXTENDED:0{8 if number & EXTENDED else 3}X}".lstrip()
        for name, number in zip(own.names, (own.request, own.response), strict=True)
    )
    cleared = "cleared at time 0, " if own.clears else ""
    return [
        f"diagnostics: request {request}, response {response}; {cleared}read every {1e3 * own.period:g} ms by the "
        f"status mask 0x{own.status_mask:02X}"
    ]


def _cells(signal: MappedSignal) -> tuple[str, ...]:
    step = f" in steps of {signal.step:.4g}" if signal.step else ""
    is_same = signal.database_unit == signal.unit
    units = f"[{signal.database_unit}]{'' if is_same else f' -> [{signal.unit}]'}"
    return (
        signal.quantity,
        signal.signal,
        units,
        f"{signal.low:.6g} to {signal.high:.6g}{' ' + signal.unit if signal.unit else ''}{step}",
        signal.conversion,
    )


def _draft(given: str, output: str | None) -> None:
    from liftgate_compiler.files import write_whole
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.config.database import database_file
    from liftgate_hil.config.drafting.draft import draft_rig

    database = database_file(given).path
    beside = database.with_suffix(".toml") if database.name else database / "rig.toml"
    is_file = output is not None and output != "-"
    target = Path(output) if is_file and output is not None else beside
    if is_file and is_there(target):
        raise ConfigError(f"`output` {target}: already exists; allowed: a new file")
    with Teller(is_quiet=False).progress(f"reading {printable(database.name)}"):
        draft = draft_rig(given, target)
    if is_file:
        try:
            write_whole(target, draft.text.encode(), is_new=True)
        except OSError as error:
            raise ConfigError(f"{target}: cannot be written: {error.strerror}") from error
    else:
        print(draft.text, end="")
    lines = [f"{target}: mapped: {', '.join(draft.mapped) or 'nothing'}"] if is_file else []
    lines += [f"note: {note}" for note in draft.notes]
    lines += [f"to be filled in: {key}: {reason}" for key, reason in draft.open]
    for line in lines:
        print(printable(line), file=sys.stderr)
