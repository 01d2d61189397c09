"""The real-time loop on a simulated clock, in plain Python around the compiled tick, and in real time."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import math
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, cast

import numpy as np
import pytest
from hil_support import (
    BENCH_STATUS,
    COMMAND,
    GATE,
    LEFT_DRIVE,
    OPEN,
    RIGHT_DRIVE,
    both,
    catch_up,
    command_frame,
    decoded,
    frames_of,
    loop_config,
    outside,
    rows_of,
    start_of,
    stimulus_plan,
)
from simulated_kernel import EPOCH, MS, START, Datagram, SimulatedKernel, from_a_can_socket, from_a_pump

from liftgate_hil.codec.frames import Frames, empty_frames
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import OverrunError, PlantDivergedError
from liftgate_hil.loop.advance import write_row
from liftgate_hil.loop.datagrams import arrival_of, make_buffers, read_frames, write_frames
from liftgate_hil.loop.histogram import BINS, bin_of
from liftgate_hil.loop.observers import Trace
from liftgate_hil.loop.python_loop import Loop
from liftgate_hil.loop.realtime_loop import DIVERGED, ENDED, OVERRUN, RunParams, make_room, run_realtime
from liftgate_hil.loop.realtime_run import RealtimeRun, feedback_identifiers
from liftgate_hil.loop.rings import DELAY, EXECUTION, LATENESS, Memory, RingReader
from liftgate_hil.loop.tick import STOPPED, LoopState
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS, ON_TIME, ROW_WIDTH, Timing
from liftgate_hil.stimuli.command_queue import post_values
from liftgate_hil.transport.base import LinkCounts

Rows = list[tuple[int, bytes]]
TAKES = 40_000  # ns that a waking takes, however many ticks it makes up


class Rehearsal(SimulatedKernel):
    """A run of `run_realtime` whose time, frames and faults the test controls.

    The time that a waking takes passes before the loop asks for the time for the fourth time: it asks after
    waking, after reading, before the tick, after sending, and at the end. The last tick follows without a waking.
    `refuse`, given the tick and the number of the trial, returns whether the wire refuses the frames.
    """

    def __init__(self, rig: Rig, rate: float = 1000.0, rows: int = 4096, frames: int = 4096) -> None:
        super().__init__()
        self.rig = rig
        self.config = loop_config(rate, rig)
        self.memory = Memory(rows, frames)
        self.shared = self.memory.shared
        self.control = self.shared.control[0]
        self.sent: list[Rows] = []  # by waking, the last tick's at the end
        self.refuse: Callable[[int, int], bool] = lambda tick, trial: False
        self.ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.theirs.setblocking(False)
        self._asked = self._trials = 0  # since the last waking
        self._taken: Rows = []

    def clock_gettime(self, clock: int, at: int) -> int:
        if clock == 1:
            self._asked += 1
            self.now += TAKES if self._asked == 4 else 0
        return super().clock_gettime(clock, at)

    def clock_nanosleep(self, clock: int, flags: int, request: int, remaining: int) -> int:
        self.sent.append([])
        self._asked = self._trials = 0
        return super().clock_nanosleep(clock, flags, request, remaining)

    def sendmmsg(self, descriptor: int, headers: int, count: int, flags: int) -> int:
        if not self.sent or (len(self.sent) == self.wakings and self._asked == 5):
            self.sent.append([])  # those of the last tick
            self._asked, self._trials = 3, 0
        self._trials += 1
        if self.refuse(len(self.sent) - 1, self._trials):
            ctypes.set_errno(errno.EAGAIN)
            return -1
        sent = super().sendmmsg(descriptor, headers, count, flags)
        arrived = self._waiting()  # the kernel keeps ten
        self.sent[-1] += arrived
        self._taken += arrived
        return sent

    @property
    def steps(self) -> list[int]:
        """Number of ticks at each waking, missed ticks included."""
        found, count, before = [], 0, 0.0
        for missed in self.column("ticks_missed"):
            count += 1
            if missed == before:
                found.append(count)
                count = 0
            before = missed
        return found

    def run(self, ticks: int, state: LoopState | None = None, limit_ns: int = 10**9) -> tuple[LoopState, int]:
        """Run up to this many ticks, and the last one; return the state after it and the outcome."""
        feedback = np.array(feedback_identifiers(self.rig), dtype=np.int64)
        self.stimuli = stimulus_plan(self.config)
        params = RunParams(
            descriptor=self.ours.fileno(),
            ticks=ticks,
            limit_ns=limit_ns,
            command=COMMAND,
            feedback=feedback,
            stimuli=self.stimuli,
            is_last=1,
        )
        begin = state or start_of(self.config)
        state_and_outcome = self.call(run_realtime, self.config, begin, params, self.shared, make_room())
        return cast("tuple[LoopState, int]", state_and_outcome)

    def give(self, *rows: tuple[int, bytes], age: int | None = None) -> None:
        """Put frames on the wire; with an age [ns], as by this project's pump thread that long after arrival."""
        if age is None:
            write_frames(self.theirs.fileno(), make_buffers(), frames_of(rows), 0)
            return
        for identifier, payload in rows:
            row = struct.pack("<IB3x64sqq", identifier, len(payload), payload, self.now - age, 0)
            self.theirs.send(row)

    def arrived(self) -> Rows:
        """All frames that reached the wire's other end."""
        return [*self._taken, *self._waiting()]

    def _waiting(self) -> Rows:
        frames = empty_frames(1024)
        stamps = np.zeros(1024, dtype=np.int64)
        got: Rows = []
        while True:
            reading = read_frames(self.theirs.fileno(), make_buffers(), frames, stamps)
            if reading.count == 0:
                return got
            got += rows_of(frames._replace(count=reading.count))

    def rows(self) -> list[list[float]]:
        """All rows that the ring holds."""
        rows = RingReader(self.shared.rows, self.shared.control, "rows").take()
        return [list(row) for row in rows]

    def column(self, name: str) -> list[float]:
        """Values of one column of the ring's rows."""
        return [row[list(COLUMNS).index(name)] for row in self.rows()]

    def noted(self, which: int) -> dict[int, int]:
        """Counts by bin of a histogram (LATENESS, EXECUTION or DELAY), without empty bins."""
        histogram = self.shared.histograms[which]
        return {int(at): int(histogram[at]) for at in np.flatnonzero(histogram)}

    def close(self) -> None:
        self.ours.close()
        self.theirs.close()
        self.memory.close()


