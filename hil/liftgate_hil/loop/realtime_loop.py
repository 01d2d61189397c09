"""The real-time loop: waits, receives, ticks, sends, without the interpreter lock from the first tick to the last.

It has a thread of its own; other code controls and reads it through `Shared` alone. The tick is the same one that
every other loop calls.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import ERROR, FD, Frames, empty_frames
from liftgate_hil.codec.receive import backdate, is_stale
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.loop.advance import advance
from liftgate_hil.loop.datagrams import CAPACITY, Buffers, make_buffers, read_frames, write_frames
from liftgate_hil.loop.histogram import note
from liftgate_hil.loop.rings import (
    DELAY,
    EXECUTION,
    LATENESS,
    Shared,
    count_bits,
    next_row,
    note_arrivals,
    note_frames,
)
from liftgate_hil.loop.tick import LoopConfig, LoopState, in_force
from liftgate_hil.signals import Bench
from liftgate_hil.stimuli.bus_faults import restamp
from liftgate_hil.stimuli.mailbox import take_letters
from liftgate_hil.stimuli.stimulus_plan import (
    StimulusPlan,
    not_made,
    received,
    turns,
)
from liftgate_plant.compiler import System, compilable, outlined

ENDED, OVERRUN, DIVERGED = 0, 1, 2

_MONOTONIC, _REALTIME = 1, 0  # clocks
_ABSOLUTE = 1  # TIMER_ABSTIME
_LAST_PATIENCE = 100  # attempts, 1 ms apart, to send the last frames
_BUS_OFF, _RESTARTED = 0x40, 0x100  # CAN_ERR_BUSOFF, CAN_ERR_RESTARTED (linux/can/error.h)

_clock_gettime = System("clock_gettime", "i", "il")
_clock_nanosleep = System("clock_nanosleep", "i", "iill")


class RunParams(NamedTuple):
    """Parameters of a real-time run."""

    descriptor: int  # file descriptor of the wire
    ticks: int  # ticks to make in all
    limit_ns: int  # lateness at which it gives up
    command: int  # identifier of the drive command
    feedback: NDArray[np.int64]  # identifiers of the messages that show what a command did
    stimuli: StimulusPlan  # stimulus plan that the loop writes in place
    is_last: int  # 1: one more tick at the end, with the motors off; 0: another run goes on


class Wired(Protocol):
    """Object with a wire to which frames are sent."""

    @property
    def descriptor(self) -> int:
        """File descriptor of the wire."""


class Room(NamedTuple):
    """Working memory of the loop."""

    reading: Buffers
    writing: Buffers
    identifiers: NDArray[np.int64]
    lengths: NDArray[np.int64]
    data: NDArray[np.uint8]
    stamps: NDArray[np.int64]  # time of arrival of each frame
    given: Frames  # the frames that one tick gets
    given_stamps: NDArray[np.int64]
    drained: NDArray[np.int64]  # (1,) when all frames that had come were last read
    drops: NDArray[np.int64]  # (1,) the kernel's last count of dropped frames; -1: none yet
    clock: NDArray[np.int64]  # (2,) struct timespec


def make_room() -> Room:
    """Return working memory for the frames of a tick."""
    frames = empty_frames(CAPACITY)
    return Room(
        make_buffers(),
        make_buffers(),
        frames.identifiers,
        frames.lengths,
        frames.data,
        np.zeros(CAPACITY, dtype=np.int64),
        empty_frames(CAPACITY),
        np.zeros(CAPACITY, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        np.full(1, -1, dtype=np.int64),
        np.zeros(2, dtype=np.int64),
    )


@outlined
def clock_ns(clock: int, room: Room) -> int:
    """Return the time of a kernel clock [ns]."""
    _clock_gettime(clock, room.clock.ctypes.data)
    return int(room.clock[0] * 1_000_000_000 + room.clock[1])


@compilable
def wait_until(deadline_ns: int, room: Room) -> int:
    """Sleep until a time on the monotonic clock; return the time after that."""
    now = clock_ns(_MONOTONIC, room)
    while now < deadline_ns:
        room.clock[0] = deadline_ns // 1_000_000_000
        room.clock[1] = deadline_ns % 1_000_000_000
        _clock_nanosleep(_MONOTONIC, _ABSOLUTE, room.clock.ctypes.data, 0)
        now = clock_ns(_MONOTONIC, room)
    return now


@compilable
def arrival_of(stamp: int, now_ns: int, real_ns: int, drained_ns: int) -> int:
    """Return a frame's arrival on the monotonic clock, from the stamp that `read_frames` returns.

    A pump's stamp is of that clock. A step of the wall clock between the frame's arrival and now makes the
    kernel's stamp wrong; but the frame came after all were last read, which limits the error.
    """
    if stamp >= 0:
        return now_ns if stamp == 0 else min(stamp, now_ns)
    return now_ns - min(max(real_ns + stamp, 0), now_ns - drained_ns)


@compilable
def is_among(frames: Frames, identifiers: NDArray[np.int64]) -> bool:
    """Whether a frame with one of these identifiers is there."""
    for i in range(frames.count):
        identifier = frames.identifiers[i] & ~FD
        for wanted in identifiers:
            if identifier == wanted:
                return True
    return False


@compilable
def send(shared: Shared, params: Wired, room: Room, replies: Frames, patience: int) -> int:
    """Send frames and count them; return how many the wire did not accept, see `write_frames`."""
    written = write_frames(params.descriptor, room.writing, replies, patience)
    control = shared.control[0]
    control.sent += written.sent
    missed = written.full + written.failed
    if missed > 0:
        control.unsent += missed
        control.unsent_full += written.full
        control.last_error = written.error
    return missed


@compilable
def note_errors(shared: Shared, frames: Frames) -> None:
    """Track whether the controller is bus-off.

    Its error frames report bus-off; it is on the bus again when it restarts or other frames are received.
    """
    control = shared.control[0]
    for i in range(frames.count):
        identifier = frames.identifiers[i]
        if identifier & ERROR == 0 or identifier & _RESTARTED != 0:
            control.bus_off = 0
        elif identifier & _BUS_OFF != 0:
            control.bus_offs += 1 - control.bus_off
            control.bus_off = 1


@compilable
def receive(shared: Shared, params: Wired, room: Room) -> Frames:
    """Return the frames that have come; their arrivals on the monotonic clock go to `room.stamps`."""
    frames = Frames(0, room.identifiers, room.lengths, room.data)
    reading = read_frames(params.descriptor, room.reading, frames, room.stamps)
    now_ns = clock_ns(_MONOTONIC, room)
    control = shared.control[0]
    if reading.error != 0:
        control.receive_errors += 1
        control.last_error = reading.error
        control.bus_off = 0  # an interface that was down restarts its controller
    if room.drops[0] < 0 and reading.count > 0:
        room.drops[0] = max(
            reading.dropped, 0
        )  # frames dropped before the first one belong to the time before the run
    elif reading.dropped >= 0:
        # A new socket under the descriptor counts from zero.
        before = room.drops[0] if reading.dropped >= room.drops[0] else 0
        control.dropped += reading.dropped - before
        room.drops[0] = reading.dropped
    frames = Frames(reading.count, room.identifiers, room.lengths, room.data)
    if reading.count > 0:
        real_ns = clock_ns(_REALTIME, room)
        drained_ns = int(room.drained[0])
        for i in range(reading.count):
            room.stamps[i] = arrival_of(room.stamps[i], now_ns, real_ns, drained_ns)
        note_errors(shared, frames)
    if reading.count < CAPACITY:
        room.drained[0] = now_ns
    return frames


@compilable
def arrived_by(room: Room, first: int, count: int, time_ns: int) -> int:
    """Return the end of the frames from `first` on that have arrived by a time on the monotonic clock."""
    last = first
    while last < count and room.stamps[last] <= time_ns:
        last += 1
    return last


@compilable
def handed_out(
    bus: BusConfig, shared: Shared, room: Room, first: int, last: int, time_ns: int
) -> Frames:
    """Return the frames of `room` from `first` to before `last`, for a tick at a time on the monotonic clock.

    Their arrivals go to `room.given_stamps`; stale frames are left out and counted.
    """
    count, given = 0, room.given
    for i in range(first, last):
        if is_stale(bus, room.identifiers[i], time_ns - room.stamps[i]):
            shared.control[0].stale += 1
            continue
        length = room.lengths[i]
        given.identifiers[count], given.lengths[count] = room.identifiers[i], length
        for k in range(length):
            given.data[count, k] = room.data[i, k]
        room.given_stamps[count] = room.stamps[i]
        count += 1
    return Frames(count, given.identifiers, given.lengths, given.data)


@compilable
def first_arrival(frames: Frames, stamps: NDArray[np.int64], identifier: int) -> int:
    """Return when the first frame with an identifier came; 0: there is none."""
    for i in range(frames.count):
        if frames.identifiers[i] & ~FD == identifier:
            return int(stamps[i])
    return 0


@compilable
def longest_wait(frames: Frames, stamps: NDArray[np.int64], now_ns: int) -> int:
    """Return the longest time that one of the frames has waited [ns]."""
    longest = 0
    for i in range(frames.count):
        longest = max(longest, now_ns - stamps[i])
    return longest


@compilable
def run_realtime(  # noqa: PLR0912, PLR0915
    config: LoopConfig, state: LoopState, params: RunParams, shared: Shared, room: Room
) -> tuple[LoopState, int]:
    """Tick until stopped or done, and with `is_last` once more with the motors off, when every message is sent.

    Ticks that were missed are made up for at once, each with its row, and send nothing. Each tick gets the frames
    that had arrived by its own time, so that the gate moves as if none had been missed. Returns the state, and
    ENDED, OVERRUN or DIVERGED.
    """
    control = shared.control[0]
    outcome = ENDED
    waiting_since = 0  # arrival of the oldest command that no feedback has shown yet
    none = Frames(0, room.identifiers, room.lengths, room.data)
    stimuli, stopping, is_over = params.stimuli, False, False
    origin = stimuli.origin[0]
    # The scenario's time 0 is now: taken here, where no interpreter lock can hold up what follows.
    start_ns = clock_ns(_MONOTONIC, room) - (state.tick - origin) * config.step_ns
    control.epoch_ns = clock_ns(_REALTIME, room) - (state.tick - origin) * config.step_ns
    room.drained[0] = start_ns
    woken = start_ns
    come, taken = 0, 0  # frames that have come, and how many of them ticks have received
    left = -1  # ticks before the last one of those that are due; -1: none is due
    while not is_over:
        gate = in_force(config, stimuli.faults.row)  # outside the inner loop, as in `episode`
        while True:
            done = state.tick - origin
            if left < 0:
                stopping = control.stop != 0 or done >= params.ticks or outcome != ENDED
                come, taken, left = 0, 0, 0
                if not stopping:
                    deadline = start_ns + (done + 1) * config.step_ns
                    woken = wait_until(deadline, room)
                    late = woken - deadline
                    note(shared.histograms[LATENESS], late)
                    if late > params.limit_ns:
                        outcome, left = OVERRUN, -1
                        continue
                    left = min(late // config.step_ns, params.ticks - done - 1)
                    come = receive(shared, params, room).count
                elif params.is_last == 0:
                    is_over = True
                    break
                take_letters(shared.box, stimuli.held)
            now = done * config.step
            if turns(stimuli, now):
                break
            given, accepted, waited_ns = none, state.counts.accepted, 0
            now_ns, due_ns = state.tick * config.step_ns, woken
            if not stopping:
                if left > 0 and taken == come == CAPACITY:  # there was no room for all
                    come, taken = receive(shared, params, room).count, 0
                last = come
                if left > 0:
                    due_ns = start_ns + (done + 1) * config.step_ns
                    last = arrived_by(room, taken, come, due_ns)
                given = handed_out(config.inputs, shared, room, taken, last, due_ns)
                taken = last
                given = received(stimuli, config.inputs, given, now_ns, config.seed)
                if len(stimuli.bus_faults.origins) > 0:
                    restamp(stimuli.bus_faults, given.count, room.given_stamps, due_ns)
                if left == 0:
                    due_ns = clock_ns(_MONOTONIC, room)
                waited_ns = longest_wait(given, room.given_stamps, due_ns)
                waited_ns = max(waited_ns, control.turn_late_ns, control.line_late_ns)
                control.line_late_ns = 0
            control.overruns += int(left > 0)
            missed, dropped = float(control.overruns), float(control.dropped + control.stale)
            bench = Bench(missed, dropped, 1e-9 * waited_ns, not_made(stimuli))
            place = next_row(shared)
            state, replies, is_sound = advance(
                gate,
                state,
                stimuli,
                given,
                shared.rows[place : place + 1],
                bench,
                left > 0,
                stopping,
            )
            control.rows += 1
            if given.count > 0:
                before_ns = due_ns - config.step_ns  # when the previous tick was due
                backdate(
                    config.inputs, state.reception, given, room.given_stamps, before_ns, now_ns
                )
            if state.counts.accepted > accepted and waiting_since == 0:
                waiting_since = first_arrival(given, room.given_stamps, params.command)
            note_arrivals(shared, given, room.given_stamps, start_ns)
            count_bits(shared, given)
            left -= 1
            if not is_sound:
                outcome = DIVERGED
            if left >= 0:
                continue

            unsent = 0
            if replies.count > 0:
                patience = _LAST_PATIENCE if stopping else 0
                unsent = send(shared, params, room, replies, patience)
            sent_ns = clock_ns(_MONOTONIC, room)
            if waiting_since != 0 and unsent == 0 and is_among(replies, params.feedback):
                note(shared.histograms[DELAY], sent_ns - waiting_since)
                waiting_since = 0

            note_frames(shared, replies, sent_ns - start_ns, 1)
            count_bits(shared, replies)
            control.tick = state.tick - origin
            if stopping:
                is_over = True
                break
            note(shared.histograms[EXECUTION], clock_ns(_MONOTONIC, room) - woken)
    return state, outcome
