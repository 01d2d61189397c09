"""The real-time loop: waits, receives, ticks, sends, without the interpreter lock from the first tick to the last.

It has a thread of its own; other code controls and reads it through `Shared` alone. The tick is the same one that
every other loop calls.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import System, compilable, outlined
from liftgate_hil.codec.frames import ERROR, Frames, empty_frames
from liftgate_hil.codec.receive import backdate, is_stale
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.loop.advance import advance
from liftgate_hil.loop.datagrams import (
    CAPACITY,
    Buffers,
    arrival_of,
    first_arrival,
    is_among,
    longest_wait,
    make_buffers,
    read_frames,
    write_frames,
)
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
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan, not_made, received, turns

ENDED, OVERRUN, DIVERGED = 0, 1, 2

MONOTONIC, _REALTIME = 1, 0  # clocks
_ABSOLUTE = 1  # TIMER_ABSTIME
_LAST_PATIENCE = 100  # attempts, 1 ms apart, to send the last frames
_BUS_OFF, _RESTARTED = 0x40, 0x100  # CAN_ERR_BUSOFF, CAN_ERR_RESTARTED (linux/can/error.h)

_clock_gettime = System("clock_gettime", "i", "il")
_clock_nanosleep = System("clock_nanosleep", "i", "iill")


# Progress of the loop, written in place; times are on the monotonic clock.
PACE = np.dtype(
    [
        ("start_ns", "i8"),  # the scenario's time 0
        ("woken_ns", "i8"),  # when the loop last woke
        ("come", "i8"),  # frames that have come
        ("taken", "i8"),  # of these, those that ticks have received
        ("left", "i8"),  # ticks before the last one of those that are due; -1: none is due
        ("due_ns", "i8"),  # when the present tick was due
        ("waited_ns", "i8"),  # longest wait of one of its frames, or of an ECU in this process
        ("command_ns", "i8"),  # arrival of the oldest command without feedback; 0: none
    ]
)


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
    """Object with the file descriptor of a wire, over which the loop sends and receives frames."""

    @property
    def descriptor(self) -> int:
        """File descriptor of the wire."""


class Room(NamedTuple):
    """Working memory of the real-time loop."""

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
    pace: Any  # (1,) PACE


def make_room() -> Room:
    """Allocate the real-time loop's working memory for the frames of a tick."""
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
        np.zeros(1, dtype=PACE).view(np.recarray),
    )


@outlined
def clock_ns(clock: int, room: Room) -> int:
    """Return the time of a kernel clock [ns]."""
    _clock_gettime(clock, room.clock.ctypes.data)
    return int(room.clock[0] * 1_000_000_000 + room.clock[1])


@compilable
def wait_until(deadline_ns: int, room: Room) -> int:
    """Sleep until a time [ns] on the monotonic clock; return the time [ns] on it after that."""
    now = clock_ns(MONOTONIC, room)
    while now < deadline_ns:
        room.clock[0] = deadline_ns // 1_000_000_000
        room.clock[1] = deadline_ns % 1_000_000_000
        _clock_nanosleep(MONOTONIC, _ABSOLUTE, room.clock.ctypes.data, 0)
        now = clock_ns(MONOTONIC, room)
    return now