@pytest.fixture
def rehearse(rig: Rig) -> Iterator[Callable[..., Rehearsal]]:
    """Return a function that makes a Rehearsal, which is closed with the test."""
    made: list[Rehearsal] = []

    def make(**more: Any) -> Rehearsal:
        made.append(Rehearsal(rig, **more))
        return made[-1]

    yield make
    for each in made:
        each.close()


def flat(value: Any) -> list[bytes]:
    """The bytes of every number of a state, in order."""
    if isinstance(value, tuple):
        return [part for each in value for part in flat(each)]
    return [np.asarray(value).tobytes()]


def opening(rig: Rig, counter: int) -> tuple[int, bytes]:
    """Return a valid DriveCommand to open with 60 % duty, as (identifier, payload)."""
    return command_frame(rig, counter, **both(60.0, OPEN, release=1))


class Given:
    """A transport of the Python loop that keeps sent frames; the test gives received ones to `advance` itself."""

    name = "given"
    is_up = True

    def __init__(self) -> None:
        self.sent: Rows = []

    def send(self, frames: Frames) -> None:
        self.sent += rows_of(frames)

    def taken(self) -> Rows:
        """Frames sent since the previous call."""
        sent, self.sent = self.sent, []
        return sent

    def receive(self, timeout: float = 0.0) -> Frames:
        raise AssertionError

    def counts(self) -> LinkCounts:
        return LinkCounts()

    def close(self) -> None:
        raise AssertionError


@pytest.mark.parametrize("rate", [200.0, 1000.0, 10_000.0])
def test_the_real_time_loop_equals_the_python_loop(rehearse: Callable[..., Rehearsal], rig: Rig, rate: float):
    play = rehearse(rate=rate)
    every = max(1, round(rate / 100))
    batches: dict[int, Rows] = {
        n * every: [opening(rig, n), (0x55, b"x"), (0x777, b"12345678")] for n in range(40)
    }
    batches[7 * every][0] = (COMMAND, b"spoilt!!")
    play.at = lambda waking: play.give(*batches.get(waking, []))
    state, outcome = play.run(40 * every)
    assert outcome == ENDED

    transport, shown = Given(), Trace()
    loop = Loop(play.config, start_of(play.config), stimulus_plan(play.config), transport, sinks=[shown])
    sent: list[Rows] = []
    for tick in range(40 * every):
        loop.advance(frames_of(batches.get(tick, [])))
        sent.append(transport.taken())
    loop.finish()
    assert [*sent, transport.taken()] == play.sent
    assert shown.rows().tolist() == play.rows()
    assert len(shown.rows()) == 40 * every + 1
    assert flat(loop.state) == flat(state)
    assert state.tick == 40 * every + 1
    assert state.counts.accepted == 39
    assert loop.frames_sent == play.shared.control[0].sent
    assert loop.load.bits == play.shared.control[0].bits
    assert play.arrived() == [row for rows in play.sent for row in rows]


def test_missed_ticks_are_caught_up_one_by_one_bit_for_bit(
    rehearse: Callable[..., Rehearsal], rig: Rig, fast_tick: Callable[..., Any]
):
    play = rehearse()
    batches: dict[int, Rows] = {10 * n: [opening(rig, n), (0x55, b"x")] for n in range(30)}
    play.at = lambda waking: play.give(*batches.get(waking, []))
    play.late = {110: 3_500_000, 171: MS}
    found, outcome = play.run(400)
    assert outcome == ENDED
    assert play.steps[:-1].count(1) == len(play.steps) - 3
    assert sorted(play.steps)[-2:] == [2, 4]

    state, missed = start_of(play.config), 0
    sent: list[Rows] = []
    rows: list[list[float]] = []
    for waking, steps in enumerate(play.steps):
        frames = frames_of(batches.get(waking, []))
        if waking < len(play.steps) - 1:
            ticked = catch_up(fast_tick, play.config, state, frames, steps, missed)
        else:
            ticked = [fast_tick(play.config, state, frames, outside(missed=missed, stop=True))]
        for number, (_, _, truth, sensed) in enumerate(ticked, 1):
            row = np.empty(ROW_WIDTH)
            so_far = missed + min(number, steps - 1)
            write_row(row, truth, sensed, ON_TIME._replace(ticks_missed=float(so_far)), 0.0)
            rows.append(row.tolist())
        state, missed = ticked[-1][0], missed + steps - 1
        sent.append([row for _, replies, _, _ in ticked for row in rows_of(replies)])
    assert sent == play.sent
    assert rows == play.rows()
    assert flat(state) == flat(found)
    assert missed == play.shared.control[0].overruns == 3 + 1


