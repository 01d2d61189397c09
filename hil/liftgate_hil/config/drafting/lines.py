"""Lines of a drafted rig: quantities whose signals are certain, and tables [messages.*] by signal names."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from liftgate_hil.codec.bus_config import counted_range, physical_range
from liftgate_hil.codec.checksum import KINDS, PROFILES
from liftgate_hil.codec.protection import MessageOptions
from liftgate_hil.codec.sending import SendType, cycle_of, send_type_of
from liftgate_hil.config.drafting.candidates import SignalCandidate, is_protection
from liftgate_hil.config.drafting.words import concepts_in, named_values, words_of
from liftgate_hil.config.units import allowed_units, conversion, dimension_of
from liftgate_hil.errors import printable
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS, TRUE_PREFIX

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

# Kinds of enumerations, see `LABELS`, by how their quantities end.
_ENUMERATIONS = {
    "direction": "direction", "latch_release": "latch_release", "latch_state": "latch_state",
    "pinch_strip": "switch", "handle_pulled": "switch", "button_pressed": "switch",
}  # fmt: skip
# Words that say what a switch is at 1.
_ACTUATED = {"pulled", "gezogen", "pressed", "gedrueckt", "betaetigt", "actuated", "active", "aktiv"}
_NEGATED = {"not", "nicht", "no", "un"}  # then 1 is the opposite
_STEPS = re.compile(r"(?P<size>\d+\.\d+)\s*(?P<unit>\D.*)")  # a unit with the size of a step before it
# Step of a signal, in our unit, that no database of a gate has: the unit must be another one.
_COARSE = {"A": 0.9, "V": 0.9, "deg": 4.0, "°C": 10.0, "rev/s": 20.0}
_NO_VALUE = {
    "sna", "invalid", "error", "fehler", "reserved", "reserviert", "unknown", "unbekannt", "init", "default", "na",
    "fault", "undefined", "ungueltig", "unused",
}  # fmt: skip


@dataclass(frozen=True)
class DraftLine:
    """A line `quantity = …` of a drafted rig; with a reason it is commented out."""

    section: str
    quantity: str
    message: Message
    signal: str  # MESSAGE.SIGNAL
    keys: Mapping[str, str]  # keys besides the signal, with values in TOML
    reason: str = ""
    remark: str = ""

    @property
    def is_sure(self) -> bool:
        """Whether the line maps the quantity, i.e. is not commented out."""
        return not self.reason

    def withdrawn(self, reason: str) -> DraftLine:
        """Return a copy of the line with a reason added, which comments it out."""
        return replace(self, reason="; ".join(filter(None, (self.reason, reason))))

    def text(self) -> list[str]:
        """Return the line as it is written to the file, perhaps as several lines."""
        value = quoted(self.signal)
        if self.keys:
            rest = "".join(f", {key} = {value}" for key, value in self.keys.items())
            value = f"{{ signal = {value}{rest} }}"
        line = f"{self.quantity} = {value}"
        if self.is_sure:
            return [line + (f"  # {printable(self.remark)}" if self.remark else "")]
        return [f"# {self.quantity}: {printable(self.reason)}", f"# {line}"]


def quoted(text: str) -> str:
    """Return a text as a quoted TOML string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def line_for(section: str, quantity: str, candidate: SignalCandidate) -> DraftLine:
    """Return the line that maps a quantity (`section`: inputs, outputs) to a signal; commented out if in doubt.

    The line is commented out, with the reason, if the signal's unit, labels or range leave a doubt.
    """
    ours = (BUS_INPUTS if section == "inputs" else BUS_OUTPUTS)[quantity]
    line = DraftLine(section, quantity, candidate.message, candidate.name, {})
    if ours.values:
        return _enumeration(line, candidate.signal, ours.values)
    if quantity.endswith("hall_speed"):
        return line.withdrawn("this quantity is in counts per sample period of the vehicle's sensors")
    if quantity.endswith("_duty") and not candidate.unit and section == "inputs":
        return _share_by_range(line, candidate.signal)
    factors = conversion(ours, candidate.unit)
    if factors is None and dimension_of(ours) == "number" and not candidate.unit:
        factors = (1.0, 0.0)
    low, high = physical_range(candidate.signal)
    if factors is None:
        text = f"{candidate.unit!r} is not one of its units" if candidate.unit else "no unit in the database"
        reason = f"{text} ({low:g} to {high:g}); one of {allowed_units(ours)}"
        steps = _STEPS.fullmatch(candidate.unit)  # 0.1%
        if steps is not None and conversion(ours, steps["unit"]) is not None:
            keys = {"scale": steps["size"], "unit": quoted(steps["unit"])}
            return replace(line, keys=keys).withdrawn(f"{text} ({low:g} to {high:g}); in steps of that?")
        return replace(line, keys={"unit": '"?"'}).withdrawn(reason)
    step = abs(factors[0] * float(candidate.signal.scale))
    if step >= _COARSE.get(ours.unit, 1e300) and not candidate.signal.is_float:
        return line.withdrawn(
            f"steps of {step:g} {ours.unit} in the database's {candidate.unit!r} ({low:g} to {high:g}): is that "
            "its unit?"
        )
    if quantity.endswith("_duty") and not candidate.signal.is_float and not 20.0 <= factors[0] * high <= 500.0:
        return line.withdrawn(f"{low:g} to {high:g} in {candidate.unit!r}: is that its unit?")
    if quantity.endswith("_edge_age"):  # it grows without limit while the motor stands
        line = replace(line, keys={"saturates": "true"})
    remarks = [] if factors == (1.0, 0.0) else [f"from {candidate.unit}"]
    if quantity.startswith(TRUE_PREFIX):
        plain = quantity.removeprefix(TRUE_PREFIX)
        sensed = plain if plain in BUS_OUTPUTS else plain.replace("_speed", "_period_speed")  # by Hall edges
        instead = f"; as sensed: {sensed}" if sensed in BUS_OUTPUTS else ""
        remarks.append(f"the true value, without sensor and sensor faults{instead}")
    return replace(line, remark="; ".join(remarks))


