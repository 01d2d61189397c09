"""Draft a rig file: certain signals are mapped, the others listed as candidates with the reason."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_compiler.files import write_whole
from liftgate_hil.codec.messages import Messages
from liftgate_hil.config.database import database_file, load_messages
from liftgate_hil.config.drafting.candidates import SignalCandidate, find_candidates
from liftgate_hil.config.drafting.lines import (
    DraftLine,
    line_for,
    open_counters_of,
    protection_lines,
    protections_of,
    quoted,
)
from liftgate_hil.config.drafting.words import named_values
from liftgate_hil.config.files import is_there
from liftgate_hil.config.rig import DEFAULT_BITRATE, rig_of_content
from liftgate_hil.config.signal_name import notes_on_j1939
from liftgate_hil.errors import ConfigError, ConfigIssues, printable
from liftgate_hil.signals import PANEL

if TYPE_CHECKING:
    from cantools.database.can import Message

_MOST_OTHERS = 30  # messages without a drafted signal that are named
_MOST = 12  # candidates of a quantity that are shown
_IF_SENT = {  # remarks on what is sent by a node that is neither the ECU nor the gate
    "inputs": "is it a test bench, and sets this for the gate?",
    "outputs": "use it only if that node is not on the bus",
}
_WANTED = ("left_duty", "left_current", "gate_angle")  # an ECU hardly runs without these


@dataclass
class Draft:
    """A drafted rig: its text, the mapped keys, what has to be filled in by hand (key and reason), and remarks."""

    text: str
    mapped: list[str] = field(default_factory=list)
    open: list[tuple[str, str]] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    file: Path | None = None  # that was written; None: none

    def lines(self) -> list[str]:
        """Return what was mapped, where a file was written, and what remains to be done, as lines of text."""
        mapped = [] if self.file is None else [f"{self.file}: mapped: {', '.join(self.mapped) or 'nothing'}"]
        to_do = [f"to be filled in: {key}: {reason}" for key, reason in self.open]
        return [*mapped, *(f"note: {note}" for note in self.notes), *to_do]


def drafted(database: str, output: str | None) -> Draft:
    """Draft a rig for a database, FILE or FILE#BUS; write it to the new file `output`; None: to none.

    Raises ConfigError.
    """
    path = database_file(database).path
    beside = path.with_suffix(".toml") if path.name else path / "rig.toml"
    target = beside if output is None else Path(output)
    if output is not None and is_there(target):
        raise ConfigError(f"`output` {target}: already exists; allowed: a new file")
    draft = draft_rig(database, target)
    if output is None:
        return draft
    try:
        write_whole(target, draft.text.encode(), is_new=True)
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written: {error.strerror}") from error
    return replace(draft, file=target)


def draft_rig(database: str | Path, target: Path) -> Draft:
    """Draft a rig for a database, FILE or FILE#BUS; the rig file `target` is not written.

    Raises ConfigError.
    """
    file, bus = given = database_file(database)
    issues = ConfigIssues("draft")
    messages = load_messages(issues, given)
    issues.raise_if_any()
    found, not_chosen = find_candidates(messages)
    tells_sides = any("right_" in name for each in found.values() for name in each)
    lines = {section: list(_lines_of(section, _by_side(each, tells_sides))) for section, each in found.items()}
    _one_quantity_a_signal(lines)
    dbc = os.path.relpath(os.path.realpath(file), Path(os.path.realpath(target)).parent)
    dbc += f"#{bus}" if bus else ""
    head = [
        f"# A first rig for {printable(file.name)}, drafted from names, units and senders: check before use.",
        "# Uncertain lines are commented out, each below its reason. `liftgate-hil rig check` shows the mapping.",
        "",
        f"dbc = {quoted(dbc)}",
        f"bitrate = {DEFAULT_BITRATE:<30.0f} # bit/s of the bus",
    ]
    # A line that the rig's own checks refuse becomes a candidate with their reason.
    while True:
        text, faults = _text(head, lines, messages, target)
        if not _withdraw(lines, faults):
            break
    mapped = [f"{line.section}.{line.quantity}" for line in _all(lines) if line.is_sure]
    waiting = {f"{line.section}.{line.quantity}": line.reason for line in _all(lines) if not line.is_sure}
    for name in dict.fromkeys(line.message.name for line in _all(lines) if line.is_sure):
        for signal in protections_of(messages[name], "checksum"):
            reason = f"{signal.name}: the database does not say which; without it wrong frames are accepted"
            waiting[f"messages.{name}.checksum"] = reason
        for signal in open_counters_of(messages[name]):
            waiting[f"messages.{name}.counter"] = f"{signal.name}: how it counts is not certain, see the draft"
    text += "".join(_buttons(lines, messages))
    text += "".join(_not_chosen(not_chosen))
    text += "".join(_unused(text, messages, {line.message.name for line in _all(lines)}, not_chosen))
    used = dict.fromkeys(line.message.name for line in _all(lines))
    notes = (
        *(f"{file}: {note}" for note in messages.notes),
        *notes_on_j1939([messages[each] for each in used], str(file)),
    )
    return Draft(text, mapped, [*waiting.items(), *_missing(faults, waiting, mapped)], notes)


def _buttons(lines: Mapping[str, list[DraftLine]], messages: Mapping[str, Message]) -> Iterator[str]:
    """Yield comments on `[requests]`, and on signals to the ECU that may be a driver's button by their labels."""
    yield "\n# Not drafted: [requests], see docs/rig.md. Without it no request reaches an ECU on a bus.\n"
    commands = [line.message for line in lines["inputs"] if line.quantity.endswith(("_duty", "_direction"))]
    ecus = {sender for message in commands for sender in message.senders}
    mapped = {line.signal for line in _all(lines)}
    for name, message in sorted(messages.items()):
        for signal in [] if ecus & {*message.senders} else message.signals:
            labels = {raw: str(label) for raw, label in (signal.choices or {}).items()}
            has_both = {"open", "close"} <= named_values("direction", labels).keys()
            if has_both and ecus & {*signal.receivers} and f"{name}.{signal.name}" not in mapped:
                said = ", ".join(f"{raw} {label!r}" for raw, label in sorted(labels.items())[:_MOST])
                yield f"#   {printable(f'{name}.{signal.name}')}: a button? labels {printable(said)}\n"


