"""The replay loop on a simulated clock: each frame is sent when due, and lateness is counted."""

from __future__ import annotations

import ctypes
import errno

import numpy as np
import pytest
from hil_support import frames_of
from simulated_kernel import MS, Datagram, SimulatedKernel

from liftgate_hil.codec.frames import logged
from liftgate_hil.loop.histogram import distribution
from liftgate_hil.loop.realtime_loop import make_room
from liftgate_hil.loop.replay_loop import PlayParams, Schedule, empty_schedule, play, put
from liftgate_hil.loop.rings import LATENESS, Memory

US = 1_000
WAKE, COST = 30 * US, 5 * US  # how late every wake-up is, and what handing over takes


class World(SimulatedKernel):
    """A simulated clock and a wire that may refuse frames."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[tuple[int, list[int]]] = []  # when, payloads' first bytes
        self.refused: set[int] = set()  # first bytes
        self.stop_at = 2**62
        self.arrivals = self.nothing

    def nothing(self, most: int) -> list[Datagram]:
        """Read no frames; the request to stop may arrive meanwhile."""
        self.control.stop = int(self.now >= self.stop_at)
        return []

    def clock_gettime(self, clock: int, at: int) -> int:
        self.now += 100
        return super().clock_gettime(clock, at)

    def clock_nanosleep(self, clock: int, flags: int, request: int, remaining: int) -> int:
        code = super().clock_nanosleep(clock, flags, request, remaining)
        self.now += WAKE
        return code

    def sendmmsg(self, descriptor: int, headers: int, count: int, flags: int) -> int:
        numbers = payloads(headers, count)
        refused = next((k for k, each in enumerate(numbers) if each in self.refused), count)
        self.now += COST
        if refused == 0:
            ctypes.set_errno(errno.EAGAIN)
            return -1
        self.sent.append((self.now - COST, numbers[:refused]))
        return refused


def payloads(headers: int, count: int) -> list[int]:
    """The first payload byte of each frame in an array of struct mmsghdr."""
    found = []
    for i in range(count):
        vector = ctypes.c_int64.from_address(headers + 64 * i + 16).value
        frame = ctypes.c_int64.from_address(vector).value
        found.append(ctypes.c_uint8.from_address(frame + 8).value)
    return found


@pytest.fixture
def world() -> World:
    return World()


def scheduled(due: list[int], places: int = 64) -> Schedule:
    """Schedule of frames due at these times [ns], whose payload is their number."""
    schedule = empty_schedule(places)
    frames = logged(frames_of([(0x100 + k, bytes([k])) for k in range(len(due))]), 0, True)
    assert put(schedule, np.array(due), frames) == len(due)
    schedule.position[0].is_whole = 1
    return schedule


def played(world: World, schedule: Schedule, together: int = 64) -> Memory:
    """Play a schedule, up to `together` frames in one call; return the memory with its histograms."""
    memory = Memory(1, 1)
    world.control = memory.shared.control[0]
    world.call(play, schedule, PlayParams(-1, together, 0), memory.shared, make_room())
    memory.close()
    return memory


def test_each_frame_is_sent_when_due_and_frames_of_equal_time_together(world: World) -> None:
    due = [0, 4 * MS, 4 * MS, 4 * MS + 10 * US, 30 * MS, 2000 * MS]
    schedule = scheduled(due)
    memory = played(world, schedule)
    start = int(schedule.position[0].start_ns)
    assert [numbers for _, numbers in world.sent] == [[0], [1, 2, 3], [4], [5]]
    for (when, numbers), after in zip(world.sent, [WAKE, WAKE, WAKE, WAKE], strict=True):
        late = when - start - due[numbers[0]]
        assert after <= late < after + 2 * US
    late = distribution(memory.shared.histograms[LATENESS])
    assert late.count == len(due)
    assert 1e-3 * (WAKE + COST) <= late.max_us < 1e-3 * (WAKE + COST) * 1.1
    assert schedule.position[0].accepted == len(due)


def test_frames_sent_one_by_one_keep_their_order(world: World) -> None:
    schedule = scheduled([0, 0, 0, MS])
    played(world, schedule, together=1)
    assert [numbers for _, numbers in world.sent] == [[0], [1], [2], [3]]


def test_refused_frames_count_neither_as_late_nor_as_sent(world: World) -> None:
    world.refused = {1, 3}
    schedule = scheduled([0, MS, 2 * MS, 3 * MS, 4 * MS])
    memory = played(world, schedule, together=1)
    position = schedule.position[0]
    assert (position.played, position.accepted) == (5, 3)
    assert distribution(memory.shared.histograms[LATENESS]).count == 3
    # Of those that were taken, one after the other, when each was due.
    assert schedule.handed[:3].tolist() == [0, 2 * MS, 4 * MS]


def test_a_replay_can_be_stopped_during_a_long_wait(world: World) -> None:
    schedule = scheduled([0, 3600 * 1000 * MS])
    begin = world.now
    world.stop_at = begin + 500 * MS
    played(world, schedule)
    assert schedule.position[0].played == 1
    assert world.now < begin + 600 * MS


def test_a_schedule_that_runs_empty_is_reported_and_no_frame_is_left_out(world: World) -> None:
    schedule = scheduled([0])
    schedule.position[0].is_whole = 0
    frames = logged(frames_of([(0x200, bytes([9]))]), 0, True)
    begin = world.now

    def arrivals(most: int) -> list[Datagram]:
        if world.now > begin + 43 * MS and not schedule.position[0].is_whole:
            put(schedule, np.array([10 * MS]), frames)
            schedule.position[0].is_whole = 1
        return []

    world.arrivals = arrivals
    memory = played(world, schedule)
    assert [numbers for _, numbers in world.sent] == [[0], [9]]
    assert schedule.position[0].starved == 1
    assert distribution(memory.shared.histograms[LATENESS]).max_us > 30_000.0


def test_the_schedule_accepts_frames_up_to_its_capacity_and_wraps_around() -> None:
    schedule = empty_schedule(8)
    frames = logged(frames_of([(0x100 + k, bytes([k, k])) for k in range(12)]), 0, True)
    due = np.arange(12)
    assert put(schedule, due, frames) == 8
    assert put(schedule, due[8:], frames[8:]) == 0
    schedule.position[0].played = 5
    assert put(schedule, due[8:], frames[8:]) == 4
    places = [k % 8 for k in range(5, 12)]
    assert schedule.due[places].tolist() == list(range(5, 12))
    assert schedule.identifiers[places].tolist() == [0x100 + k for k in range(5, 12)]
    assert schedule.data[places, 1].tolist() == list(range(5, 12))
    assert (schedule.lengths[places] == 2).all()


def test_frames_of_equal_time_are_split_where_the_schedule_wraps_around(world: World) -> None:
    schedule = empty_schedule(4)
    frames = logged(frames_of([(0x100, bytes([k])) for k in range(6)]), 0, True)
    put(schedule, np.zeros(3, dtype=np.int64), frames[:3])
    schedule.position[0].played = 3
    put(schedule, np.zeros(3, dtype=np.int64), frames[3:])
    schedule.position[0].is_whole = 1
    played(world, schedule)
    assert [numbers for _, numbers in world.sent] == [[3], [4, 5]]