@pytest.mark.parametrize(
    ("late", "steps"), [(0, 1), (1, 1), (MS - 1, 1), (MS, 2), (MS + 1, 2), (5 * MS - 1, 5), (900 * MS, 901)]
)  # fmt: skip
def test_after_a_late_waking_the_plant_catches_up_whole_periods(
    rehearse: Callable[..., Rehearsal], late: int, steps: int
):
    play = rehearse()
    play.late = {3: late}

    def at(waking: int) -> None:
        if waking % 100 == 0:
            play.arrived()
        if waking == 3:
            play.give((0x55, b"x"))

    play.at = at
    state, outcome = play.run(1500)
    assert outcome == ENDED
    assert play.steps[3] == steps
    assert play.steps[:3] == [1, 1, 1]
    assert play.shared.control[0].overruns == steps - 1
    assert state.tick == 1501 == play.shared.control[0].tick
    # Model time is wall time again: the tick after the late one is on time, to what the late one took.
    assert play.now == START + 1500 * MS + 2 * TAKES
    assert sum(play.noted(LATENESS).values()) == len(play.steps) - 1
    # Each tick has its row, the missed ones too; what has come at the waking is taken in the last of them.
    assert play.column("time_s") == pytest.approx([0.001 * (1 + n) for n in range(1501)])
    frames = RingReader(play.shared.frames, play.shared.control, "frames").take()
    assert frames["time_ns"][frames["is_sent"] == 0].tolist() == [4 * MS + late]


