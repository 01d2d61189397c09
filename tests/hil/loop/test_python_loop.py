"""The Python loop around the tick: transports, recorders and peers."""

from __future__ import annotations

import functools
import math
import operator
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hil_support import (
    BENCH_CONTROL,
    BRAKE,
    COMMAND,
    LEFT_DRIVE,
    OF_DRIVES,
    OPEN,
    SLOWER,
    both,
    catch_up,
    command_frame,
    command_payload,
    decoded,
    frames_of,
    loop_config,
    outside,
    panel_frame,
    start_of,
)
from loop_fakes import Memory, Notes, Rows, command, loop_of, never

from liftgate_hil.codec.frames import ERROR, EXTENDED, REMOTE
from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.config.rig import Rig
from liftgate_hil.ecu.adapter import ReferenceEcu
from liftgate_hil.ecu.peer import Peer
from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.open import open_writer
from liftgate_hil.isolate.recorders import RecordingSink
from liftgate_hil.loop.observers import Trace
from liftgate_hil.loop.python_loop import Loop, run_free
from liftgate_hil.loop.tick import STOPPED, LoopState
from liftgate_hil.signals import columns_of
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import Request, by_the_clock
from liftgate_hil.transport.base import LinkCounts
from liftgate_hil.transport.can_bus import CanTransport

# Free runs.


@pytest.mark.parametrize("ticks", [1, 7, 100])
def test_a_free_run_makes_the_requested_number_of_ticks(rig: Rig, ticks: int):
    notes = Notes()
    loop = loop_of(Memory(), loop_config(rig=rig), sinks=[notes])
    run_free(loop, ticks, never)
    assert loop.state.tick == ticks
    assert notes.times == pytest.approx([0.001 * (1 + number) for number in range(ticks)])


def test_a_python_loop_ends_when_asked_to_stop(rig: Rig):
    loop = loop_of(Memory(), loop_config(rig=rig))
    run_free(loop, None, lambda: loop.state.tick >= 42)
    assert loop.state.tick == 42


def test_frames_dropped_during_the_run_are_recorded_and_earlier_ones_are_not(rig: Rig):
    class Lossy(Memory):
        dropped = 100

        def counts(self) -> LinkCounts:
            return LinkCounts(dropped=self.dropped)

    class Peer:
        is_ours, dropped = False, 20

        def poll(self, now_ns: int) -> None:
            if now_ns == 5_000_000:
                transport.dropped, self.dropped = 103, 21

    shown, transport = Trace(), Lossy()
    loop = loop_of(transport, loop_config(rig=rig), peers=[Peer()], sinks=[shown])
    loop.begin()
    run_free(loop, 10, never)
    loop.finish()
    assert shown.columns()["frames_dropped"].tolist() == [*(5 * [0.0]), *(6 * [4.0])]
    assert loop.summary("lockstep").link == LinkCounts(dropped=4)


def test_the_end_of_a_run_sends_every_message_with_motors_off_and_silences_the_peers(rig: Rig):
    polled: list[int] = []

    class Peer:
        is_ours, dropped = False, 0

        def poll(self, now_ns: int) -> None:
            polled.append(now_ns)

    notes = Notes()
    transport = Memory([[command(rig, 0)]])
    loop = loop_of(transport, loop_config(rig=rig), sinks=[notes], peers=[Peer()])
    loop.begin()
    run_free(loop, 10, never)
    loop.finish()
    assert polled == [0, *(1_000_000 * (1 + number) for number in range(10))]
    assert sorted(row[0] for row in notes.sent[-1]) == [*OF_DRIVES, *SLOWER]
    status = decoded(rig, frames_of(transport.sent), "BenchStatus")
    assert status[-1]["EmulatorState"] == STOPPED
    assert len(notes.times) == 11


def test_beginning_a_run_sends_and_records_nothing(rig: Rig):
    transport, notes = Memory(), Notes()
    loop = loop_of(transport, loop_config(rig=rig), sinks=[notes])
    loop.begin()
    assert (loop.state.tick, transport.sent, notes.times) == (0, [], [])
    assert loop.summary("free").frames_sent == 0


