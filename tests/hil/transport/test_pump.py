"""Pump thread of a bus: frames pass complete and in order, whether or not a driver fails or blocks."""

from __future__ import annotations

import queue
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import can
import numpy as np
import pytest
from hil_support import frames_of, rows_of, wait_for
from serial_peers import PATIENCE, descriptors

from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, REMOTE, Frames, empty_frames
from liftgate_hil.errors import TransportError
from liftgate_hil.loop.datagrams import CAPACITY, Writing, make_buffers, read_frames, write_frames
from liftgate_hil.transport.base import LinkCounts, age_of
from liftgate_hil.transport.can_bus import CanTransport
from liftgate_hil.transport.messages import message_of
from liftgate_hil.transport.pump import Pump, _Stint

Rows = list[tuple[int, bytes]]


def send(pump: Pump, rows: Rows) -> Writing:
    """Write frames to the pump, as the loop does."""
    return write_frames(pump.descriptor, make_buffers(), frames_of(rows), 0)


class Reader:
    """Frames that the loop's side has received so far; `look` reads further ones, and returns their number."""

    def __init__(self, pump: Pump) -> None:
        self._pump = pump
        self.rows: Rows = []
        self.stamps: list[int] = []

    def look(self) -> int:
        frames, stamps = empty_frames(CAPACITY), np.zeros(CAPACITY, dtype=np.int64)
        reading = read_frames(self._pump.descriptor, make_buffers(), frames, stamps)
        self.rows += rows_of(frames._replace(count=reading.count))
        self.stamps += stamps[: reading.count].tolist()
        return len(self.rows)


@pytest.fixture(autouse=True)
def nothing_leaks() -> Iterator[None]:
    """Check that a test has ended all its threads and closed its descriptors."""
    threads, files = set(threading.enumerate()), descriptors()
    yield
    wait_for(lambda: set(threading.enumerate()) <= threads)
    assert descriptors() <= files


@pytest.fixture
def pair() -> Iterator[tuple[Pump, can.BusABC]]:
    channel = str(uuid.uuid4())
    with can.Bus(interface="virtual", channel=channel) as other:
        pump = Pump(CanTransport({"interface": "virtual", "channel": channel}, is_fd=True))
        pump.drain()
        yield pump, other
        if pump._ours.fileno() >= 0:
            pump.close()


ROWS: Rows = [
    (0x000, b""),
    (0x7FF, b"12345678"),
    (0x123 | EXTENDED, b"abc"),
    (0x1FFFFFFF | EXTENDED, bytes(range(8))),
    (0x321 | FD, bytes(range(64))),
    (0x322 | FD, b""),
    (0x1ABCDEF0 | EXTENDED | FD, b"\xff" * 12),
]


def test_the_pump_receives_frames_of_every_kind_with_their_arrival_times(pair: tuple[Pump, can.BusABC]):
    pump, other = pair
    before = time.monotonic_ns()
    rows = [*ROWS, (0x123 | ERROR, b"")]
    for row in range(len(rows)):
        other.send(message_of(frames_of(rows), row))
    other.send(can.Message(arbitration_id=0x55, is_extended_id=False, is_remote_frame=True, dlc=5))
    reader = Reader(pump)
    wait_for(lambda: reader.look() > len(rows))
    assert reader.rows == [*rows, (0x55 | REMOTE, bytes(5))]
    assert reader.stamps == sorted(reader.stamps)
    assert before <= reader.stamps[0] <= reader.stamps[-1] <= time.monotonic_ns()


def test_the_pump_sends_frames_of_every_kind_complete(pair: tuple[Pump, can.BusABC]):
    pump, other = pair
    rows = [*ROWS, (0x55 | REMOTE, bytes(5))]
    assert send(pump, rows) == Writing(len(rows), 0, 0, 0)
    for identifier, payload in rows:
        message = other.recv(PATIENCE)
        assert message is not None
        assert message.arbitration_id == identifier & 0x1FFFFFFF
        assert message.is_extended_id == bool(identifier & EXTENDED)
        assert message.is_remote_frame == bool(identifier & REMOTE)
        assert message.is_fd == bool(identifier & FD)
        assert message.dlc == len(payload)
        assert bytes(message.data) == (b"" if message.is_remote_frame else payload)
    assert other.recv(0) is None


