"""Notes on J1939 messages, which are matched by their whole identifier here, not by their PGN."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from liftgate_hil.config.signal_name import listed

if TYPE_CHECKING:
    from cantools.database.can import Message

_NULL_ADDRESS = 0xFE  # SAE J1939-81: of a control unit that has not claimed an address
_PDU1 = 0xF0  # SAE J1939-21: below it the PDU specific byte is the destination's address


def notes_on_j1939(messages: Iterable[Message], source: str) -> list[str]:
    """Return a note on the J1939 messages among these, in a list: which addresses their identifiers have."""
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