def _not_chosen(signals: Mapping[str, tuple[str, str]]) -> Iterator[str]:
    """Yield comments that list the signals that were not chosen for a quantity, and why."""
    if signals:
        yield "\n# Not drafted: another signal was chosen for the quantity.\n"
    for signal, (quantity, why) in sorted(signals.items())[:_MOST_OTHERS]:
        yield f"#   {printable(signal)}: {quantity}? {printable(why)}\n"
    if len(signals) > _MOST_OTHERS:
        yield f"#   and {len(signals) - _MOST_OTHERS} more\n"


def _unused(text: str, messages: Mapping[str, Message], used: set[str], told: Collection[str]) -> Iterator[str]:
    """Yield comments on signals of `used` messages not in `text` or `told`, other messages, their protection."""
    left = [
        f"{name}.{signal.name}"
        for name in used
        for signal in messages[name].signals
        if quoted(f"{name}.{signal.name}") not in text
        and quoted(signal.name) not in text
        and f"{name}.{signal.name}" not in told
    ]
    if left:
        yield "\n# Not drafted: signals with unknown names. docs/rig.md lists all quantities.\n"
    for each in sorted(left):
        yield f"#   {printable(each)}\n"
    others = [message for name, message in sorted(messages.items()) if name not in used]
    if others:
        names = [printable(message.name) for message in others[:_MOST_OTHERS]]
        more = f" and {len(others) - len(names)} more" if len(others) > len(names) else ""
        yield f"# Messages without a drafted signal: {', '.join(names)}{more}.\n"
    named = others[:_MOST_OTHERS]
    tables = [line for message in named for line in protection_lines(message, is_cyclic=False, is_used=False)]
    if tables:
        yield "# Counters and checksums of these, for what the bench sends as restbus:\n"
        yield "\n".join(tables) + "\n"


def _all(lines: Mapping[str, list[DraftLine]]) -> list[DraftLine]:
    return [line for each in lines.values() for line in each]