def test_frames_sent_and_received_at_once_keep_their_order(pair: tuple[Pump, can.BusABC]):
    pump, other = pair
    reader = Reader(pump)
    out = 0
    for number in range(3000):
        other.send(can.Message(arbitration_id=number, is_extended_id=True))
        out += send(pump, [(number | EXTENDED, bytes([number % 256]))] * (number == out)).sent
        reader.look()
    wait_for(lambda: reader.look() == 3000)
    assert [identifier & ~EXTENDED for identifier, _ in reader.rows] == list(range(3000))
    for number in range(out):
        message = other.recv(PATIENCE)
        assert message is not None
        assert message.arbitration_id == number
    assert out > 0


def test_a_slow_reader_blocks_nothing_and_gets_every_frame(pair: tuple[Pump, can.BusABC]):
    pump, other = pair
    for number in range(5000):
        other.send(can.Message(arbitration_id=number, is_extended_id=True))
    assert send(pump, [(0x123, b"out")]).sent == 1
    message = other.recv(PATIENCE)
    assert message is not None
    assert message.arbitration_id == 0x123
    reader = Reader(pump)
    wait_for(lambda: reader.look() == 5000)
    assert [identifier & ~EXTENDED for identifier, _ in reader.rows] == list(range(5000))


def test_closing_the_pump_sends_all_frames_written_before(pair: tuple[Pump, can.BusABC]):
    pump, other = pair
    rows = [(number, b"") for number in range(200)]
    assert send(pump, rows).sent == 200
    pump.close()
    got = []
    while (message := other.recv(0)) is not None:
        got.append(message.arbitration_id)
    assert got == list(range(200))


def test_closing_the_pump_does_not_wait_for_unread_frames(pair: tuple[Pump, can.BusABC]):
    pump, other = pair
    for number in range(5000):
        other.send(can.Message(arbitration_id=number, is_extended_id=True))
    pump.close()
    assert not any(thread.is_alive() for thread in pump._threads)


class Driver:
    """A python-can bus controlled by the test: reads return messages of `come` or raise its exceptions."""

    opened = 0

    def __init__(self, come: queue.Queue[Any]) -> None:
        self.come = come
        self.sent: list[can.Message] = []
        self.refuse: Exception | None = None
        self.gate = threading.Event()
        self.gate.set()
        self.in_send = threading.Event()
        self.shut = 0

    def recv(self, timeout: float) -> can.Message | None:
        try:
            item = self.come.get(timeout=timeout) if timeout else self.come.get_nowait()
        except queue.Empty:
            return None
        if isinstance(item, Exception):
            raise item
        assert isinstance(item, can.Message)
        return item

    def send(self, message: can.Message) -> None:
        self.in_send.set()
        assert self.gate.wait(PATIENCE)
        if self.refuse is not None:
            raise self.refuse
        self.sent.append(message)

    def shutdown(self) -> None:
        self.shut += 1
        raise OSError(19, "No such device")


class Rig:
    """A pump on test drivers, whose bus can refuse to be opened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.come: queue.Queue[Any] = queue.Queue()
        self.drivers: list[Driver] = []
        self.refusals = 0
        monkeypatch.setattr(can, "Bus", self._open)
        monkeypatch.setattr("liftgate_hil.transport.can_bus._RETRY", 0.001)
        self.pump = Pump(CanTransport({"interface": "virtual", "channel": "x"}))
        self.pump.drain()

    def _open(self, **arguments: Any) -> Driver:
        if self.refusals > 0:
            self.refusals -= 1
            raise can.CanInitializationError("not there\nyet")
        self.drivers.append(Driver(self.come))
        return self.drivers[-1]


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    made = Rig(monkeypatch)
    yield made
    for driver in made.drivers:
        driver.gate.set()
    if made.pump._ours.fileno() >= 0:
        made.pump.close()


class VendorError(Exception):
    """An exception of a driver's own, of neither python-can nor the operating system."""


def is_read(rig: Rig) -> bool:
    """Wait until the pump has read all there is; return whether its bus is open."""
    transport, before = rig.pump._transport, time.monotonic_ns()
    wait_for(lambda: transport._since_ns > before)
    return bool(transport.is_up)


def test_frames_received_while_the_bus_was_lost_are_dropped_and_counted(rig: Rig):
    reader = Reader(rig.pump)
    rig.come.put(OSError(100, "Network is down"))
    for number in range(5):
        rig.come.put(can.Message(arbitration_id=number))
    wait_for(lambda: len(rig.drivers) == 2 and is_read(rig))
    rig.come.put(can.Message(arbitration_id=99))
    wait_for(reader.look)
    assert [identifier & ~EXTENDED for identifier, _ in reader.rows] == [99]
    assert rig.pump.counts().before_start == 5


