"""The loop around the tick: clocks, transports, recorders and peers."""

from __future__ import annotations

import functools
import math
import operator
import uuid
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hil_support import (
    BENCH_CONTROL,
    BENCH_STATUS,
    BRAKE,
    COMMAND,
    GATE,
    LEFT_DRIVE,
    NO_TIMELINE,
    OPEN,
    RIGHT_DRIVE,
    SENSORS,
    both,
    catch_up,
    command_frame,
    command_payload,
    decoded,
    frames_of,
    loop_config,
    outside,
    panel_frame,
    rows_of,
    start_of,
)
from numpy.typing import NDArray

from liftgate_hil import session
from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, REMOTE, Frames, empty_frames
from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.config.rig import Rig
from liftgate_hil.ecu.adapter import ReferenceEcu
from liftgate_hil.ecu.peer import Peer
from liftgate_hil.errors import OverrunError, PlantDivergedError
from liftgate_hil.loop.clock import RealtimeClock
from liftgate_hil.loop.closed_loop import Trace
from liftgate_hil.loop.python_loop import (
    Lockstep,
    Loop,
    join,
    run_clocked,
    run_free,
    run_lockstep,
    split_after,
)
from liftgate_hil.loop.tick import STOPPED, LoopConfig, LoopState
from liftgate_hil.recording.bus_log import CandumpRecorder
from liftgate_hil.recording.table import CsvRecorder
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.transport.base import LinkCounts
from liftgate_hil.transport.can_bus import CanTransport

Rows = list[tuple[int, bytes]]


class Memory:
    """A transport of lists: each read gets the next batch, an empty one ends what is there. Keeps what is sent."""

    name = "memory"
    is_up = True

    def __init__(self, batches: Sequence[Rows] = ()) -> None:
        self.batches = list(batches)
        self.sent: Rows = []
        self.closed = False

    def receive(self, timeout: float = 0.0) -> Frames:
        return frames_of(self.batches.pop(0)) if self.batches else empty_frames(0)

    def send(self, frames: Frames) -> None:
        self.sent += rows_of(frames)

    def counts(self) -> LinkCounts:
        return LinkCounts()

    def close(self) -> None:
        self.closed = True