def test_a_recorder_gets_every_sent_and_received_frame_once(rig: Rig):
    batches: list[Rows] = [[command(rig, n), (0x55, b"x")] if n % 10 == 0 else [] for n in range(100)]
    transport, notes = Memory([list(batch) for batch in batches]), Notes()
    loop = loop_of(transport, loop_config(rig=rig), sinks=[notes])
    run_free(loop, 100, never)
    assert notes.received == batches
    assert [row for rows in notes.sent for row in rows] == transport.sent
    summary = loop.summary("free")
    assert summary.frames_sent == len(transport.sent)
    bits = sum(
        47 + 8 * len(payload) for _, payload in (*transport.sent, *functools.reduce(operator.iadd, batches, []))
    )
    assert summary.bus_load_percent == pytest.approx(100.0 * bits / (500_000 * 0.1))


def test_a_diverged_plant_ends_the_run_after_its_frames_were_sent(rig: Rig):
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


def test_a_diverged_current_of_the_right_drive_is_noticed_too(rig: Rig):
    config = loop_config(rig=rig)
    state = start_of(config)
    right = state.plant.right._replace(current=math.nan)
    loop = loop_of(Memory(), config, state._replace(plant=state.plant._replace(right=right)))
    with pytest.raises(PlantDivergedError):
        run_free(loop, 3, never)


# The reference ECU on an in-process bus.


def closed_loop(rig: Rig, folder: Path, ticks: int) -> tuple[Loop, ReferenceEcu, list[Path]]:
    """Run emulator and ECU; record as CSV and as candump text."""
    folder.mkdir()
    channel = str(uuid.uuid4())
    ours = CanTransport({"interface": "virtual", "channel": channel})
    theirs = CanTransport({"interface": "virtual", "channel": channel})
    ecu = ReferenceEcu(rig, 2)
    requests = [Request(Instant(0.3), "open"), Request(Instant(2.0), "close")]
    peer = Peer(ecu, theirs, by_the_clock(requests))
    paths = [folder / "plant.csv", folder / "bus.log"]
    content = Content(columns_of(2), "bench")
    recorders = [open_writer(path, content) for path in paths]
    recording = RecordingSink(recorders, content)
    noise = ["sensors.current_noise=0.05"]
    loop = loop_of(ours, loop_config(rig=rig, settings=noise, seed=5), sinks=[recording], peers=[peer])
    try:
        loop.begin()
        run_free(loop, ticks, never)
        loop.finish()
        recording.flush()
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
    """Frames such as a broken or hostile node might send."""
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
    """Check that each of SOUND frames was counted once, every cause occurred, and the state is finite."""
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


def test_ten_thousand_bad_frames_on_a_virtual_bus_are_each_counted_once_and_survived(rig: Rig, channel: str):
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
            loop.advance(transport.receive())
        run_free(loop, 1000, never)
        loop.finish()
        while (message := other.recv(0)) is not None:
            heard.append((message.arbitration_id, bytes(message.data)))
    transport.close()
    check_survived(loop, rig, heard)


def test_a_flood_of_frames_is_read_over_several_ticks_without_drops(rig: Rig, channel: str):
    transport = CanTransport({"interface": "virtual", "channel": channel})
    loop = loop_of(transport, loop_config(rig=rig))
    with can.Bus(interface="virtual", channel=channel) as other:
        for number in range(2000):
            other.send(can.Message(arbitration_id=0x400, data=[number % 256], is_extended_id=False))
        run_free(loop, 20, never)
    transport.close()
    assert loop.state.counts == NO_COUNTS._replace(foreign=2000)


def test_benchcontrol_frames_of_every_byte_value_leave_the_plant_finite(rig: Rig, fast_tick: Callable[..., Any]):
    config = loop_config(rig=rig)
    state = start_of(config)
    for number, byte in enumerate(range(256)):
        rows = [(COMMAND, command_payload(rig, number)), (BENCH_CONTROL, bytes([byte] * 8))]
        state = catch_up(fast_tick, config, state, frames_of(rows), 5)[-1][0]
        assert finite(state)
    rows = [command_frame(rig, 255, **both(0.0, BRAKE))]
    state, _, _, _ = fast_tick(config, state, frames_of(rows), outside())
    assert finite(state)