def test_a_failing_driver_is_reopened_a_hundred_times_without_leaks(rig: Rig):
    reader = Reader(rig.pump)
    news: list[str] = []
    threads, files = threading.active_count(), descriptors()
    for cycle in range(100):
        rig.come.put(can.Message(arbitration_id=cycle))
        wait_for(lambda wanted=2 * cycle + 1: reader.look() == wanted)
        rig.refusals = cycle % 4
        if cycle % 2:
            rig.come.put(OSError(100, "Network is down"))
        else:
            for _ in range(10):
                rig.come.put(can.CanOperationError("down") if cycle % 4 else VendorError("?"))
        wait_for(lambda opened=cycle + 2: len(rig.drivers) == opened and is_read(rig))
        rig.come.put(can.Message(arbitration_id=1000 + cycle))
        wait_for(lambda wanted=2 * cycle + 2: reader.look() == wanted)
        news.append(str(rig.pump.watch(None)))
    assert [identifier & ~EXTENDED for identifier, _ in reader.rows] == [
        number for cycle in range(100) for number in (cycle, 1000 + cycle)
    ]
    assert len(rig.drivers) == 101
    assert [driver.shut for driver in rig.drivers] == [1] * 100 + [0]
    assert rig.pump.counts() == LinkCounts(receive_failures=50 + 500, losses=100)
    assert set(news) == {"None"}  # it was back at each look
    assert (threading.active_count(), descriptors()) == (threads, files)


def test_loss_and_return_of_the_bus_are_reported_once_each(rig: Rig):
    assert rig.pump.watch(None) is None
    news: list[str] = []

    def watched(expected: str) -> bool:
        told = rig.pump.watch(None)
        news.extend([told] if told else [])
        return expected in news

    for _ in range(3):
        news.clear()
        rig.refusals = 10**9
        rig.come.put(OSError(19, "No such device"))
        wait_for(lambda: watched("is lost"))
        assert [rig.pump.watch(None) for _ in range(3)] == [None] * 3
        rig.refusals = 0
        wait_for(lambda: watched("is back"))
        assert rig.pump.watch(None) is None
        assert news == ["is lost", "is back"]


@pytest.mark.parametrize(
    ("error", "full"),
    [
        (can.CanOperationError("no"), 0),
        (OSError(100, "Network is down"), 0),
        (OSError(105, "No buffer space available"), 1),
        (can.CanOperationError("full", error_code=105), 1),
        (VendorError("?"), 0),
        (AttributeError("'NoneType' object has no attribute 'write'"), 0),
    ],
)
def test_frames_that_the_driver_refuses_are_counted_and_later_ones_are_sent(rig: Rig, error: Exception, full: int):
    rig.drivers[0].refuse = error
    send(rig.pump, [(1, b"")] * 100)
    wait_for(lambda: rig.pump.counts().send_failures == 100)
    rig.drivers[0].refuse = None
    send(rig.pump, [(2, b"")])
    wait_for(lambda: rig.drivers[0].sent)
    assert rig.pump.counts() == LinkCounts(send_failures=100, send_queue_full=100 * full)


def test_counts_are_right_if_sending_and_receiving_fail_at_once(rig: Rig):
    rig.drivers[0].refuse = can.CanOperationError("no")
    for number in range(300):
        rig.come.put(can.CanOperationError("bad"))
        rig.come.put(can.Message(arbitration_id=number))
        send(rig.pump, [(number, b"")])
    reader = Reader(rig.pump)
    wait_for(lambda: reader.look() == 300)
    wait_for(lambda: rig.pump.counts().send_failures == 300)
    assert rig.pump.counts() == LinkCounts(receive_failures=300, send_failures=300)


def test_a_driver_blocked_in_send_blocks_neither_the_loop_nor_receiving(rig: Rig):
    driver = rig.drivers[0]
    driver.gate.clear()
    assert send(rig.pump, [(1, b"")]).sent == 1
    assert driver.in_send.wait(PATIENCE)
    written = send(rig.pump, [(2, b"")] * 3000)
    assert written.sent + written.full == 3000
    assert written.full > 0
    reader = Reader(rig.pump)
    rig.come.put(can.Message(arbitration_id=7))
    wait_for(lambda: reader.look() == 1)
    driver.gate.set()
    wait_for(lambda: len(driver.sent) == 1 + written.sent)
    assert send(rig.pump, [(3, b"")]).sent == 1
    wait_for(lambda: driver.sent[-1].arbitration_id == 3)


