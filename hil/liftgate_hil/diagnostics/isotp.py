"""ISO-TP (ISO 15765-2:2016) as a state machine without I/O: messages of up to 4095 bytes as CAN frames.

Normal addressing, physical, classic frames of up to eight bytes, sending and receiving at the same time. A `Link`
is one endpoint: pass each received frame to `hear`, which returns the length of a message once it is complete, and
call `speak` once a tick for the frames to send. The caller supplies the time [ns]. No input raises an exception:
what the standard says to ignore is ignored, what it says to abort is aborted, with the reason in the link.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from liftgate_compiler import compilable, outlined
from liftgate_hil.codec.frames import Frames

LONGEST = 4095  # bytes: the largest value of the twelve bits of a first frame's FF_DL
MOST_SPOKEN = 2  # frames per tick: one of flow control, one with data
MOST_WAITS = 10  # FC.WAIT in a row that a sender tolerates

# Network layer timing parameters: both time out after 1000 ms.
N_BS_NS = 1_000_000_000  # a sender waits for flow control
N_CR_NS = 1_000_000_000  # a receiver waits for a consecutive frame

_SINGLE, _FIRST, _CONSECUTIVE, _FLOW = 0, 1, 2, 3  # N_PCItype
CONTINUE, WAIT, OVERFLOW = 0, 1, 2  # flow status
_NONE = -1

IDLE, TO_BEGIN, AWAITS, IN_BLOCK = 0, 1, 2, 3  # states of sending

# Why the last message was not sent, or not received: N_Result.
OK, TIMEOUT_BS, TIMEOUT_CR, WRONG_SN, INVALID_FS, BUFFER_OVERFLOW, WAIT_OVERRUN, UNEXPECTED = range(8)

LINK = np.dtype(
    [
        ("send_id", "i8"),  # identifiers with SocketCAN's flags
        ("receive_id", "i8"),
        ("padding", "i8"),  # byte that pads frames to eight bytes; -1: no padding
        ("block_size", "i8"),  # requested when receiving; 0: no limit
        ("st_min", "i8"),  # requested when receiving, as a byte
        ("sending", "i8"),
        ("out_length", "i8"),
        ("out_at", "i8"),  # bytes sent so far
        ("out_number", "i8"),  # sequence number of the next frame
        ("out_block", "i8"),  # frames until the next flow control; 0: no limit
        ("gap_ns", "i8"),  # STmin requested by the receiver
        ("next_ns", "i8"),  # earliest time of the next frame
        ("answer_by_ns", "i8"),
        ("waits", "i8"),  # FC.WAIT in a row
        ("send_result", "i8"),
        ("is_receiving", "i8"),
        ("in_length", "i8"),
        ("in_at", "i8"),
        ("in_number", "i8"),
        ("in_block", "i8"),
        ("next_by_ns", "i8"),
        ("owed", "i8"),  # flow status that shall be sent; -1: none
        ("receive_result", "i8"),
        ("out", "u1", (LONGEST,)),  # message being sent
        ("into", "u1", (LONGEST,)),  # message received
    ]
)


class Link(NamedTuple):
    """State of one endpoint of an ISO-TP connection. Its array is written in place."""

    head: Any  # (1,) LINK


def new_link(send_id: int, receive_id: int, padding: int = 0xCC, block_size: int = 0, st_min: int = 0) -> Link:
    """Return an idle endpoint; `padding` -1: frames are not padded, `st_min`: STmin byte in its flow control."""
    head = np.zeros(1, dtype=LINK).view(np.recarray)
    head.send_id, head.receive_id, head.padding = send_id, receive_id, padding
    head.block_size, head.st_min, head.owed = block_size, st_min, _NONE
    return Link(head)


def put_message(link: Link, message: bytes) -> None:
    """Put a message (1 to LONGEST bytes) into a link and start sending it."""
    link.head.out[0, : len(message)] = np.frombuffer(message, dtype=np.uint8)
    begin(link, len(message))


def message_in(link: Link, length: int) -> bytes:
    """Return the last received message, of `length` bytes."""
    message: bytes = link.head.into[0, :length].tobytes()
    return message


@compilable
def begin(link: Link, length: int) -> None:
    """Start sending the first `length` bytes (1 to LONGEST) of the link's `out`, aborting a message under way."""
    head = link.head[0]
    head.sending, head.out_length, head.out_at = TO_BEGIN, length, 0
    head.send_result = OK


