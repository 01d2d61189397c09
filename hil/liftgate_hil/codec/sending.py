"""Send properties of messages by database and rig: cycle, time-out, send type, frame flags."""

from __future__ import annotations

import enum
import re
from typing import TYPE_CHECKING, Any

from liftgate_hil.codec.frames import BRS, FD, LENGTHS
from liftgate_hil.codec.protection import MessageOptions

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

LONGEST_MS = 60_000.0  # longest cycle of a message


class SendType(enum.Enum):
    """Send type of a message by its database: cyclic, cyclic while active, on events."""

    CYCLIC = "cyclic"
    IF_ACTIVE = "cyclic while active"
    EVENT = "on events"


# Parts of the names that makers give to values of GenMsgSendType and GenSigSendType: those of Vector's CANdb++
# (cyclic, spontaneous, cyclicIfActive, IfActive, OnWrite, OnChange, NoMsgSendType), and of others (FixedPeriodic,
# Event, EnabledPeriodic, cyclicWithRepeatOnDemand, spontanX, BAF).
_CYCLIC = re.compile(r"cycl|period|zykl")
_NOT_CYCLIC = re.compile(r"acycl|azykl|aperiod|no[nt]?cycl|no[nt]?period")
_EVENT = re.compile(r"spontan|event|change|write|demand|request|trigger")
_ACTIVE = re.compile(r"active|aktiv|enabled|^baf$")


def send_type_of(message: Message, options: MessageOptions) -> SendType:
    """Return a message's send type: cyclic if the rig states a cycle, else by the message or its signals.

    In a DBC these state GenMsgSendType and GenSigSendType. If neither is given, the message is cyclic.
    """
    if options.cycle_ms is not None:
        return SendType.CYCLIC
    own = _meant(message.send_type)
    if own is not None:
        return own
    found = {_meant(_labelled(each, "GenSigSendType")) for each in message.signals} - {None}
    if not found or SendType.CYCLIC in found:
        return SendType.CYCLIC
    return SendType.IF_ACTIVE if SendType.IF_ACTIVE in found else SendType.EVENT


def _meant(name: object) -> SendType | None:
    """Return the send type that a database's name stands for; None: it states none, as NotUsed."""
    plain = re.sub(r"[\W_\d]", "", name.casefold()) if isinstance(name, str) else ""
    is_cyclic = bool(_CYCLIC.search(plain)) and not _NOT_CYCLIC.search(plain)
    if is_cyclic:
        return SendType.IF_ACTIVE if _ACTIVE.search(plain) else SendType.CYCLIC
    if _EVENT.search(plain) or _NOT_CYCLIC.search(plain):
        return SendType.EVENT
    return SendType.IF_ACTIVE if _ACTIVE.search(plain) else None


def cycle_of(message: Message, options: MessageOptions) -> float:
    """Return a message's cycle [ms]: the rig's, else the database's; 0: none, −1: the database's is invalid.

    By the database a message that is sent on events has none, whatever its GenMsgCycleTime is.
    """
    if options.cycle_ms is not None:
        return options.cycle_ms
    if not message.cycle_time or send_type_of(message, options) is SendType.EVENT:
        return 0.0
    try:
        return float(message.cycle_time)
    except (TypeError, ValueError, OverflowError):  # an attribute may be any text or number
        return -1.0


def timeout_of(message: Message, options: MessageOptions) -> float:
    """Return the time without a frame after which a message's last values expire [ms]; 0: never."""
    if send_type_of(message, options) is not SendType.CYCLIC:
        return 0.0
    return max(0.0, options.timeout_cycles * cycle_of(message, options))


def needs_fd(message: Message) -> bool:
    """Whether a message is sent in CAN FD frames: it has over 8 bytes, or the database says so."""
    return bool(message.is_fd) or message.length > 8


def padded_length(message: Message) -> int:
    """Return the length [bytes] of a message's frames: its own, or the next one that CAN FD has (ISO 11898-1)."""
    return next((each for each in LENGTHS if each >= message.length), message.length)


def format_of(message: Message, options: MessageOptions) -> int:
    """Return the flags of a message's frames: FD, and BRS if rig or database enable it; 0: classic CAN.

    A DBC enables BRS by the attribute CANFD_BRS, as in CANdb++.
    """
    if not needs_fd(message):
        return 0
    switches = attribute_of(message, "CANFD_BRS") in (1, "1") if options.brs is None else options.brs
    return FD | (BRS if switches else 0)


def attribute_of(item: Message | Signal, name: str) -> Any:
    """Return an attribute of a message or signal in a DBC, or the definition's default; None: it has none."""
    if item.dbc is None:
        return None
    if name in item.dbc.attributes:
        return item.dbc.attributes[name].value
    definition = item.dbc.attribute_definitions.get(name)
    return None if definition is None else definition.default_value


def _labelled(item: Message | Signal, name: str) -> Any:
    """Return an attribute of a message or signal, of an enumeration its label."""
    value = attribute_of(item, name)
    choices = item.dbc.attribute_definitions[name].choices if isinstance(value, int) and item.dbc else None
    return choices[value] if choices and 0 <= value < len(choices) else value