def test_the_loop_learns_how_long_its_frames_waited_for_the_pump(monkeypatch: pytest.MonkeyPatch):
    threads: list[threading.Thread] = []
    start = threading.Thread.start

    def put_off(thread: threading.Thread) -> None:
        threads.append(thread)

    monkeypatch.setattr(threading.Thread, "start", put_off)
    monkeypatch.setattr(can, "Bus", lambda **_: driver)
    driver, control = Driver(queue.Queue()), SimpleNamespace(line_late_ns=0)
    pump = Pump(CanTransport({"interface": "virtual", "channel": "x"}))
    pump.watch(control)
    send(pump, [(1, b"")])
    time.sleep(0.05)
    assert control.line_late_ns == 0
    for each in threads:
        start(each)
    wait_for(lambda: driver.sent)
    assert control.line_late_ns >= 49_000_000
    pump.close()


def test_time_spent_in_the_driver_is_not_bench_delay(rig: Rig):
    control, driver = SimpleNamespace(line_late_ns=0), rig.drivers[0]
    rig.pump.watch(control)
    driver.gate.clear()
    send(rig.pump, [(1, b""), (2, b"")])
    time.sleep(1.0)
    driver.gate.set()
    wait_for(lambda: len(driver.sent) == 2)
    assert control.line_late_ns < 900_000_000


