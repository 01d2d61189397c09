"""The tables [messages.*] of a drafted rig: counters by their names; no database says what a checksum covers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from liftgate_hil.codec.bus_config import counted_range
from liftgate_hil.codec.checksum import KINDS, PROFILES
from liftgate_hil.codec.protection import MessageOptions
from liftgate_hil.codec.sending import SendType, cycle_of, send_type_of
from liftgate_hil.config.drafting.candidates import is_protection
from liftgate_hil.config.drafting.lines import quoted

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal


def checksums_of(message: Message) -> list[Signal]:
    """Return the signals of a message that are checksums by their names."""
    return [signal for signal in message.signals if is_protection(message, signal) == "checksum"]


def counters_of(message: Message) -> list[Signal]:
    """Return the signals of a message that are counters by their names."""
    return [signal for signal in message.signals if is_protection(message, signal) == "counter"]


def open_counters_of(message: Message) -> list[Signal]:
    """Return the counters of a message that its drafted table leaves to choose."""
    counters = counters_of(message)
    return counters if len(counters) > 1 else [each for each in counters if _ends_early(each)]


def _ends_early(counter: Signal) -> bool:
    """Whether the database says that a counter goes less far than its length allows."""
    return counted_range(counter) != (0, 2**counter.length - 1)


def _restricted(counter: Signal) -> str:
    """Return the remark on a counter that goes less far than its length allows."""
    (low, high), most, name = counted_range(counter), 2**counter.length - 1, quoted(counter.name)
    if low > 0:
        table = f"{{ signal = {name}, lowest = {low}, highest = {high} }}"
        return f"goes from {low} to {high}, not from 0 to {most}: counter = {table}"
    table = f"{{ signal = {name}, highest = {high} }}"
    return f"goes to {high}, not to {most}: as it stands with an E2E profile, else counter = {table}"


def protection_lines(message: Message, is_cyclic: bool, is_used: bool) -> list[str]:
    """Return the table of a message; commented out if nothing of the message is mapped yet."""
    counters = counters_of(message)
    lines = []
    if is_cyclic and not 0.0 < cycle_of(message, MessageOptions()) <= 60_000.0:
        is_event = send_type_of(message, MessageOptions()) is SendType.EVENT
        why = "by the database it is sent on events" if is_event else "not in the database"
        lines.append(f"# cycle_ms = 10                         # {why}: fill it in")
    for signal in counters:
        line, why = f"counter = {quoted(signal.name)}", ""
        if len(counters) > 1:
            why = "one of several with such a name"
        elif _ends_early(signal):
            why = _restricted(signal)
        lines.append(f"# {line}  # {why}" if why else line)
    for signal in checksums_of(message):
        lines += _checksum_lines(signal)
    if not lines:
        return []
    head = f"[messages.{quoted(message.name)}]"
    if is_used:
        return ["", head, *lines]
    return ["", *(line if line.startswith("# ") else f"# {line}" for line in (head, *lines))]


def _checksum_lines(signal: Signal) -> list[str]:
    """Return lines with each kind of checksum that has the length of a signal, for the user to choose from."""
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
