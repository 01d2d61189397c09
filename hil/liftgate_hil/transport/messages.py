"""Frames as python-can has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from liftgate_hil.codec.frames import ERROR, EXTENDED, REMOTE
from liftgate_hil.errors import EcuError, shown
from liftgate_hil.python_can import can as _can

if TYPE_CHECKING:
    import can

_FD = 1  # flag of the C interface


def message_of_fields(
    identifier: int, length: int, flags: int, data: list[int], time_s: float
) -> can.Message:
    """The message of a `struct liftgate_frame`."""
    is_remote = bool(identifier & REMOTE)
    return _can.Message(
        timestamp=time_s,
        arbitration_id=identifier & 0x1FFFFFFF,
        is_extended_id=bool(identifier & EXTENDED),
        is_remote_frame=is_remote,
        is_error_frame=bool(identifier & ERROR),
        is_fd=bool(flags & _FD),
        dlc=length,
        data=None if is_remote else bytes(data[:length]),
        check=False,
    )


def fields_of_message(message: object) -> tuple[int, int, int, bytes]:
    """(identifier with flags, length, flags, payload) of a message that an ECU wants to send. Raises EcuError."""
    if not isinstance(message, _can.Message):
        raise EcuError(f"{shown(message)}; allowed: a list of can.Message")
    if not isinstance(message.arbitration_id, int) or not isinstance(message.dlc, int):
        raise EcuError(f"{shown(message)}; allowed: a whole number as identifier and as length")
    if not isinstance(message.data, bytes | bytearray):
        raise EcuError(f"{shown(message)}; allowed: bytes as data")
    identifier = message.arbitration_id
    identifier |= EXTENDED if message.is_extended_id else 0
    identifier |= REMOTE if message.is_remote_frame else 0
    identifier |= ERROR if message.is_error_frame else 0
    data = b"" if message.is_remote_frame else bytes(message.data)
    length = message.dlc if message.is_remote_frame else len(data)
    if not 0 <= length <= (64 if message.is_fd else 8):
        raise EcuError(f"{shown(message)}; allowed: up to 8 bytes, with CAN FD 64")
    if not 0 <= message.arbitration_id < 1 << (29 if message.is_extended_id else 11):
        raise EcuError(f"{shown(message)}; allowed: identifiers of 11 bits, extended ones of 29")
    return identifier, length, int(message.is_fd), data