def test_closing_the_pump_gives_up_on_a_blocked_driver(rig: Rig, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("liftgate_hil.transport.pump._LEAVE_S", 0.02)
    told: list[Any] = []
    monkeypatch.setattr(threading, "excepthook", told.append)
    driver = rig.drivers[0]
    driver.gate.clear()
    send(rig.pump, [(1, b""), (2, b"")])
    assert driver.in_send.wait(PATIENCE)
    rig.pump.close()
    driver.gate.set()
    wait_for(lambda: not any(thread.is_alive() for thread in rig.pump._threads))
    assert told == []


def test_sending_to_and_closing_a_lost_driver_are_no_errors(rig: Rig):
    rig.refusals = 10**9
    rig.come.put(OSError(19, "No such device"))
    wait_for(lambda: rig.pump.watch(None) == "is lost")
    rig.drivers[0].refuse = can.CanOperationError("closed")
    send(rig.pump, [(1, b"")] * 5)
    wait_for(lambda: rig.pump.counts().send_failures == 5)
    rig.pump.close()


def test_a_step_of_the_wall_clock_does_not_block_receiving(
    pair: tuple[Pump, can.BusABC], monkeypatch: pytest.MonkeyPatch
):
    pump, other = pair
    behind = [0.0]
    asked: list[float] = []
    real = time.time

    def stepped() -> float:
        return real() - behind[0]

    # BusABC.recv would ask the stepped clock how much time is left, and then wait for that.
    monkeypatch.setattr(can.bus, "time", stepped)
    bus: Any = pump._transport._bus  # type: ignore[attr-defined]
    internal = bus._recv_internal

    def noted(timeout: float) -> Any:
        asked.append(timeout)
        return internal(timeout)

    monkeypatch.setattr(bus, "_recv_internal", noted)
    reader = Reader(pump)
    for number in range(100):
        behind[0] += 6.0
        other.send(can.Message(arbitration_id=number, is_extended_id=True))
        wait_for(lambda wanted=number + 1: reader.look() == wanted)
    assert len(reader.rows) == 100
    assert all(timeout is not None and 0.0 <= timeout <= 0.05 for timeout in asked)
    monkeypatch.undo()


class Endless:
    """A transport that always has frames."""

    name = "endless"
    is_up = True

    def __init__(self) -> None:
        self.closed = 0
        self.came_ns = np.full(100, time.monotonic_ns())

    def receive(self, timeout: float = 0.0) -> Frames:
        return frames_of([(1, b"")] * 100)

    def send(self, frames: Frames) -> None:
        pass

    def counts(self) -> LinkCounts:
        return LinkCounts()

    def close(self) -> None:
        self.closed += 1


def test_frames_from_before_the_loop_is_ready_are_dropped_and_counted():
    channel = str(uuid.uuid4())
    with can.Bus(interface="virtual", channel=channel) as other:
        pump = Pump(CanTransport({"interface": "virtual", "channel": channel}))
        reader = Reader(pump)
        for number in range(3000):  # more than a socket pair holds
            other.send(can.Message(arbitration_id=0x120, data=bytes([number % 256])))
        pump.drain()
        other.send(can.Message(arbitration_id=0x121))
        wait_for(reader.look)
        assert [identifier & 0x7FF for identifier, _ in reader.rows] == [0x121]
        assert pump.counts().before_start == 3000
        pump.close()


def test_the_arrival_time_is_that_on_the_bus_and_not_of_the_read(rig: Rig):
    """A process that stood still finds old frames, whose age the driver's timestamps show."""
    rig.pump._transport._since_ns = time.monotonic_ns() - 10 * 10**9
    old = can.Message(arbitration_id=1, timestamp=time.time() - 5.0)
    rig.come.put(old)
    reader = Reader(rig.pump)
    wait_for(reader.look)
    assert time.monotonic_ns() - reader.stamps[0] >= 4 * 10**9


@pytest.mark.parametrize(
    ("stamp", "unseen_s", "age_s"),
    [
        (5.0, 10.0, 5.0),  # of the wall clock
        (5.0, 0.01, 0.01),  # that was set since: all was read 10 ms ago
        (-5.0, 0.01, 0.0),
        (None, 0.01, 0.0),  # another clock's, or none
        (None, 20.0, 20.0),  # nobody has looked for long
    ],
)
def test_a_frame_is_at_most_as_old_as_the_last_empty_read(stamp: float | None, unseen_s: float, age_s: float):
    given = 17.0 if stamp is None else time.time() - stamp
    assert age_of(given, round(1e9 * unseen_s)) == pytest.approx(1e9 * age_s, abs=0.5e9)
    if age_s in (0.0, 0.01):
        assert age_of(given, round(1e9 * unseen_s)) == round(1e9 * age_s)


@pytest.mark.parametrize("read_before", [True, False])
def test_a_flood_does_not_keep_the_pump_from_closing(read_before: bool):
    transport = Endless()
    pump = Pump(transport)
    reader = Reader(pump)
    if read_before:
        pump.drain()
        wait_for(lambda: reader.look() > 3000)
    pump.close()
    assert transport.closed == 1
    with pytest.raises(OSError, match="Bad file descriptor"):
        socket.fromfd(pump.descriptor, socket.AF_UNIX, socket.SOCK_SEQPACKET)


class Broken(Endless):
    """A transport whose reads and writes raise exceptions, as of a programming error."""

    def receive(self, timeout: float = 0.0) -> Frames:
        raise RuntimeError

    def send(self, frames: Frames) -> None:
        raise TypeError("this way, too")


@pytest.mark.parametrize(("way", "cause"), [("in", "RuntimeError"), ("out", "this way, too")])
def test_a_pump_thread_that_ends_is_reported_with_its_cause(way: str, cause: str):
    transport = Broken()
    if way == "out":
        transport.receive = Endless().receive  # type: ignore[method-assign]
    pump = Pump(transport)
    if way == "out":
        send(pump, [(1, b"")])
    thread = pump._threads[way == "out"]
    thread.join(PATIENCE)
    with pytest.raises(TransportError, match=f"has ended: {cause}"):
        pump.watch(None)
    pump.close()
    assert transport.closed == 1


@pytest.mark.parametrize(
    ("computes_ns", "waits_ns", "pauses"),
    [(100_000, 0, 5), (100_000, 90_000, 4), (100_000, 110_000, 0), (10_000, 1_000_000, 0)],
)
def test_a_busy_pump_thread_yields_the_cpu(
    monkeypatch: pytest.MonkeyPatch, computes_ns: int, waits_ns: int, pauses: int
):
    """Else, under FIFO scheduling on one CPU, the sending thread would not run at all."""
    now, computed, slept = 0, 0, list[float]()
    monkeypatch.setattr(time, "monotonic_ns", lambda: now)
    monkeypatch.setattr(time, "thread_time_ns", lambda: computed)
    monkeypatch.setattr(time, "sleep", slept.append)
    stint = _Stint()
    while now < 25_000_000:
        now += computes_ns + waits_ns
        computed += computes_ns
        stint.give_way()
    assert len(slept) == pauses
    assert set(slept) <= {0.002}
