"""Conversion between python-can's messages, after validation, and this project's frames."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import (
    CLASSIC_BYTES,
    ERROR,
    EXTENDED,
    FRAME_BRS,
    FRAME_ESI,
    FRAME_FD,
    MAX_BYTES,
    REMOTE,
    Frames,
    frame_flags,
    with_frame_flags,
)
from liftgate_hil.config.can_libraries import can as _can
from liftgate_hil.errors import shown

if TYPE_CHECKING:
    import can


class NotAFrameError(ValueError):
    """Raised for a python-can message that cannot be a CAN frame; its text says what is allowed."""


class Fields(NamedTuple):
    """Fields of a frame, as in `struct liftgate_frame`."""

    identifier: int  # with SocketCAN's flags
    length: int  # of the payload; of a remote frame: the requested length
    flags: int  # 1: CAN FD, 2: BRS, 4: ESI
    data: bytes


def fields_of(message: object) -> Fields:
    """Return the fields of a python-can message. Raises NotAFrameError if it is no valid frame.

    Each field may be anything: python-can's own check accepts values that compare false with everything, such as
    NaN, and numbers with a fraction.
    """
    if not isinstance(message, _can.Message):
        raise NotAFrameError(f"{shown(message)}; allowed: a list of can.Message")
    try:
        number, asked = _whole(message.arbitration_id), _whole(message.dlc)
    except TypeError:
        raise NotAFrameError(f"{shown(message)}; allowed: a whole number as identifier and as length") from None
    if not isinstance(message.data, bytes | bytearray | memoryview):
        raise NotAFrameError(f"{shown(message)}; allowed: bytes as data")
    data = b"" if message.is_remote_frame else bytes(message.data)
    length = asked if message.is_remote_frame else len(data)
    # An error frame's identifier is its class, which may have 29 bits, whatever its format.
    is_wide = message.is_extended_id or message.is_error_frame
    if not 0 <= number < 1 << (29 if is_wide else 11):
        raise NotAFrameError(f"{shown(message)}; allowed: identifiers of 11 bits, extended ones of 29")
    if not 0 <= length <= (MAX_BYTES if message.is_fd else CLASSIC_BYTES):
        raise NotAFrameError(f"{shown(message)}; allowed: up to 8 bytes, with CAN FD 64")
    if message.is_remote_frame and message.is_fd:
        raise NotAFrameError(f"{shown(message)}; allowed: remote frames without CAN FD")
    number |= EXTENDED if message.is_extended_id else 0
    number |= REMOTE if message.is_remote_frame else 0
    number |= ERROR if message.is_error_frame else 0
    flags = 0
    if message.is_fd:
        flags = FRAME_FD
        flags |= FRAME_BRS if message.bitrate_switch else 0
        flags |= FRAME_ESI if message.error_state_indicator else 0
    return Fields(number, length, flags, data)


def put(fields: Fields, frames: Frames, row: int) -> None:
    """Write a frame's fields into a row of `frames`."""
    frames.identifiers[row] = with_frame_flags(fields.identifier, fields.flags)
    frames.lengths[row] = fields.length
    frames.data[row, : len(fields.data)] = np.frombuffer(fields.data, dtype=np.uint8)


def message_of(frames: Frames, row: int) -> can.Message:
    """Return a row of `frames` as a python-can message."""
    return _message(frames.identifiers[row], frames.lengths[row], frames.data[row], 0.0)


def logged_message(row: Any) -> can.Message:
    """Return a row of LOGGED as a python-can message with its timestamp."""
    return _message(row["identifier"], row["length"], row["payload"], row["time_ns"] * 1e-9)


def _message(identifier: int, length: int, payload: NDArray[np.uint8], time_s: float) -> can.Message:
    """Return a python-can message from identifier with flags, payload in a longer array, and time [s]."""
    identifier, length = int(identifier), int(length)
    flags = 0 if identifier & REMOTE else frame_flags(identifier)
    return message_of_fields(identifier, length, flags, payload[:length].tobytes(), time_s)


def message_of_fields(
    identifier: int, length: int, flags: int, data: bytes | list[int], time_s: float
) -> can.Message:
    """Return the python-can message for a `struct liftgate_frame`."""
    is_remote = bool(identifier & REMOTE)
    return _can.Message(
        timestamp=time_s,
        arbitration_id=identifier & 0x1FFFFFFF,
        is_extended_id=bool(identifier & EXTENDED),
        is_remote_frame=is_remote,
        is_error_frame=bool(identifier & ERROR),
        is_fd=bool(flags & FRAME_FD),
        bitrate_switch=bool(flags & FRAME_BRS),
        error_state_indicator=bool(flags & FRAME_ESI),
        dlc=length,
        data=None if is_remote else bytes(data[:length]),
        check=False,
    )


def _whole(value: Any) -> int:
    """Return a value as int. Raises TypeError for a bool, and for what is no whole number."""
    if isinstance(value, bool):
        raise TypeError(value)
    return operator.index(value)
