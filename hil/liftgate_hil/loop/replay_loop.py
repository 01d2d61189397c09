"""The replay loop: sends frames onto a wire, each when it is due.

It waits and sends as the real-time loop does, without the interpreter lock from the first frame to the last, and
has a thread of its own. The frames that are due next are in a ring that another thread fills.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.codec.frames import Frames, empty_frames
from liftgate_hil.loop.datagrams import BATCH
from liftgate_hil.loop.histogram import note
from liftgate_hil.loop.realtime_loop import MONOTONIC, Room, clock_ns, receive, send, wait_until
from liftgate_hil.loop.rings import LATENESS, Shared

PLACES = 1 << 18  # frames that the ring holds: a minute of a full bus at 500 kbit/s

TRIAL_NS = 100_000  # between two attempts to send where the wire's queue is full

_HEAD_START = 2_000_000  # ns until the first frame is due, for the thread to settle
_LOOK = 10_000_000  # ns at most between two checks for the end and for received frames
_LISTEN = 500_000  # ns that must be left for it to receive frames while it waits
_STARVED = 200_000  # ns between two looks at an empty ring

POSITION = np.dtype(
    [
        ("written", "i8"),  # frames put into the ring so far
        ("is_whole", "i8"),  # 1: no more frames will be put in
        ("played", "i8"),  # frames taken out of it
        ("accepted", "i8"),  # of these, frames that the wire accepted
        ("start_ns", "i8"),  # when the first one is due (CLOCK_MONOTONIC); 0: it has not begun
        ("starved", "i8"),  # times that a frame was late because the ring was empty
    ]
)


class Schedule(NamedTuple):
    """Ring of the frames to replay, with their due times."""

    position: Any  # (1,) POSITION
    due: NDArray[np.int64]  # (n,) ns since the beginning, never decreasing
    identifiers: NDArray[np.int64]
    lengths: NDArray[np.int64]
    data: NDArray[np.uint8]  # (n, 64)
    handed: NDArray[np.int64]  # (n,) when each frame that the wire accepted was due, in their order


class PlayParams(NamedTuple):
    """Parameters of a replay."""

    descriptor: int  # file descriptor of the wire
    together: int  # frames that are sent at once, at most
    patience: int  # attempts of `write_frames` where the wire's queue is full


def empty_schedule(places: int = PLACES) -> Schedule:
    """Allocate an empty ring with room for `places` frames to replay."""
    frames = empty_frames(places)
    return Schedule(
        np.zeros(1, dtype=POSITION).view(np.recarray),
        np.zeros(places, dtype=np.int64),
        frames.identifiers,
        frames.lengths,
        frames.data,
        np.zeros(places, dtype=np.int64),
    )


def put(schedule: Schedule, due: NDArray[np.int64], frames: NDArray[np.void]) -> int:
    """Put frames (n,) LOGGED into the ring, due at these times [ns since the beginning], as far as there is room.

    Returns how many were put in.
    """
    position, places = schedule.position[0], len(schedule.due)
    count = min(len(frames), places - int(position.written - position.played))
    done = 0
    while done < count:
        at = int(position.written + done) % places
        piece = slice(done, done + min(count - done, places - at))
        here = slice(at, at + piece.stop - done)
        schedule.due[here] = due[piece]
        schedule.identifiers[here] = frames["identifier"][piece]
        schedule.lengths[here] = frames["length"][piece]
        schedule.data[here] = frames["payload"][piece]
        done = piece.stop
    position.written += count
    return count


@compilable
def due_by(schedule: Schedule, now_ns: int, most: int) -> int:
    """Return how many of the next frames are due by a time [ns]: contiguous in the ring, at most `most`."""
    position = schedule.position[0]
    first = position.played % len(schedule.due)
    most = min(most, len(schedule.due) - first)
    count = 0
    while count < most and position.start_ns + schedule.due[first + count] <= now_ns:
        count += 1
    return count


@compilable
def hand_over(schedule: Schedule, params: PlayParams, shared: Shared, room: Room, count: int) -> None:
    """Send the next `count` frames, and count the accepted ones; if all were, record how late each was."""
    position = schedule.position[0]
    first = position.played % len(schedule.due)
    end = first + count
    for place in range(first, end):
        # Before they are sent: whoever receives them at the wire's other end may look at once.
        schedule.handed[(position.accepted + place - first) % len(schedule.handed)] = schedule.due[place]
    frames = Frames(count, schedule.identifiers[first:end], schedule.lengths[first:end], schedule.data[first:end])
    missed = send(shared, params, room, frames, params.patience)
    sent_ns = clock_ns(MONOTONIC, room)
    position.accepted += count - missed
    if missed == 0:
        for place in range(first, end):
            note(shared.histograms[LATENESS], sent_ns - position.start_ns - schedule.due[place])
    position.played += count


@compilable
def play(schedule: Schedule, params: PlayParams, shared: Shared, room: Room) -> None:
    """Replay until all frames are sent, or `control.stop` is set. Frames from the wire are read and ignored."""
    control, position = shared.control[0], schedule.position[0]
    position.start_ns = clock_ns(MONOTONIC, room) + _HEAD_START
    room.drained[0] = position.start_ns
    listened, is_starved = position.start_ns, False
    while control.stop == 0:
        is_whole = position.is_whole != 0  # read first: all frames put in before it was set are in the ring
        left = position.written - position.played
        now = clock_ns(MONOTONIC, room)
        if left == 0:
            if is_whole:
                break
            is_starved = True
            receive(shared, params, room)
            wait_until(now + _STARVED, room)
            continue
        due = position.start_ns + schedule.due[position.played % len(schedule.due)]
        if is_starved and now > due:
            position.starved += 1
        is_starved = False
        if (now < due and now + _LISTEN < due) or now - listened > _LOOK:
            receive(shared, params, room)
            listened = clock_ns(MONOTONIC, room)
            now = listened
        if now < due:
            now = wait_until(min(due, now + _LOOK), room)
        count = due_by(schedule, now, min(left, params.together))
        if count > 0:
            hand_over(schedule, params, shared, room, count)


def params_for(descriptor: int, is_kernels: bool) -> PlayParams:
    """Return the replay parameters for a wire: a socket of the kernel's CAN, or one behind a pump thread.

    The kernel's takes many frames at once; one behind a pump takes one after the other, so that it is known for
    each whether it was accepted. The loop waits for the kernel's queue up to 20 ms, since that stays full where
    nobody on the bus acknowledges, and for a pump's up to 1 s, since that is only slow.
    """
    if is_kernels:
        return PlayParams(descriptor, BATCH, 20_000_000 // TRIAL_NS)
    return PlayParams(descriptor, 1, 1_000_000_000 // TRIAL_NS)