class Notes:
    """A recorder that keeps what it was given."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.received: list[Rows] = []
        self.sent: list[Rows] = []

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        assert rows.shape[1:] == (ROW_WIDTH,)
        self.times += rows[:, COLUMN_PLACE["time_s"]].tolist()

    def write_frames(self, frames: Frames, times: Sequence[float]) -> None:
        assert len(times) == frames.count
        # A tick gives what it received first, then what it sent.
        ways = [self.received, self.sent]
        ways[(len(self.received) + len(self.sent)) % 2].append(rows_of(frames))

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass


def never() -> bool:
    return False


def loop_of(
    transport: Any, config: LoopConfig, state: LoopState | None = None, **more: Any
) -> Loop:
    return Loop(config, state or start_of(config), NO_TIMELINE, transport, **more)


def command(rig: Rig, counter: int) -> tuple[int, bytes]:
    return command_frame(rig, counter, **both(50.0, OPEN, release=1))


# Clocked runs.


@pytest.mark.parametrize("ticks", [1, 7, 100])
def test_a_free_run_makes_just_so_many_ticks(rig: Rig, ticks: int):
    notes = Notes()
    loop = loop_of(Memory(), loop_config(rig=rig), recorders=[notes])
    run_free(loop, ticks, never)
    assert loop.state.tick == ticks
    assert notes.times == pytest.approx([0.001 * (1 + number) for number in range(ticks)])


def test_a_run_ends_when_it_is_told_to(rig: Rig):
    loop = loop_of(Memory(), loop_config(rig=rig))
    run_free(loop, None, lambda: loop.state.tick >= 42)
    assert loop.state.tick == 42


def test_a_catch_up_does_not_run_past_the_end(rig: Rig):
    class Late:
        def __init__(self) -> None:
            self.lateness = None

        def wait(self, tick: int) -> int:
            return 8

    loop = loop_of(Memory(), loop_config(rig=rig))
    run_clocked(loop, Late(), 20, never)
    assert loop.state.tick == 20
    assert loop.ticks_missed == 7 + 7 + 3


def test_frames_of_a_skipped_time_are_received_and_nothing_is_sent_twice(rig: Rig):
    now = [0]

    def sleep(seconds: float) -> None:
        now[0] += round(seconds * 1e9)

    clock = RealtimeClock(1_000_000, 10**9, lambda: now[0], sleep)
    transport = Memory([[command(rig, 1)]])

    class Slow:
        def poll(self, now_ns: int) -> None:
            now[0] += 3_300_000

    shown = Trace()
    loop = loop_of(
        transport,
        loop_config(rig=rig),
        peers=[Slow()],
        takers=[shown],
    )
    run_clocked(loop, clock, 100, never)
    assert loop.state.tick == 100
    # Each skipped tick is shown.
    times = shown.columns()["time_s"]
    assert times == pytest.approx([0.001 * (1 + number) for number in range(100)])
    assert loop.state.counts.accepted == 1
    assert loop.ticks_missed > 50
    assert sum(row[0] == LEFT_DRIVE for row in transport.sent) <= 20
    assert loop.state.tick * 1_000_000 <= now[0] <= loop.state.tick * 1_000_000 + 6_600_000


def test_an_overrun_past_the_limit_ends_the_run(rig: Rig):
    now = [0]

    def sleep(seconds: float) -> None:
        now[0] += round(seconds * 1e9)

    clock = RealtimeClock(1_000_000, 5_000_000, lambda: now[0], sleep)

    class Slow:
        def take(self, rows: NDArray[np.float64], frames: Any) -> None:
            now[0] += 7_000_000

    loop = loop_of(Memory(), loop_config(rig=rig), takers=[Slow()])
    with pytest.raises(OverrunError):
        run_clocked(loop, clock, 100, never)


def test_finishing_sends_everything_with_the_motors_off_and_silences_the_peers(rig: Rig):
    polled: list[int] = []

    class Peer:
        def poll(self, now_ns: int) -> None:
            polled.append(now_ns)

    notes = Notes()
    transport = Memory([[command(rig, 0)]])
    loop = loop_of(transport, loop_config(rig=rig), recorders=[notes], peers=[Peer()])
    loop.begin()
    run_free(loop, 10, never)
    loop.finish()
    assert polled == [0, *(1_000_000 * (1 + number) for number in range(10))]
    assert sorted(row[0] for row in notes.sent[-1]) == [
        LEFT_DRIVE, RIGHT_DRIVE, GATE, SENSORS, BENCH_STATUS,
    ]  # fmt: skip
    status = decoded(rig, frames_of(transport.sent), "BenchStatus")
    assert status[-1]["EmulatorState"] == STOPPED
    assert len(notes.times) == 11


def test_beginning_leaves_no_trace(rig: Rig):
    transport, notes = Memory(), Notes()
    loop = loop_of(transport, loop_config(rig=rig), recorders=[notes])
    loop.begin()
    assert (loop.state.tick, transport.sent, notes.times) == (0, [], [])
    assert loop.summary("free").frames_sent == 0


def test_a_recorder_gets_every_frame_of_either_way_once(rig: Rig):
    batches: list[Rows] = [
        [command(rig, n), (0x55, b"x")] if n % 10 == 0 else [] for n in range(100)
    ]
    transport, notes = Memory([list(batch) for batch in batches]), Notes()
    loop = loop_of(transport, loop_config(rig=rig), recorders=[notes])
    run_free(loop, 100, never)
    assert notes.received == batches
    assert [row for rows in notes.sent for row in rows] == transport.sent
    summary = loop.summary("free")
    assert summary.frames_sent == len(transport.sent)
    bits = sum(
        47 + 8 * len(payload)
        for _, payload in (*transport.sent, *functools.reduce(operator.iadd, batches, []))
    )
    assert summary.bus_load_percent == pytest.approx(100.0 * bits / (500_000 * 0.1))


def test_a_plant_that_diverged_ends_the_run_after_its_frames_went_out(rig: Rig):
    config = loop_config(rig=rig)
    state = start_of(config)
    broken = state.plant._replace(gate_angle=math.nan)
    transport = Memory()
    loop = loop_of(transport, config, state._replace(plant=broken))
    with pytest.raises(PlantDivergedError, match="diverged"):
        run_free(loop, 10, never)
    with pytest.raises(PlantDivergedError):
        loop.finish()
    assert decoded(rig, frames_of(transport.sent), "BenchStatus")[-1]["EmulatorState"] == STOPPED


def test_a_diverged_speed_of_the_other_drive_is_noticed_too(rig: Rig):
    config = loop_config(rig=rig)
    state = start_of(config)
    right = state.plant.right._replace(current=math.nan)
    loop = loop_of(Memory(), config, state._replace(plant=state.plant._replace(right=right)))
    with pytest.raises(PlantDivergedError):
        run_free(loop, 3, never)


# Lockstep.


PERIOD = Lockstep(COMMAND, 10)


def lockstep(rig: Rig, batches: Sequence[Rows], ticks: int | None = None) -> tuple[Loop, Notes]:
    """Run until all batches are used up, the first of which is there at the start."""
    first, *later = batches
    transport, notes = Memory([first, [], *later]), Notes()
    loop = loop_of(transport, loop_config(rig=rig), recorders=[notes])
    run_lockstep(loop, PERIOD, ticks, lambda: not transport.batches)
    return loop, notes


def test_each_command_advances_one_command_period(rig: Rig):
    loop, notes = lockstep(rig, [[command(rig, n)] for n in range(6)] + [[]])
    assert loop.state.tick == 60
    assert loop.state.counts.accepted == 6
    assert [number for number, rows in enumerate(notes.received) if rows] == [0, 10, 20, 30, 40, 50]


def test_several_commands_in_one_read_each_get_their_own_period(rig: Rig):
    first, *later = (command(rig, n) for n in range(5))
    loop, notes = lockstep(rig, [[first], later, []])
    assert loop.state.tick == 50
    assert [rows for rows in notes.received if rows] == [[command(rig, n)] for n in range(5)]
    assert loop.state.timeouts == 0


def test_other_frames_wait_for_the_command_that_follows_them(rig: Rig):
    panel = panel_frame(rig, HandForce=10.0)
    batches: list[Rows] = [
        [command(rig, 9)],
        [panel],
        [(0x55, b"a")],
        [],
        [(0x56, b"b"), command(rig, 0)],
        [],
        [(0x57, b"c"), command(rig, 1), (0x58, b"d")],
        [(COMMAND | REMOTE, b"")],
        [command(rig, 2)],
        [(0x59, b"e")],
        [],
    ]
    loop, notes = lockstep(rig, batches)
    assert loop.state.tick == 40
    assert [rows for rows in notes.received if rows] == [
        [command(rig, 9)],
        [panel, (0x55, b"a"), (0x56, b"b"), command(rig, 0)],
        [(0x57, b"c"), command(rig, 1)],
        [(0x58, b"d"), (COMMAND | REMOTE, b""), command(rig, 2)],
    ]


def test_without_a_command_the_time_stands(rig: Rig):
    loop, _ = lockstep(rig, [[(0x55, b"a")], [panel_frame(rig)], []] * 5)
    assert loop.state.tick == 0


def test_of_the_commands_before_the_start_the_last_alone_counts_and_other_frames_are_kept(
    rig: Rig,
):
    panel = panel_frame(rig, HandForce=10.0)
    batches: list[Rows] = [
        [(0x55, b"a"), command(rig, 0), command(rig, 1)],
        [command(rig, n) for n in range(2, 300)],  # more than is read at once
        [panel, command(rig, 300), (0x56, b"b")],
        [],
        [command(rig, 301)],
    ]
    transport, notes = Memory(batches), Notes()
    loop = loop_of(transport, loop_config(rig=rig), recorders=[notes])
    run_lockstep(loop, PERIOD, None, lambda: not transport.batches)
    assert loop.state.tick == 20
    assert [rows for rows in notes.received if rows] == [
        [(0x55, b"a"), panel, command(rig, 300)],
        [(0x56, b"b"), command(rig, 301)],
    ]
    assert loop.state.counts == NO_COUNTS._replace(accepted=3, foreign=2)


class Answering:
    """The other end of a wire: an ECU that answers each `Gate` frame with one command, and had said so much before
    the gate was there.
    """

    name = "answering"
    is_up = True

    def __init__(self, rig: Rig, said: int) -> None:
        self._rig = rig
        self.sent = 0
        self.under_way: Rows = []
        self.most = 0  # commands under way after an answer
        for _ in range(said):
            self._say()

    def _say(self) -> None:
        self.under_way.append(command(self._rig, self.sent))
        self.sent += 1

    def receive(self, timeout: float = 0.0) -> Frames:
        rows, self.under_way = self.under_way[:1], self.under_way[1:]
        return frames_of(rows)

    def send(self, frames: Frames) -> None:
        for row, _ in rows_of(frames):
            if row == GATE:
                self._say()
                self.most = max(self.most, len(self.under_way))

    def counts(self) -> LinkCounts:
        return LinkCounts()

    def close(self) -> None:
        pass


@pytest.mark.parametrize("said", [1, 2, 7, 300])
def test_an_ecu_that_answers_each_frame_has_one_command_under_way_whatever_it_said_before(
    rig: Rig, said: int
):
    ecu = Answering(rig, said)
    loop = loop_of(ecu, loop_config(rig=rig))
    run_lockstep(loop, PERIOD, 200, never)
    assert loop.state.tick == 200
    assert ecu.most == 1
    assert loop.state.counts == NO_COUNTS._replace(accepted=20)
    assert loop.state.timeouts == 0


class Silence:
    """A wire without anybody, and the clock that waiting on it moves on."""

    name = "silence"
    is_up = True

    def __init__(self, monkeypatch: pytest.MonkeyPatch, rows: dict[int, Rows]) -> None:
        self.now = 100.0
        self._reads = 0
        self._rows = rows  # by the number of the waiting read
        monkeypatch.setattr("liftgate_hil.loop.python_loop.time", self)

    def monotonic(self) -> float:
        return self.now

    def receive(self, timeout: float = 0.0) -> Frames:
        if timeout == 0.0:
            return empty_frames(0)
        self.now += timeout
        self._reads += 1
        return frames_of(self._rows.get(self._reads - 1, []))

    def send(self, frames: Frames) -> None:
        pass

    def counts(self) -> LinkCounts:
        return LinkCounts()

    def close(self) -> None:
        pass


def test_lockstep_says_that_it_is_ready_and_what_it_waits_for(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
):
    wire = Silence(monkeypatch, {50: [command(rig, 0)]})
    loop = loop_of(wire, loop_config(rig=rig))
    said: list[str] = []
    run_lockstep(loop, PERIOD._replace(say=said.append), None, lambda: wire.now > 110.0)
    # Once for each silence, not at every look.
    assert said == [
        "ready: waits for the first command",
        "0.000 s: waits for a command (0x120)",
        "0.010 s: waits for a command (0x120)",
    ]


def test_a_short_silence_is_not_told(rig: Rig, monkeypatch: pytest.MonkeyPatch):
    wire = Silence(monkeypatch, {n: [command(rig, n)] for n in range(0, 100, 15)})
    said: list[str] = []
    loop = loop_of(wire, loop_config(rig=rig))
    run_lockstep(loop, PERIOD._replace(say=said.append), None, lambda: wire.now > 110.0)
    assert said == ["ready: waits for the first command"]
    assert loop.state.tick == 70


@pytest.mark.parametrize(("last", "model_time"), [(None, "0.000 s"), (20, "0.010 s")])
def test_lockstep_gives_up_after_its_wall_timeout_without_a_command(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, last: int | None, model_time: str
):
    # Frames that are no commands don't count.
    rows = {n: [panel_frame(rig)] for n in range(200)}
    if last is not None:
        rows[last] = [command(rig, 0)]
    wire = Silence(monkeypatch, rows)
    loop = loop_of(wire, loop_config(rig=rig))
    with pytest.raises(OverrunError, match=rf"no command for 5 s at {model_time}.*allowed"):
        run_lockstep(loop, PERIOD._replace(wall_timeout=5.0), None, never)
    assert wire.now == pytest.approx(105.1 + (0.0 if last is None else 0.1 * (last + 1)), abs=0.11)


@pytest.mark.parametrize("at_once", [False, True])
@pytest.mark.parametrize("ticks", [10, 20, 25])
def test_lockstep_ends_at_its_duration(rig: Rig, at_once: bool, ticks: int):
    first, *later = (command(rig, n) for n in range(6))
    batches = [[first], later] if at_once else [[first], *([each] for each in later)]
    loop, _ = lockstep(rig, [*batches, []], ticks)
    assert loop.state.tick == ticks


def test_lockstep_is_the_same_however_the_frames_are_read(rig: Rig):
    rows = [row for n in range(30) for row in (command(rig, n), panel_frame(rig, HandForce=n))]
    one, _ = lockstep(rig, [[row] for row in rows] + [[]])
    all_, _ = lockstep(rig, [rows[:1], rows[1:], []])
    assert one.state.plant == all_.state.plant
    assert one.state.tick == all_.state.tick == 300


def test_lockstep_goes_on_can_fd_commands_too():
    rig = session.rig_from(str(Path(__file__).parents[2] / "system/foreign/foreign.toml"))
    message = rig.messages["KlappeSoll"]
    payload = message.encode(
        {"SpannungLinks": 0.5, "SpannungRechts": 0.5, "BrueckeLinks": 5, "BrueckeRechts": 5,
         "Schloss": 12}
    )  # fmt: skip
    transport = Memory([[(rig.command_identifier() | FD, payload)], []] * 4)
    loop = loop_of(transport, loop_config(rig=rig))
    run_lockstep(loop, Lockstep(rig.command_identifier(), 10), None, lambda: not transport.batches)
    assert loop.state.tick == 40
    assert loop.state.counts == NO_COUNTS._replace(accepted=4)
    assert loop.state.plant.left.speed > 0.0


def test_splitting_and_joining_loses_no_frame(rig: Rig):
    rows: Rows = [(1, b"a"), (2, b"b"), (COMMAND, b"c"), (COMMAND, b"d"), (3, b"e")]
    pieces = split_after(frames_of(rows), COMMAND)
    assert [rows_of(piece) for piece in pieces] == [rows[:3], rows[3:4], rows[4:]]
    assert rows_of(join(join(pieces[0], pieces[1]), pieces[2])) == rows
    assert split_after(empty_frames(3), COMMAND) == []


# The reference ECU on an in-process bus.


def closed_loop(rig: Rig, folder: Path, ticks: int) -> tuple[Loop, ReferenceEcu, list[Path]]:
    """The emulator and the ECU; recordings in CSV and candump's text."""
    folder.mkdir()
    channel = str(uuid.uuid4())
    ours = CanTransport({"interface": "virtual", "channel": channel})
    theirs = CanTransport({"interface": "virtual", "channel": channel})
    ecu = ReferenceEcu(rig, 2)
    peer = Peer(ecu, theirs, [Request(0.3, "open"), Request(2.0, "close")])
    paths = [folder / "plant.csv", folder / "bus.log"]
    recorders = [CsvRecorder(paths[0], 2), CandumpRecorder(paths[1], "bench", 0.0)]
    noise = ["sensors.current_noise=0.05"]
    loop = loop_of(
        ours, loop_config(rig=rig, settings=noise, seed=5), recorders=recorders, peers=[peer]
    )
    try:
        loop.begin()
        run_free(loop, ticks, never)
        loop.finish()
    finally:
        for each in (*recorders, ours, theirs):
            each.close()
    return loop, ecu, paths


