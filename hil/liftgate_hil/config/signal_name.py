"""Signal names MESSAGE.SIGNAL by which files and programs refer to the database; notes on J1939 messages."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING

from liftgate_hil.codec.messages import Messages
from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigIssues

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can import Signal as DatabaseSignal

_MOST_NAMES = 20  # names that a message lists


def find_signal(
    issues: ConfigIssues,
    key: str,
    name: str,
    messages: Messages,
    offered: Collection[str] | None = None,
    left_out: Collection[str] = (),
) -> DatabaseSignal | None:
    """Return the database's signal with the name MESSAGE.SIGNAL; None and an issue under `key` if unknown.

    The issue lists the messages that are `offered` (None: all), or the signals of the message without `left_out`.
    """
    message_name, _, signal_name = name.partition(".")
    message = messages.get(message_name)
    if why_not := messages.why_not(message_name):
        issues.add(key, f"{show(name)}: {why_not}")
        return None
    if message is None:
        names = listed(sorted(messages if offered is None else offered))
        issues.add(key, f"{show(name)}: no such message; allowed: MESSAGE.SIGNAL of {names}")
        return None
    for each in message.signals:
        if each.name == signal_name:
            return each
    issues.add(key, f"{show(name)}: no such signal; allowed: {listed_signals(message, left_out)}")
    return None


def listed_signals(message: Message, left_out: Collection[str] = ()) -> str:
    """Return the names of a message's signals, without `left_out`, as a text."""
    names = [each.name for each in message.signals if each.name not in left_out]
    return f"{message.name}.{{{listed(names)}}}"


def listed(names: Sequence[str]) -> str:
    """Return names as a text; of many, only the first ones."""
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return f"{', '.join(names[:_MOST_NAMES])}{more}" or "none"


_NULL_ADDRESS = 0xFE  # SAE J1939-81: of a control unit that has not claimed an address
_PDU1 = 0xF0  # SAE J1939-21: below it the PDU specific byte is the destination's address


def notes_on_j1939(messages: Iterable[Message], source: str) -> list[str]:
    """Return a note that J1939 messages are matched by their whole identifier, not their PGN; [] without any."""
    found = [each for each in messages if each.protocol == "j1939"]
    if not found:
        return []
    named = listed([f"{each.name} (0x{each.frame_id:08X}, {_addresses(each.frame_id)})" for each in found])
    nobody = any(each.frame_id & 0xFF == _NULL_ADDRESS for each in found)
    hint = "; the sender 0xFE is a placeholder of databases" if nobody else ""
    return [
        f"{source}: J1939: messages are matched and sent by their whole identifier with priority and addresses, "
        f"not by their PGN: {named}{hint}; for a control unit with another address the database needs its "
        "identifiers"
    ]


def _addresses(identifier: int) -> str:
    """Return the PGN and the addresses of an identifier of 29 bits as text."""
    group, sender = (identifier >> 8) & 0x3FFFF, identifier & 0xFF
    if (group >> 8) & 0xFF >= _PDU1:
        return f"PGN {group} from 0x{sender:02X}"
    return f"PGN {group & 0x3FF00} from 0x{sender:02X} to 0x{group & 0xFF:02X}"