def _share_by_range(line: DraftLine, signal: Signal) -> DraftLine:
    """Complete a duty's line without unit by its range: up to 100 is %, up to 1 a share; else comment it out."""
    low, high = physical_range(signal)
    for top, unit in ((100.0, "%"), (1.0, "1")):
        is_fine = signal.is_float or abs(float(signal.scale)) <= 0.1 * top
        if high == top and low in (0.0, -top) and is_fine:
            remark = f"no unit in the database, its range is {low:g} to {high:g}"
            return replace(line, keys={"unit": quoted(unit)}, remark=remark)
    scale = f"{100.0 / high:.6g}" if 0.0 < high < 1e9 else "1.0"
    return replace(line, keys={"scale": scale}).withdrawn(
        f"no unit in the database ({low:g} to {high:g}); scale if {high:g} is 100 %"
    )


def _enumeration(line: DraftLine, signal: Signal, ours: tuple[str, ...]) -> DraftLine:
    """Complete the line of an enumeration by labels, or a one-bit signal's name; comment it out if unsure."""
    kind = next((kind for end, kind in _ENUMERATIONS.items() if line.quantity.endswith(end)), "")
    choices = {int(raw): str(label) for raw, label in (signal.choices or {}).items()}
    labels = {label.casefold() for label in choices.values()}
    if choices and all(name in labels for name in ours):
        return line
    asked = "{ " + ", ".join(f'{name} = "?"' for name in ours) + " }"
    if not kind:
        return replace(line, keys={"values": asked}).withdrawn("unknown labels")
    if not choices:
        values = _flag(line, signal, kind)
        keys = {"values": values or asked}
        remark = "no labels in the database, values derived from its name"
        line = replace(line, keys=keys, remark=remark)
        return line if values else line.withdrawn("no labels in the database; values by number")
    named = named_values(kind, choices)
    left = [
        label for label in choices.values() if label not in named.values() and not _NO_VALUE & {*words_of(label)}
    ]
    pairs = [f"{name} = {quoted(named.get(name, '?'))}" for name in ours]
    known = [pair for pair, name in zip(pairs, ours, strict=True) if name in named]
    needed = ("open", "close") if kind == "direction" else ours
    # An output needs all of our values; its labels that are never sent do not matter.
    is_sure = all(name in named for name in needed) and not (left and line.section == "inputs")
    if not is_sure:
        text = ", ".join(f"{raw} {label!r}" for raw, label in sorted(choices.items())[:16])
        return replace(line, keys={"values": "{ " + ", ".join(pairs) + " }"}).withdrawn(f"labels {text}")
    return replace(line, keys={"values": "{ " + ", ".join(known) + " }"})