def test_two_free_runs_leave_the_same_recordings_to_the_last_bit(rig: Rig, tmp_path: Path):
    first = closed_loop(rig, tmp_path / "first", 4000)
    second = closed_loop(rig, tmp_path / "second", 4000)
    for one, two in zip(first[2], second[2], strict=True):
        assert one.read_bytes() == two.read_bytes()
        assert one.stat().st_size > 100_000
    assert first[1].events() == second[1].events() != []


def test_the_reference_ecu_opens_the_gate_without_a_refused_frame(rig: Rig, tmp_path: Path):
    loop, ecu, _ = closed_loop(rig, tmp_path / "run", 2000)
    assert loop.state.plant.gate_angle > math.radians(10.0)
    assert loop.state.counts == NO_COUNTS._replace(accepted=loop.state.counts.accepted)
    # One command at the start and one every 10 ms; the last came after the last tick.
    assert loop.state.counts.accepted == 200
    assert loop.state.timeouts == 0
    assert ecu.events()[0].text == "opening"


# Fuzz.

SOUND = 10_000


def junk(rig: Rig, number: int, seed: int) -> Rows:
    """Frames that a broken or hostile node might send."""
    random = np.random.default_rng(seed)
    ours = [COMMAND, BENCH_CONTROL]
    rows: Rows = []
    for index in range(number):
        good = [
            (COMMAND, command_payload(rig, index, **both(float(random.uniform(0, 100)), OPEN, 1))),
            panel_frame(rig, HandForce=float(random.uniform(-100, 100))),
        ][int(random.integers(2))]
        identifier, payload = good
        noise = random.bytes(int(random.integers(0, 9)))
        kind = int(random.integers(12))
        if kind == 0:
            rows.append((int(random.integers(0x800)), noise))
        elif kind == 1:
            rows.append((int(random.integers(0x20000000)) | EXTENDED, noise))
        elif kind == 2:
            rows.append((ours[int(random.integers(2))], random.bytes(8)))
        elif kind == 3:
            rows.append((identifier, payload[: int(random.integers(8))]))
        elif kind == 4:
            at = int(random.integers(8))
            flipped = bytes([payload[at] ^ int(random.integers(1, 256))])
            rows.append((identifier, payload[:at] + flipped + payload[at + 1 :]))
        elif kind == 5:
            length = int(random.choice([12, 16, 20, 24, 32, 48, 64]))
            rows.append((identifier, payload + random.bytes(length - 8)))
        elif kind == 6:
            rows.append((int(random.integers(0x800)) | ERROR, noise))
        elif kind == 7:
            rows.append((identifier | REMOTE, b""))
        elif kind == 8:
            rows.append((identifier | EXTENDED, payload))
        elif kind == 9:
            rows.append(rows[int(random.integers(len(rows)))] if rows else good)
        elif kind == 10:
            rows.append((LEFT_DRIVE, random.bytes(8)))
        else:
            rows.append(good)
    return rows