@compilable
def send(shared: Shared, params: Wired, room: Room, replies: Frames, patience: int) -> int:
    """Send frames and count them; return the number that the wire did not accept, see `write_frames`."""
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
    """Track whether the CAN controller is bus-off, from the frames received.

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
    """Return the frames received since the last call; their arrivals (monotonic clock) go to `room.stamps`."""
    frames = Frames(0, room.identifiers, room.lengths, room.data)
    reading = read_frames(params.descriptor, room.reading, frames, room.stamps)
    now_ns = clock_ns(MONOTONIC, room)
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
    """Return the end index of the frames from `first` on that have arrived by a time on the monotonic clock."""
    last = first
    while last < count and room.stamps[last] <= time_ns:
        last += 1
    return last


@compilable
def handed_out(bus: BusConfig, shared: Shared, room: Room, first: int, last: int, time_ns: int) -> Frames:
    """Return the received frames `first` to `last` - 1 in `room`, for a tick at a time on the monotonic clock.

    Their arrivals go to `room.given_stamps`, time 0 for those that came before; stale frames are left out and
    counted.
    """
    count, given, start_ns = 0, room.given, room.pace[0].start_ns
    for i in range(first, last):
        came_ns = max(room.stamps[i], start_ns)
        if is_stale(bus, room.identifiers[i], time_ns - came_ns):
            shared.control[0].stale += 1
            continue
        length = room.lengths[i]
        given.identifiers[count], given.lengths[count] = room.identifiers[i], length
        for k in range(length):
            given.data[count, k] = room.data[i, k]
        room.given_stamps[count] = came_ns
        count += 1
    return Frames(count, given.identifiers, given.lengths, given.data)


@compilable
def wait_for_ticks(config: LoopConfig, params: RunParams, shared: Shared, room: Room, done: int) -> bool:
    """Wait until the tick after `done` ticks is due, and receive the frames; False: too far behind."""
    pace = room.pace[0]
    deadline = pace.start_ns + (done + 1) * config.step_ns
    pace.woken_ns = wait_until(deadline, room)
    late = pace.woken_ns - deadline
    note(shared.histograms[LATENESS], late)
    if late > params.limit_ns:
        return False
    pace.left = min(late // config.step_ns, params.ticks - done - 1)
    pace.come = receive(shared, params, room).count
    return True


@compilable
def frames_for_tick(config: LoopConfig, state: LoopState, params: RunParams, shared: Shared, room: Room) -> Frames:
    """Return the frames for the next tick to be computed, after the bus faults have been applied.

    Stores in `room.pace` the tick's reference time (when it was due, if it is caught up, else now), and the
    longest time that one of its frames, or an ECU in this process, has waited.
    """
    pace, stimuli, control = room.pace[0], params.stimuli, shared.control[0]
    pace.due_ns = pace.woken_ns
    if pace.left > 0:
        pace.due_ns = pace.start_ns + (state.tick - stimuli.origin[0] + 1) * config.step_ns
        if pace.taken == pace.come == CAPACITY:  # there was no room for all
            pace.come, pace.taken = receive(shared, params, room).count, 0
    last = arrived_by(room, pace.taken, pace.come, pace.due_ns) if pace.left > 0 else pace.come
    given = handed_out(config.inputs, shared, room, pace.taken, last, pace.due_ns)
    pace.taken = last
    given = received(stimuli, config.inputs, given, state.tick * config.step_ns, config.seed)
    if len(stimuli.bus_faults.origins) > 0:
        restamp(stimuli.bus_faults, given.count, room.given_stamps, pace.due_ns)
    if pace.left == 0:
        pace.due_ns = clock_ns(MONOTONIC, room)
    longest = longest_wait(given, room.given_stamps, pace.due_ns)
    pace.waited_ns = max(longest, control.turn_late_ns, control.line_late_ns)
    control.line_late_ns = 0
    return given


@compilable
def note_given(
    config: LoopConfig, before: LoopState, after: LoopState, room: Room, given: Frames, command: int
) -> None:
    """Record the arrival times of a tick's frames: for the messages' time-outs, and for the delay of a command."""
    pace = room.pace[0]
    if given.count > 0:
        previous_ns, now_ns = pace.due_ns - config.step_ns, before.tick * config.step_ns
        backdate(config.inputs, after.reception, given, room.given_stamps, previous_ns, now_ns)
    if after.counts.accepted > before.counts.accepted and pace.command_ns == 0:
        pace.command_ns = first_arrival(given, room.given_stamps, command)


@compilable
def send_replies(shared: Shared, params: RunParams, room: Room, replies: Frames, stopping: bool) -> None:
    """Send a tick's frames, and record the delay of the command that they answer."""
    pace, unsent = room.pace[0], 0
    if replies.count > 0:
        unsent = send(shared, params, room, replies, _LAST_PATIENCE if stopping else 0)
    sent_ns = clock_ns(MONOTONIC, room)
    if pace.command_ns != 0 and unsent == 0 and is_among(replies, params.feedback):
        note(shared.histograms[DELAY], sent_ns - pace.command_ns)
        pace.command_ns = 0
    note_frames(shared, replies, sent_ns - pace.start_ns, 1)
    count_bits(shared, replies)


@compilable
def run_realtime(
    config: LoopConfig, state: LoopState, params: RunParams, shared: Shared, room: Room
) -> tuple[LoopState, int]:
    """Run ticks until stopped or done; with `is_last` one more with the motors off, which sends every message.

    Ticks that were missed are made up for at once, each with its row, and send nothing. Each tick gets the frames
    that had arrived by its own time, so that the gate moves as if none had been missed. Returns the state, and
    ENDED, OVERRUN or DIVERGED.
    """
    control, pace, stimuli = shared.control[0], room.pace[0], params.stimuli
    outcome, stopping, is_over, origin = ENDED, False, False, stimuli.origin[0]
    none = Frames(0, room.identifiers, room.lengths, room.data)
    # The scenario's time 0 is now: taken here, where no interpreter lock can hold up what follows.
    pace.start_ns = clock_ns(MONOTONIC, room) - (state.tick - origin) * config.step_ns
    control.epoch_ns = clock_ns(_REALTIME, room) - (state.tick - origin) * config.step_ns
    room.drained[0] = pace.woken_ns = pace.start_ns
    pace.command_ns, pace.left = 0, -1
    while not is_over:
        gate = in_force(config, stimuli.faults.row)  # outside the inner loop, as in `episode`
        while True:
            done = state.tick - origin
            if pace.left < 0:
                stopping = control.stop != 0 or done >= params.ticks or outcome != ENDED
                pace.come, pace.taken, pace.left = 0, 0, 0
                if stopping and params.is_last == 0:
                    is_over = True
                    break
                if not stopping and not wait_for_ticks(config, params, shared, room, done):
                    outcome, pace.left = OVERRUN, -1
                    continue
            if turns(stimuli, done * config.step):
                break
            given, pace.waited_ns = none, 0
            if not stopping:
                given = frames_for_tick(config, state, params, shared, room)
            is_silent, before = pace.left > 0, state
            control.overruns += int(is_silent)
            missed, dropped = float(control.overruns), float(control.dropped + control.stale)
            bench = Bench(missed, dropped, 1e-9 * pace.waited_ns, not_made(stimuli))
            place = next_row(shared)
            row = shared.rows[place : place + 1]
            state, replies, is_sound = advance(gate, state, stimuli, given, row, bench, is_silent, stopping)
            control.rows += 1
            note_given(config, before, state, room, given, params.command)
            note_arrivals(shared, given, room.given_stamps, pace.start_ns)
            count_bits(shared, given)
            pace.left -= 1
            outcome = outcome if is_sound else DIVERGED
            if pace.left >= 0:
                continue
            send_replies(shared, params, room, replies, stopping)
            control.tick = state.tick - origin
            if stopping:
                is_over = True
                break
            note(shared.histograms[EXECUTION], clock_ns(MONOTONIC, room) - pace.woken_ns)
    return state, outcome