def _flag(line: DraftLine, signal: Signal, kind: str) -> str:
    """Return the TOML `values` of a one-bit signal whose name tells what 1 means; "" if it does not."""
    concepts = concepts_in(signal.name)
    words = {*words_of(signal.name)}
    if signal.length != 1 or words & _NEGATED:
        return ""
    if kind == "latch_release" and "release" in concepts:
        return "{ hold = 0, release = 1 }"
    if kind == "switch":
        return "{ off = 0, on = 1 }" if words & _ACTUATED else ""
    whole = "".join(words_of(signal.name))
    is_shut = (
        any(each in whole for each in ("latched", "closed", "locked", "verriegelt", "hauptrast"))
        and "un" not in whole
    )
    is_open = bool(words & {"open", "offen", "unlatched", "unlocked", "entriegelt"})
    if kind == "latch_state" and is_shut != is_open:
        return "{ open = 0, latched = 1 }" if is_shut else "{ open = 1, latched = 0 }"
    return ""


def protections_of(message: Message, what: str) -> list[Signal]:
    """Return a message's signals that are of the type `what`, "counter" or "checksum", by their names."""
    return [signal for signal in message.signals if is_protection(message, signal) == what]


def open_counters_of(message: Message) -> list[Signal]:
    """Return a message's counters whose settings its drafted table leaves to the user."""
    counters = protections_of(message, "counter")
    return counters if len(counters) > 1 else [each for each in counters if _is_restricted(each)]


def _is_restricted(counter: Signal) -> bool:
    """Whether the database limits a counter's range to less than its length in bits allows."""
    return counted_range(counter) != (0, 2**counter.length - 1)


def _remark_on_range(counter: Signal) -> str:
    """Return the remark that a counter's range in the database is less than its length allows, as it is."""
    (low, high), most, name = counted_range(counter), 2**counter.length - 1, quoted(counter.name)
    if low > 0:
        table = f"{{ signal = {name}, lowest = {low}, highest = {high} }}"
        return f"goes from {low} to {high}, not from 0 to {most}: counter = {table}"
    table = f"{{ signal = {name}, highest = {high} }}"
    return f"goes to {high}, not to {most}: as it stands with an E2E profile, else counter = {table}"


def protection_lines(message: Message, is_cyclic: bool, is_used: bool) -> list[str]:
    """Return the lines of [messages.NAME]: cycle, counter, checksum; commented out if nothing of it is mapped."""
    counters = protections_of(message, "counter")
    lines = []
    if is_cyclic and not 0.0 < cycle_of(message, MessageOptions()) <= 60_000.0:
        is_event = send_type_of(message, MessageOptions()) is SendType.EVENT
        why = "by the database it is sent on events" if is_event else "not in the database"
        lines.append(f"# cycle_ms = 10                         # {why}: fill it in")
    for signal in counters:
        line, why = f"counter = {quoted(signal.name)}", ""
        if len(counters) > 1:
            why = "one of several with such a name"
        elif _is_restricted(signal):
            why = _remark_on_range(signal)
        lines.append(f"# {line}  # {why}" if why else line)
    for signal in protections_of(message, "checksum"):
        lines += _checksum_lines(signal)
    if not lines:
        return []
    head = f"[messages.{quoted(message.name)}]"
    if is_used:
        return ["", head, *lines]
    return ["", *(line if line.startswith("# ") else f"# {line}" for line in (head, *lines))]


def _checksum_lines(signal: Signal) -> list[str]:
    """Return commented-out lines with the kinds of checksum as long as a signal, for the user to choose from."""
    name = quoted(signal.name)
    kinds = ", ".join(kind for kind in KINDS if kind != "none")
    own = (
        f"# checksum = {{ signal = {name}, width = {signal.length}, polynomial = 0x?, start = 0x?, "
        'final_xor = 0x?, covers = ["payload", "data_id"], data_id = 0x? }'
    )
    if signal.length != 8:
        return [f"{own}  # the database does not say; or protection = one of {', '.join(PROFILES)}"]
    return [
        f"# checksum = {name}  # the database does not say which:",
        f'# checksum_kind = "crc8-sae-j1850"  # one of {kinds}; or protection = one of {", ".join(PROFILES)}',
        f"{own}  # or the maker's own",
    ]