def finite(state: LoopState) -> bool:
    left, right = state.plant.left, state.plant.right
    values = (*left, *right, state.plant.gate_angle, state.plant.gate_rate, state.plant.latched)
    return all(math.isfinite(value) for value in values)


def check_survived(loop: Loop, rig: Rig, sent: Rows) -> None:
    counts = loop.state.counts
    assert sum(counts[:8]) == SOUND
    assert all(counts._replace(unqualified=1)), counts  # every cause has come
    assert finite(loop.state)
    status = decoded(rig, frames_of(sent), "BenchStatus")
    assert status[-1]["RejectedFrames"] == min(sum(counts[3:8]), 65535)
    assert status[-1]["EmulatorState"] == STOPPED


@pytest.mark.parametrize("seed", [1, 2])
def test_ten_thousand_bad_frames_are_each_counted_once_and_survived(rig: Rig, seed: int):
    rows = junk(rig, SOUND, seed)
    batches = [rows[start : start + 20] for start in range(0, SOUND, 20)]
    transport = Memory(batches)
    loop = loop_of(transport, loop_config(rig=rig))
    run_free(loop, 1000, never)
    assert loop.state.tick == 1000
    loop.finish()
    check_survived(loop, rig, transport.sent)


@pytest.fixture
def channel() -> Iterator[str]:
    return str(uuid.uuid4())