@compilable
def gap_of(st_min: int) -> int:
    """Return the separation time [ns] for an STmin byte; reserved values mean the longest, 127 ms."""
    if st_min <= 0x7F:
        return st_min * 1_000_000
    if 0xF1 <= st_min <= 0xF9:
        return (st_min - 0xF0) * 100_000
    return 127_000_000


@compilable
def lapse(head: Any, now_ns: int) -> None:
    """Abort sending and receiving where their timeouts have expired."""
    if head.sending == AWAITS and now_ns > head.answer_by_ns:
        head.sending, head.send_result = IDLE, TIMEOUT_BS
    if head.is_receiving != 0 and now_ns > head.next_by_ns:
        head.is_receiving, head.receive_result = 0, TIMEOUT_CR


@outlined
def hear(link: Link, frames: Frames, frame: int, now_ns: int) -> int:
    """Process a frame received at a time [ns] and return the length of the message that it completes; 0: none.

    The message is in the link's `into` until the next one begins. A frame that is not for this endpoint is
    ignored.
    """
    head = link.head[0]
    if frames.identifiers[frame] != head.receive_id:
        return 0
    lapse(head, now_ns)
    length = min(int(frames.lengths[frame]), 8)
    if length < 1:
        return 0
    first = int(frames.data[frame, 0])
    kind = first >> 4
    if kind == _SINGLE:
        return hear_single(link, frames, frame, length)
    if kind == _FIRST:
        hear_first(link, frames, frame, length, now_ns)
    elif kind == _CONSECUTIVE:
        return hear_next(link, frames, frame, length, now_ns)
    elif kind == _FLOW and length >= 3:
        hear_flow(head, first & 0xF, int(frames.data[frame, 1]), int(frames.data[frame, 2]), now_ns)
    return 0


@compilable
def hear_single(link: Link, frames: Frames, frame: int, length: int) -> int:
    """Receive a single frame, aborting a message being received; return its message's length, 0: it is invalid."""
    head, size = link.head[0], int(frames.data[frame, 0])
    if size < 1 or size > length - 1:
        return 0
    if head.is_receiving != 0:
        head.is_receiving, head.receive_result = 0, UNEXPECTED
    for k in range(size):
        head.into[k] = frames.data[frame, 1 + k]
    return size


@compilable
def hear_first(link: Link, frames: Frames, frame: int, length: int, now_ns: int) -> None:
    """Receive the first frame of a message and order flow control, aborting another message being received."""
    head, data = link.head[0], frames.data
    size = (int(data[frame, 0]) & 0xF) << 8 | int(data[frame, 1])
    if length < 8 or 0 < size < 8:  # it would have fitted into a single frame
        return
    if head.is_receiving != 0:
        head.receive_result = UNEXPECTED
    if size == 0:  # escape sequence for longer messages
        head.is_receiving, head.owed = 0, OVERFLOW
        return
    for k in range(6):
        head.into[k] = data[frame, 2 + k]
    head.is_receiving, head.in_length, head.in_at, head.in_number = 1, size, 6, 1
    head.in_block, head.owed = head.block_size, CONTINUE
    head.next_by_ns = now_ns + N_CR_NS