def _by_side(found: Mapping[str, list[SignalCandidate]], tells_sides: bool) -> dict[str, list[SignalCandidate]]:
    """Return candidates by quantity; those of unknown side go to the left drive or both, unless a side is known.

    A single candidate goes to the left drive, the only one of some gates. Several go to both drives, and so does a
    single one of a database that distinguishes sides.
    """
    result: dict[str, list[SignalCandidate]] = {}
    for quantity, candidates in found.items():
        head, is_either, rest = quantity.rpartition("either_")
        left, right = f"{head}left_{rest}", f"{head}right_{rest}"
        if not is_either:
            result[quantity] = candidates
        elif left in found or right in found:
            continue
        elif len(candidates) == 1 and not tells_sides:
            result[left] = candidates
        else:
            result[left] = result[right] = candidates
    return result


def _lines_of(section: str, found: Mapping[str, list[SignalCandidate]]) -> Iterator[DraftLine]:
    """Yield the lines of a section, at most _MOST a quantity; doubtful ones are commented out, with the reason."""
    for quantity, candidates in found.items():
        for candidate in candidates[:_MOST]:
            line = line_for(section, quantity, candidate)
            if candidate.sender:
                line = line.withdrawn(f"sent by {candidate.sender}: {_IF_SENT[section]}")
            if len(candidates) > 1:
                line = line.withdrawn(f"one of {len(candidates)} candidates")
            elif "either_" in candidate.quantity and candidate is not _only(found, quantity):
                line = line.withdrawn("which drive?")
            yield line


def _only(found: Mapping[str, list[SignalCandidate]], quantity: str) -> SignalCandidate | None:
    """Return the first candidate of a quantity; None if the other drive has the same candidates."""
    other = quantity.replace("left_", "right_") if "left_" in quantity else quantity.replace("right_", "left_")
    return None if found.get(other) == found[quantity] else found[quantity][0]


def _one_quantity_a_signal(lines: dict[str, list[DraftLine]]) -> None:
    """Comment out all lines that map the same signal to several quantities, as none is certain."""
    for section, each in lines.items():
        for i, line in enumerate(each):
            others = [other.quantity for other in each if other.signal == line.signal]
            if line.is_sure and len(set(others)) > 1:
                names = ", ".join(name for name in others if name != line.quantity)
                lines[section][i] = line.withdrawn(f"may also be {names}")


def _text(
    head: list[str], lines: Mapping[str, list[DraftLine]], messages: Messages, target: Path
) -> tuple[str, dict[str, str]]:
    """Return the drafted file's text, and why a rig read from it is refused: reasons by key."""
    parts = list(head)
    for section, each in lines.items():
        parts += ["", f"[{section}]"]
        for line in each:
            parts += line.text()
    used = dict.fromkeys((line.message.name, line.section) for line in _all(lines))
    sure = {line.message.name for line in _all(lines) if line.is_sure}
    for name, section in used:
        is_cyclic = section == "outputs" or not all(
            line.quantity in PANEL for line in _all(lines) if line.message.name == name
        )
        parts += protection_lines(messages[name], is_cyclic, is_used=name in sure)
    text = "\n".join(parts) + "\n"
    _, issues = rig_of_content(tomllib.loads(text), target, messages)
    faults = {}
    for issue in issues.lines:
        key, _, reason = issue.removeprefix(f"{issues.source}: ").partition(": ")
        faults[key] = reason
    return text, faults


def _withdraw(lines: dict[str, list[DraftLine]], faults: Mapping[str, str]) -> bool:
    """Comment out the lines of a draft that are refused; return whether there were any."""
    is_changed = False
    for each in lines.values():
        for i, line in enumerate(each):
            key = f"{line.section}.{line.quantity}"
            reason = next(
                (
                    issue
                    for at, issue in faults.items()
                    if at == key
                    or at.startswith(f"{key}.")
                    or at in (line.quantity, f"{line.quantity}.values")
                    or at == f"{line.section} in {line.message.name}"
                ),
                "",
            )
            if line.is_sure and reason:
                each[i] = line.withdrawn(reason)
                is_changed = True
    return is_changed


def _missing(
    faults: Mapping[str, str], waiting: Mapping[str, str], mapped: list[str]
) -> Iterator[tuple[str, str]]:
    """Yield key and reason of each entry that the drafted rig lacks, or hardly works without."""
    for key, reason in faults.items():
        if key not in waiting:
            yield key, reason
    for quantity in _WANTED:
        key = f"{'inputs' if quantity == 'left_duty' else 'outputs'}.{quantity}"
        if key not in (*mapped, *waiting, *faults):
            yield key, "no signal in the database has a matching name"