def test_ten_thousand_bad_frames_on_a_real_bus_are_each_counted_once_and_survived(
    rig: Rig, channel: str
):
    transport = CanTransport({"interface": "virtual", "channel": channel})
    loop = loop_of(transport, loop_config(rig=rig))
    heard: Rows = []
    with can.Bus(interface="virtual", channel=channel) as other:
        rows = junk(rig, SOUND, 3)
        for start in range(0, SOUND, 50):
            for identifier, payload in rows[start : start + 50]:
                remote = bool(identifier & REMOTE)
                other.send(
                    can.Message(
                        arbitration_id=identifier & 0x1FFFFFFF,
                        is_extended_id=bool(identifier & EXTENDED),
                        is_remote_frame=remote,
                        is_error_frame=bool(identifier & ERROR),
                        is_fd=len(payload) > 8,
                        dlc=8 if remote else len(payload),
                        data=None if remote else payload,
                    )
                )
            loop.advance(transport.receive(), 1)
        run_free(loop, 1000, never)
        loop.finish()
        while (message := other.recv(0)) is not None:
            heard.append((message.arbitration_id, bytes(message.data)))
    transport.close()
    check_survived(loop, rig, heard)


def test_a_flood_is_read_over_several_ticks_and_none_of_it_is_dropped(rig: Rig, channel: str):
    transport = CanTransport({"interface": "virtual", "channel": channel})
    loop = loop_of(transport, loop_config(rig=rig))
    with can.Bus(interface="virtual", channel=channel) as other:
        for number in range(2000):
            other.send(can.Message(arbitration_id=0x400, data=[number % 256], is_extended_id=False))
        run_free(loop, 20, never)
    transport.close()
    assert loop.state.counts == NO_COUNTS._replace(foreign=2000)


def test_commands_with_every_possible_byte_leave_the_plant_finite(
    rig: Rig, fast_tick: Callable[..., Any]
):
    config = loop_config(rig=rig)
    state = start_of(config)
    for number, byte in enumerate(range(256)):
        rows = [(COMMAND, command_payload(rig, number)), (BENCH_CONTROL, bytes([byte] * 8))]
        state = catch_up(fast_tick, config, state, frames_of(rows), 5)[-1][0]
        assert finite(state)
    rows = [command_frame(rig, 255, **both(0.0, BRAKE))]
    state, _, _, _ = fast_tick(config, state, frames_of(rows), outside())
    assert finite(state)