@compilable
def hear_next(link: Link, frames: Frames, frame: int, length: int, now_ns: int) -> int:
    """Receive a consecutive frame and return the length of the message that it completes; 0: none."""
    head = link.head[0]
    if head.is_receiving == 0:
        return 0
    if int(frames.data[frame, 0]) & 0xF != head.in_number:
        head.is_receiving, head.receive_result = 0, WRONG_SN
        return 0
    size = min(7, int(head.in_length - head.in_at))
    if length - 1 < size:
        return 0
    for k in range(size):
        head.into[head.in_at + k] = frames.data[frame, 1 + k]
    head.in_at += size
    head.in_number = (head.in_number + 1) & 0xF
    head.next_by_ns = now_ns + N_CR_NS
    if head.in_at == head.in_length:
        head.is_receiving, head.receive_result = 0, OK
        return int(head.in_length)
    if head.block_size > 0:
        head.in_block -= 1
        if head.in_block == 0:
            head.in_block, head.owed = head.block_size, CONTINUE
    return 0


@compilable
def hear_flow(head: Any, status: int, block_size: int, st_min: int, now_ns: int) -> None:
    """Process a flow control frame, which is ignored unless the sender waits for it."""
    if head.sending != AWAITS:
        return
    if status == CONTINUE:
        head.sending, head.out_block, head.gap_ns = IN_BLOCK, block_size, gap_of(st_min)
        head.next_ns, head.waits = now_ns, 0
    elif status == WAIT:
        head.waits += 1
        head.answer_by_ns = now_ns + N_BS_NS
        if head.waits > MOST_WAITS:
            head.sending, head.send_result = IDLE, WAIT_OVERRUN
    else:
        head.sending = IDLE
        head.send_result = BUFFER_OVERFLOW if status == OVERFLOW else INVALID_FS


@outlined
def speak(link: Link, frames: Frames, count: int, now_ns: int) -> int:
    """Append the frames to be sent at a time [ns] to `frames` after the first `count`; return the new count.

    At most MOST_SPOKEN frames are appended: flow control, and one frame with data.
    """
    head = link.head[0]
    lapse(head, now_ns)
    if head.owed != _NONE:
        frames.data[count, 0] = _FLOW << 4 | head.owed
        frames.data[count, 1] = head.block_size
        frames.data[count, 2] = head.st_min
        put_end(head, frames, count, 3)
        head.owed = _NONE
        count += 1
    if head.sending == TO_BEGIN or (head.sending == IN_BLOCK and now_ns >= head.next_ns):
        speak_data(link, frames, count, now_ns)
        count += 1
    return count


@compilable
def speak_data(link: Link, frames: Frames, frame: int, now_ns: int) -> None:
    """Write the link's next single, first or consecutive frame to row `frame`, and advance the link's state."""
    head, data = link.head[0], frames.data
    first, size = 1, 7
    if head.sending == IN_BLOCK:
        data[frame, 0] = _CONSECUTIVE << 4 | head.out_number
        head.out_number = (head.out_number + 1) & 0xF
        head.next_ns = now_ns + head.gap_ns
        if head.out_block > 0:
            head.out_block -= 1
            head.sending = IN_BLOCK if head.out_block > 0 else AWAITS
    elif head.out_length <= 7:
        data[frame, 0] = head.out_length
    else:
        data[frame, 0], data[frame, 1] = _FIRST << 4 | head.out_length >> 8, head.out_length & 0xFF
        first, size = 2, 6
        head.sending, head.out_number, head.waits = AWAITS, 1, 0
    head.answer_by_ns = now_ns + N_BS_NS
    size = min(size, int(head.out_length - head.out_at))
    for k in range(size):
        data[frame, first + k] = head.out[head.out_at + k]
    head.out_at += size
    put_end(head, frames, frame, first + size)
    if head.out_at == head.out_length:
        head.sending = IDLE


@compilable
def put_end(head: Any, frames: Frames, frame: int, length: int) -> None:
    """Write identifier, length and padding (after `length` bytes) of a frame."""
    frames.identifiers[frame] = head.send_id
    frames.lengths[frame] = length if head.padding < 0 else 8
    for k in range(length, 8):
        frames.data[frame, k] = max(0, head.padding)


@compilable
def is_sending(link: Link) -> bool:
    """Whether the link is sending a message."""
    return bool(link.head[0].sending != IDLE)