def test_each_tick_of_a_catch_up_gets_the_frames_arrived_by_then(rehearse: Callable[..., Rehearsal], rig: Rig):
    """The gate moves as if no tick had been missed; a frame waits for its tick, not for the waking."""
    play = rehearse()
    play.late = {10: 30 * MS + 1}

    def at(waking: int) -> None:
        if waking == 10:  # 41 ms after the start
            play.give(opening(rig, 0), age=25 * MS)
            play.give(opening(rig, 1), (0x55, b"x"), age=15 * MS)
            play.give(opening(rig, 2), age=0)

    play.at = at
    state, _ = play.run(60)
    assert play.steps[10] == 31
    assert state.counts.accepted == 3
    assert state.counts.foreign == 1
    frames = RingReader(play.shared.frames, play.shared.control, "frames").take()
    came = frames[frames["is_sent"] == 0]
    assert (came["time_ns"] // MS).tolist() == [16, 26, 26, 41]
    assert max(play.column("command_delay_s")) < 0.002


def test_a_catch_up_reads_more_frames_than_one_batch_holds(rehearse: Callable[..., Rehearsal], rig: Rig):
    play = rehearse()
    play.late = {10: 60 * MS}
    come: list[Datagram] = []
    for number in range(6):
        stamp = START + (12 + 9 * number) * MS
        come += [from_a_pump(0x55, bytes([k % 256]), stamp) for k in range(400)]
        come.append(from_a_pump(*opening(rig, number), stamp))

    def arrivals(most: int) -> list[Datagram]:
        taken = come[:most] if play.wakings > 10 else []
        del come[: len(taken)]
        return taken

    play.arrivals = arrivals
    state, _ = play.run(100)
    assert play.shared.control[0].stale == 0
    assert (state.counts.accepted, state.counts.foreign) == (6, 2400)


def test_a_command_older_than_its_timeout_has_no_effect(rehearse: Callable[..., Rehearsal], rig: Rig):
    timeout = int(play_timeout_ns(rig))
    play = rehearse()

    def at(waking: int) -> None:
        if waking == 400:
            play.give(opening(rig, 0), age=timeout + 2 * MS)
            play.give((0x55, b"x"), age=timeout + 2 * MS)
        if waking == 500:
            play.give(opening(rig, 1), age=timeout - 2 * MS)

    play.at = at
    monkeyed = play.run(450)[0]
    assert (monkeyed.counts.accepted, monkeyed.counts.foreign) == (0, 1)
    assert play.shared.control[0].stale == 1
    # What the ECU sent and the gate never got is the bench's doing: rows say so from then on.
    assert play.column("frames_dropped") == [*(400 * [0.0]), *(51 * [1.0])]


@pytest.mark.parametrize("age_ms", [0, 10, 25])
def test_a_command_timeout_counts_from_arrival_and_not_from_reading(
    rehearse: Callable[..., Rehearsal], rig: Rig, age_ms: int
):
    timeout_ms = play_timeout_ns(rig) // MS
    play = rehearse()
    play.at = lambda waking: play.give(opening(rig, 0), age=age_ms * MS) if waking == 100 else None
    state, _ = play.run(200)
    assert (state.counts.accepted, state.timeouts) == (1, 1)
    driven = np.flatnonzero(np.array(play.column("left_duty")) > 0.0)
    waited_ms = max(0, age_ms - 1)  # what has come since the tick before has not waited
    assert driven.tolist() == list(range(100, 100 + timeout_ms - waited_ms))


@pytest.mark.parametrize("age_ms", [20, 150])  # 150 ms: longer than the command's time-out
def test_the_delay_of_a_command_from_before_the_run_counts_from_the_start_of_the_run(
    rehearse: Callable[..., Rehearsal], rig: Rig, age_ms: int
):
    """The ECU sends before the loop's thread has begun, which may take longer than a tolerance."""
    play = rehearse()
    play.at = lambda waking: play.give(opening(rig, 0), age=age_ms * MS) if waking == 0 else None
    state, _ = play.run(10)
    assert state.counts.accepted == 1
    assert play.shared.control[0].stale == 0
    assert play.column("command_delay_s")[0] == pytest.approx(0.001)


def test_delay_of_a_sent_frame_on_its_way_counts_as_bench_delay(rehearse: Callable[..., Rehearsal]):
    play = rehearse()

    def at(waking: int) -> None:
        if waking == 50:
            play.shared.control[0].line_late_ns = 12 * MS

    play.at = at
    play.run(60)
    assert np.flatnonzero(play.column("command_delay_s")).tolist() == [50]
    assert play.column("command_delay_s")[50] == pytest.approx(0.012)


def play_timeout_ns(rig: Rig) -> int:
    return int(rig.input_config().messages[0].timeout_ns)


def test_a_catch_up_does_not_run_past_the_end_of_the_run(rehearse: Callable[..., Rehearsal]):
    play = rehearse()
    play.late = {5: 500 * MS}
    state, _ = play.run(10)
    assert state.tick == 10 + 1
    assert play.shared.control[0].overruns == 4


@pytest.mark.parametrize(("late", "expected"), [(50 * MS, ENDED), (50 * MS + 1, OVERRUN)])
def test_a_loop_later_than_its_limit_ends_with_the_motors_off(
    rehearse: Callable[..., Rehearsal], rig: Rig, late: int, expected: int
):
    play = rehearse()
    play.at = lambda waking: play.give(opening(rig, waking)) if waking == 0 else None
    play.late = {20: late}
    state, outcome = play.run(100, limit_ns=50 * MS)
    assert outcome == expected
    if expected == OVERRUN:
        assert state.tick == 20 + 1
    assert last_words(play) == everything(play.rig)


def everything(rig: Rig) -> list[int]:
    """Identifiers of all frames that are always sent; timing figures are not known before their first values."""
    return sorted(
        {rig.messages[wire.message].frame_id for wire in rig.outputs if wire.quantity not in Timing._fields}
    )


def last_words(play: Rehearsal) -> list[int]:
    """Check that the last tick has the motors off; return the sorted identifiers of its frames."""
    last = play.sent[-1]
    (status,) = decoded(play.rig, frames_of(last), "BenchStatus")
    assert status["EmulatorState"] == STOPPED
    final = dict(zip(COLUMNS, play.rows()[-1], strict=True))
    assert (final["left_duty"], final["right_duty"]) == (0.0, 0.0)
    assert (final["left_coast"], final["right_coast"]) == (1.0, 1.0)
    return sorted(identifier for identifier, _ in last)


@pytest.mark.parametrize("where", ["gate_angle", "right"])
def test_a_diverged_plant_ends_the_loop_with_the_motors_off(rehearse: Callable[..., Rehearsal], where: str):
    play = rehearse()
    state = start_of(play.config)
    plant = state.plant._replace(gate_angle=math.nan)
    if where == "right":
        plant = state.plant._replace(right=state.plant.right._replace(current=math.nan))
    _, outcome = play.run(100, state._replace(plant=plant))
    assert outcome == DIVERGED
    assert len(play.steps) == 2
    assert sorted(identifier for identifier, _ in play.sent[-1]) == everything(play.rig)


def test_a_loop_asked_to_stop_sends_every_message_once_and_ends(rehearse: Callable[..., Rehearsal], rig: Rig):
    play = rehearse()

    def at(waking: int) -> None:
        play.give(*([opening(rig, waking // 10)] if waking % 10 == 0 else []))
        if waking == 57:
            play.shared.control[0].stop = 1

    play.at = at
    state, outcome = play.run(2**62)
    assert outcome == ENDED
    assert state.tick == 59
    assert last_words(play) == everything(rig)
    assert play.column("left_duty")[-2] > 0.5


def test_a_loop_stopped_before_it_began_only_sends_its_last_frames(rehearse: Callable[..., Rehearsal]):
    play = rehearse()
    play.shared.control[0].stop = 1
    state, outcome = play.run(2**62)
    assert (state.tick, outcome, play.wakings) == (1, ENDED, 0)
    assert last_words(play) == everything(play.rig)


def test_the_last_frames_are_retried_while_the_queue_is_full(rehearse: Callable[..., Rehearsal]):
    play = rehearse()
    play.refuse = lambda tick, trial: tick == 10 and trial % 4 != 0
    play.run(10)
    assert last_words(play) == everything(play.rig)
    control = play.shared.control[0]
    assert (control.unsent, control.unsent_full) == (0, 0)
    assert play.arrived() == [row for rows in play.sent for row in rows]


def test_retries_of_the_last_frames_are_limited(rehearse: Callable[..., Rehearsal]):
    play = rehearse()
    play.refuse = lambda tick, trial: tick == 10
    play.run(10)
    control = play.shared.control[0]
    assert control.unsent == control.unsent_full == len(everything(play.rig))
    assert control.last_error == errno.EAGAIN
    assert control.sent == sum(len(rows) for rows in play.sent)
    assert 100 * MS <= play.now - START - 10 * MS <= 110 * MS


def test_frames_that_a_full_send_queue_refuses_are_counted_and_the_run_goes_on(rehearse: Callable[..., Rehearsal]):
    play = rehearse()
    play.refuse = lambda tick, trial: 20 <= tick < 40
    play.run(100)
    control = play.shared.control[0]
    assert control.unsent == control.unsent_full > 0
    assert control.sent == sum(len(rows) for rows in play.sent) == len(play.arrived())
    free = rehearse()
    free.run(100)
    assert free.shared.control[0].sent == control.sent + control.unsent
    assert free.shared.control[0].unsent == 0


def test_errors_of_a_closed_socket_are_counted_and_the_run_goes_on(rehearse: Callable[..., Rehearsal]):
    play = rehearse()
    play.at = lambda waking: play.ours.close() if waking == 50 else None
    number = play.ours.fileno()
    state, outcome = play.run(100)
    assert (state.tick, outcome) == (101, ENDED)
    assert number >= 0
    control = play.shared.control[0]
    assert control.receive_errors == 50
    assert control.last_error == errno.EBADF
    assert control.unsent > 0
    assert control.unsent_full == 0


# Commands while it runs.


def test_a_value_set_by_the_operator_holds_from_the_next_tick_until_another_is_set(
    rehearse: Callable[..., Rehearsal],
):
    play = rehearse()
    said = {20: {"hand_force_n": 25.0}, 50: {"hand_force_n": math.nan}, 30: {"snow_mass_kg": 7.0}}
    play.at = lambda waking: post_values(play.stimuli.queue, said[waking]) if waking in said else None
    play.late = {30: 4 * MS}
    play.run(100)
    assert play.column("hand_force_n") == [0.0] * 20 + [25.0] * 34 + [0.0] * 47
    # What is made up for was missed before the command came; but it is taken as what has come, as frames are.
    assert play.column("snow_mass_kg") == [0.0] * 30 + [7.0] * 71
    assert play.stimuli.queue.head.tolist() == [3, 3]


def test_posted_timing_figures_are_sent_on_the_bus(rehearse: Callable[..., Rehearsal], rig: Rig):
    play = rehearse()
    told = Timing(*(20.0 * (10 + place) for place in range(len(Timing._fields))))
    play.at = lambda waking: post_values(play.stimuli.queue, told._asdict()) if waking == 5 else None
    play.run(300)
    sent = frames_of([row for rows in play.sent for row in rows])
    wires = [wire for wire in rig.outputs if wire.quantity in Timing._fields]
    assert {wire.quantity for wire in wires} >= {"lateness_p50", "execution_max", "command_delay_max"}
    for wire in wires:
        rows = decoded(rig, sent, wire.message)
        assert rows, wire
        for row in rows:
            value = wire.scale * row[wire.signal] + wire.offset
            assert value == pytest.approx(getattr(told, wire.quantity)), wire


# Delay from command to feedback.


def first_feedback(play: Rehearsal, waking: int) -> int:
    """First tick, from this waking on, whose sent frames show a command."""
    shown = set(feedback_identifiers(play.rig))
    return next(
        tick for tick in range(waking, len(play.sent)) if shown & {identifier for identifier, _ in play.sent[tick]}
    )


def when_sent(tick: int) -> int:
    """Return the time [ns] at which frames of a tick are sent if no waking was late."""
    return START + (tick + 1) * MS + TAKES


@pytest.mark.parametrize("waking", [20, 21, 23, 24])
@pytest.mark.parametrize("age", [0, 1, 400_000, 900_000])
def test_the_command_delay_lasts_from_arrival_to_the_first_feedback(
    rehearse: Callable[..., Rehearsal], rig: Rig, waking: int, age: int
):
    play = rehearse()
    play.at = lambda now: play.give(opening(rig, 1), age=age) if now == waking else None
    play.run(100)
    assert set(feedback_identifiers(rig)) <= {LEFT_DRIVE, RIGHT_DRIVE, GATE, BENCH_STATUS}
    delay = when_sent(first_feedback(play, waking)) - (START + (waking + 1) * MS - age)
    assert play.noted(DELAY) == {bin_of(delay): 1}
    assert delay <= 5 * MS + age + TAKES


def test_the_oldest_command_without_feedback_sets_the_delay(rehearse: Callable[..., Rehearsal], rig: Rig):
    play = rehearse()

    def at(waking: int) -> None:
        if waking in (21, 22, 23):
            play.give((0x55, b""), opening(rig, waking), opening(rig, waking), age=7000 * waking)

    play.at = at
    play.run(100)
    arrival = START + 22 * MS - 7000 * 21
    assert play.noted(DELAY) == {bin_of(when_sent(first_feedback(play, 21)) - arrival): 1}


def test_feedback_that_was_not_sent_does_not_end_the_command_delay(rehearse: Callable[..., Rehearsal], rig: Rig):
    play = rehearse()
    play.at = lambda waking: play.give(opening(rig, 1), age=0) if waking == 20 else None
    play.refuse = lambda tick, trial: 15 <= tick < 42
    play.run(100)
    shown = first_feedback(play, 20)
    assert shown >= 42
    assert play.noted(DELAY) == {bin_of(when_sent(shown) - (START + 21 * MS)): 1}


def test_a_refused_command_has_no_command_delay(rehearse: Callable[..., Rehearsal], rig: Rig):
    play = rehearse()
    play.at = lambda waking: play.give((COMMAND, b"spoilt!!"), (0x55, b""), age=0)
    play.run(50)
    assert play.noted(DELAY) == {}


REAL = EPOCH + START


@pytest.mark.parametrize(
    ("stamp", "age"),
    [
        (0, 0),
        (START, 0),
        (START - 1, 1),
        (START - 999_999_999, 999_999_999),
        (START - 5 * 10**9, 5 * 10**9),  # a pump's: it was there long before the loop could read it
        (START + 10**9, 0),
        (-REAL, 0),
        (-(REAL - 1234), 1234),
        (-(REAL - 6 * 10**9), 10**9),  # the wall clock was set forward by 6 s since
        (-(REAL + 6 * 10**9), 0),  # or back
        (-1, 10**9),
        (-(2**62), 0),
        (2**62, 0),
    ],
)
def test_an_arrival_time_is_never_after_now_and_a_kernels_never_before_the_last_read(stamp: int, age: int):
    # All that was there was last read a second ago.
    assert arrival_of(stamp, START, REAL, START - 10**9) == START - age


@pytest.mark.parametrize(("step", "age"), [(0, 250_000), (6 * 10**9, MS), (-6 * 10**9, 0)])
def test_kernel_timestamps_are_converted_even_if_the_wall_clock_was_set(
    rehearse: Callable[..., Rehearsal], rig: Rig, step: int, age: int
):
    play = rehearse()

    def arrivals(most: int) -> list[Datagram]:
        if play.wakings - 1 == 24:
            come = from_a_can_socket(*opening(rig, 1), play.now + play.real - 250_000, dropped=17)
            play.real += step
            return [come]
        if play.wakings - 1 == 26:
            return [from_a_can_socket(0x55, b"x", play.now + play.real, dropped=17 + 5)]
        return []

    play.arrivals = arrivals
    play.run(50)
    delay = when_sent(first_feedback(play, 24)) - (START + 25 * MS - age)
    assert play.noted(DELAY) == {bin_of(delay): 1}
    assert play.shared.control[0].dropped == 5  # 17 were dropped before the first frame, and so before the run


# What it leaves behind.


def test_the_histograms_count_every_tick_once(rehearse: Callable[..., Rehearsal]):
    play = rehearse()
    play.late = {3: 100, 4: 100, 5: 2_500_000}
    play.run(20)
    # The tick after the late one is late by nothing: its deadline is on the same grid.
    assert play.noted(LATENESS) == {bin_of(0): 15, bin_of(100): 2, bin_of(2_500_000): 1}
    assert play.noted(EXECUTION) == {bin_of(TAKES): 18}
    assert play.noted(DELAY) == {}


def test_rings_that_wrap_hold_the_last_rows(rehearse: Callable[..., Rehearsal], rig: Rig):
    play = rehearse(rows=16, frames=32)
    play.at = lambda waking: play.give((waking, bytes([waking] * 3)), age=300_000)
    play.run(100)
    times = play.shared.rows[:, 0]
    assert sorted(times) == pytest.approx([0.001 * n for n in range(101 - 15, 102)])
    assert times[100 % 16] == pytest.approx(0.101)
    control = play.shared.control[0]
    assert control.rows == 101
    assert control.frames == control.sent + 100
    logged: list[tuple[int, int, bytes]] = []
    for tick, rows in enumerate(play.sent):
        woken = (tick + 1) * MS
        if tick < 100:
            logged.append((woken - 300_000, tick, bytes([tick] * 3)))
        done = min(woken, 100 * MS + TAKES) + TAKES
        logged += [(done, *row) for row in rows]
    assert len(logged) == control.frames
    ring = play.shared.frames
    for at in range(len(logged) - 32, len(logged)):
        row = ring[at % 32]
        payload = row.payload[: row.length].tobytes()
        assert (row.time_ns, row.identifier, payload) == logged[at]


# As it is in use.


class SocketLine:
    """Line at one end of a socket pair; the test holds the other end."""

    name = "pair"
    threads = ()

    def __init__(self, news: Sequence[str | None] = ()) -> None:
        self._ours, self.other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for end in (self._ours, self.other):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        self.descriptor = self._ours.fileno()
        self.news = list(news)
        self.looks = self.drains = self.lost = 0

    def dropped(self) -> int:
        return self.lost

    def drain(self) -> None:
        self.drains += 1

    def watch(self, control: Any) -> str | None:
        self.looks += 1
        return self.news.pop(0) if self.news else None

    def counts(self) -> LinkCounts:
        return LinkCounts(send_failures=10, losses=3)

    def close(self) -> None:
        self._ours.close()
        self.other.close()

    def received(self) -> Rows:
        got: Rows = []
        frames, stamps = empty_frames(1024), np.zeros(1024, dtype=np.int64)
        while True:
            count = read_frames(self.other.fileno(), make_buffers(), frames, stamps).count
            if count == 0:
                return got
            got += rows_of(frames._replace(count=count))


class Asked:
    """Stand-in for the `--realtime` request, refused slowly as by a busy machine."""

    def __init__(self) -> None:
        self.refused = ["locked memory"]
        self.calls: list[str] = []

    def reported(self) -> list[str]:
        return [f"refused: {each}" for each in self.refused]

    def enter(self) -> None:
        threading.Event().wait(0.05)
        self.refused.append("a CPU")
        self.calls.append("enter")

    def beside(self, threads: Sequence[int] = ()) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()


@pytest.fixture
def ready(rig: Rig) -> Iterator[Callable[..., RealtimeRun]]:
    """Return a function that makes a RealtimeRun on a SocketLine, which is closed with the test."""
    kept: list[tuple[SocketLine, Memory]] = []

    def make(**more: Any) -> RealtimeRun:
        config = loop_config(rig=rig)
        line = more.pop("line", None) or SocketLine()
        memory = Memory(more.pop("rows", 4096), 4096)
        kept.append((line, memory))
        said: list[str] = []
        options: dict[str, Any] = {"limit_ns": 3600 * 10**9, "say": said.append, "alarm": said.append, **more}
        state = options.pop("state", None) or start_of(config)
        return RealtimeRun(
            config=config,
            state=state,
            stimuli=stimulus_plan(config),
            line=line,
            memory=memory,
            rig=rig,
            bitrate=500_000.0,
            **options,
        )

    yield make
    for line, memory in kept:
        line.close()
        memory.close()
    assert [each.name for each in threading.enumerate() if each.name == "real-time loop"] == []


def never() -> bool:
    return False


def ends_stopped(run: RealtimeRun) -> bool:
    """Whether the last frames on the wire said that the motors are off."""
    always = everything(run.rig)
    rows = run.line.received()  # type: ignore[attr-defined]
    last = [row for row in rows if row[0] in always][-len(always) :]
    assert sorted(identifier for identifier, _ in last) == always
    return bool(decoded(run.rig, frames_of(last), "BenchStatus")[-1]["EmulatorState"] == STOPPED)


def test_a_real_time_run_counts_ticks_frames_and_bus_load(ready: Callable[..., RealtimeRun], rig: Rig):
    shown = Trace()
    run = ready(sinks=[shown])
    run.begin()
    control = run.memory.shared.control[0]
    assert all(int(control[name]) == 0 for name in control.dtype.names)
    assert not run.memory.shared.histograms.any()
    # A recorder that looks on meanwhile must not see the rehearsal.
    assert not run.memory.shared.rows.any()
    assert not run.memory.shared.frames.identifier.any()
    assert run.line.received() == []  # type: ignore[attr-defined]
    write_frames(
        run.line.other.fileno(),  # type: ignore[attr-defined]
        make_buffers(),
        frames_of([opening(rig, 0), (0x55, b"x")]),
        0,
    )
    run.run(200, never)
    summary = run.summary()
    assert summary.ticks == 201 == control.tick
    assert summary.timing.lateness.count + summary.overruns == 200
    assert summary.timing.execution.count == summary.timing.lateness.count
    assert summary.timing.delay.count == 1
    assert (summary.received.accepted, summary.received.foreign) == (1, 1)
    assert summary.link == LinkCounts(send_failures=10, losses=3)
    assert shown.rows().shape == (201, ROW_WIDTH)
    # Each tick once, the missed ones too.
    assert shown.rows()[:, 0] == pytest.approx([0.001 * (1 + n) for n in range(201)])
    assert control.rows == 201
    rows = run.line.received()  # type: ignore[attr-defined]
    assert control.frames == len(rows) + 2
    assert summary.frames_sent == len(rows) - 10  # which the line had, but could not send
    bits = sum(47 + 8 * len(payload) for _, payload in [*rows, opening(rig, 0), (0x55, b"x")])
    assert control.bits == bits
    assert summary.bus_load_percent == pytest.approx(100.0 * bits / (500_000.0 * 0.201))
    assert control.epoch_ns > EPOCH


def test_the_motors_are_off_at_the_end_of_a_real_time_run(ready: Callable[..., RealtimeRun]):
    run = ready()
    run.begin()
    run.run(30, never)
    assert ends_stopped(run)


def test_loss_and_return_of_the_line_are_reported(ready: Callable[..., RealtimeRun]):
    said: list[str] = []
    line = SocketLine([None, "is lost", None, "is back"])
    run = ready(line=line, alarm=said.append)
    run.begin()
    run.run(None, lambda: line.looks > 6)
    assert [text.partition(" s: ")[2] for text in said] == ["pair is lost", "pair is back"]


def test_requests_that_the_machine_refuses_slowly_are_still_reported(ready: Callable[..., RealtimeRun]):
    said: list[str] = []
    asked = Asked()
    run = ready(say=said.append, realtime=asked)
    run.begin()
    run.run(5, never)
    assert said == ["refused: locked memory", "refused: a CPU"]
    assert asked.calls == ["enter"]


def test_peers_are_called_with_the_model_time(ready: Callable[..., RealtimeRun]):
    turns: list[int] = []

    class Peer:
        is_ours, dropped = False, 0

        def poll(self, now_ns: int) -> None:
            turns.append(now_ns)

    run = ready(peers=[Peer()])
    run.begin()
    assert turns == []
    run.run(None, lambda: len(turns) > 20 and turns[-1] > 20 * MS)
    assert turns == sorted(turns)
    assert all(now % MS == 0 for now in turns)


class Slow:
    """A peer whose fifth call takes long."""

    def __init__(self, is_ours: bool, seconds: float) -> None:
        self.is_ours, self.seconds, self.turns, self.dropped = is_ours, seconds, 0, 0

    def poll(self, now_ns: int) -> None:
        self.turns += 1
        if self.turns == 5:
            time.sleep(self.seconds)


class SlowTaker:
    """Recorder that once delays the thread that calls the peers."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def take(self, rows: Any, frames: Any) -> None:
        time.sleep(self.seconds)
        self.seconds = 0.0


def test_dropped_frames_count_from_the_start_of_the_run(ready: Callable[..., RealtimeRun], rig: Rig):
    """Drops reported by the line, with or without a later frame, and those of an ECU in this process."""
    peer = Slow(False, 0.0)
    run = ready(peers=[peer])
    line: Any = run.line
    line.lost, peer.dropped = 1000, 50
    line.other.send(from_a_pump(0x55, b"x", 0, dropped=1004).data)

    def stopped() -> bool:
        if peer.turns == 10:
            line.lost, peer.dropped = 1009, 52
        return peer.turns > 20

    run.begin()
    run.run(None, stopped)
    assert run.memory.shared.control[0].dropped == 4
    assert run.memory.shared.rows[:, COLUMN_PLACE["frames_dropped"]].max() == 4.0
    assert run.summary().link.dropped == 9 + 2
    line.lost = -1  # closed
    assert run.summary().link.dropped == 4 + 2


def test_rows_overwritten_before_they_were_judged_are_counted(ready: Callable[..., RealtimeRun]):
    """Happens where an ECU in this process does not answer for longer than the ring holds."""
    run = ready(sinks=[SlowTaker(0.0)])
    run.begin()
    run.run(100, never)
    assert run.summary().unseen_rows == 0
    run = ready(sinks=[SlowTaker(1.0)], rows=1200, limit_ns=10**12)
    run.begin()
    run.run(1200, never)
    assert run.summary().unseen_rows > 500


@pytest.mark.parametrize(
    ("is_ours", "takes", "waits", "is_the_bench"),
    [(True, 0.3, 0.0, True), (False, 0.3, 0.0, False), (True, 0.0, 0.3, True), (False, 0.0, 0.3, True)],
)  # fmt: skip
def test_any_waiting_and_the_run_time_of_own_peers_are_bench_delay_but_not_that_of_a_users_ecu(
    ready: Callable[..., RealtimeRun], is_ours: bool, takes: float, waits: float, is_the_bench: bool
):
    peer = Slow(is_ours, takes)
    run = ready(peers=[peer], sinks=[SlowTaker(waits)], limit_ns=10**12)
    run.begin()
    run.run(None, lambda: peer.turns > 60)
    delays = run.memory.shared.rows[:, COLUMN_PLACE["command_delay_s"]]
    assert (delays.max() > 0.25) == is_the_bench


def test_a_run_that_can_no_longer_be_judged_ends_without_a_last_progress_report(ready: Callable[..., RealtimeRun]):
    told: list[bool] = []

    class Monitor:
        def look(self, moment: object, is_last: bool = False) -> None:
            told.append(is_last)

    run = ready(monitor=Monitor(), spoilt=lambda: "the bench was late: by far" if told else "")
    run.begin()
    with pytest.raises(OverrunError, match=r"^the bench was late: by far$"):
        run.run(None, never)
    assert told == [False]


def test_an_overrun_is_an_error_with_its_remedy(ready: Callable[..., RealtimeRun]):
    run = ready(limit_ns=-1)
    run.begin()
    with pytest.raises(OverrunError, match="`overrun_limit`"):
        run.run(None, never)
    assert ends_stopped(run)


def test_divergence_is_an_error_with_its_time(ready: Callable[..., RealtimeRun], rig: Rig):
    state = start_of(loop_config(rig=rig))
    broken = state._replace(plant=state.plant._replace(gate_angle=math.nan))
    run = ready(state=broken)
    run.begin()
    with pytest.raises(PlantDivergedError) as told:
        run.run(None, never)
    when = run.state.tick * run.config.step  # a busy machine has the loop begin some ticks late
    assert when > 0.0
    assert f"diverged at {when:.3f} s;" in str(told.value)
    assert ends_stopped(run)


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, BrokenPipeError])
def test_any_exception_of_the_stop_check_ends_the_loop_with_the_motors_off(
    ready: Callable[..., RealtimeRun], error: type[BaseException]
):
    calls: list[int] = []

    def stopped() -> bool:
        calls.append(1)
        if len(calls) > 2:
            raise error
        return False

    run = ready()
    run.begin()
    with pytest.raises(error):
        run.run(None, stopped)
    assert ends_stopped(run)
    assert len(run.memory.shared.histograms[LATENESS]) == BINS


def test_a_message_that_cannot_be_printed_at_the_start_ends_the_loop(ready: Callable[..., RealtimeRun]):
    def say(text: str) -> None:
        raise BrokenPipeError

    run = ready(say=say, realtime=Asked())
    run.begin()
    with pytest.raises(BrokenPipeError):
        run.run(None, never)
    assert ends_stopped(run)


def test_an_exception_in_the_loop_thread_is_raised_in_the_caller(ready: Callable[..., RealtimeRun]):
    class Broken(Asked):
        def enter(self) -> None:
            raise MemoryError

    run = ready(realtime=Broken())
    run.begin()
    with pytest.raises(MemoryError):
        run.run(None, never)
