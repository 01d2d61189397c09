"""The example ECU as a library: its requests, cycle and frames, and its reaction to received frames."""

from __future__ import annotations

import random
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from c_ecu import CLOSE, OPEN, STOP, Frame, LibraryEcu, build_library, needs_compiler
from ecu_bench import END_STOP, MS, Bench, Gate, decode, duty_of, whole_gate
from hil_support import COMMAND, GATE, LEFT_DRIVE, RIGHT_DRIVE, SENSORS, with_checksum

pytestmark = needs_compiler

EXTENDED, REMOTE, ERROR, FD = 0x80000000, 0x40000000, 0x20000000, 1
ABI = {f"liftgate_ecu_{name}" for name in ("create", "destroy", "request", "step")}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_library(tmp_path_factory.mktemp("ecu"))


@pytest.fixture
def ecu(library: Path) -> Iterator[LibraryEcu]:
    each = LibraryEcu(library)
    yield each
    each.close()


@pytest.fixture
def other(library: Path) -> Iterator[LibraryEcu]:
    each = LibraryEcu(library)
    yield each
    each.close()


def test_the_library_exports_its_four_functions_and_nothing_else(library: Path) -> None:
    if shutil.which("nm") is None:
        pytest.skip("no nm")
    command = ["nm", "-D", "--defined-only", str(library)]
    listing = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    # A sanitizer adds names of its own.
    assert {name for name in (line.split()[-1] for line in listing.splitlines()) if "asan" not in name} == ABI


@pytest.mark.parametrize("tick_ns", [MS, MS // 2, 3 * MS, 10 * MS, 25 * MS, 333_333])
@pytest.mark.parametrize("begin_ns", [0, 7_123_456_789])
def test_a_command_is_sent_every_10_ms_at_any_tick_rate(ecu: LibraryEcu, tick_ns: int, begin_ns: int) -> None:
    ticks = range(0, 1000 * MS, tick_ns)
    ecu.request(OPEN)
    sent = [
        (tick, frame) for tick in ticks for frame in ecu.step(begin_ns + tick, whole_gate(0.5, 0, latched=True))
    ]
    due = {-(-start // tick_ns) * tick_ns for start in range(0, 1000 * MS, 10 * MS)}
    assert [tick for tick, _ in sent] == sorted(due & set(ticks))
    assert [decode(frame)["AliveCounter"] for _, frame in sent] == [index % 16 for index in range(len(sent))]
    assert any(duty_of(frame) > 0.0 for _, frame in sent)


def test_missed_command_cycles_are_not_caught_up(ecu: LibraryEcu) -> None:
    times = [0, *range(1000 * MS, 1050 * MS, MS)]
    sent = [now for now in times for _ in ecu.step(now)]
    assert sent == [0, *range(1000 * MS, 1050 * MS, 10 * MS)]


def test_the_ecu_sends_coasting_commands_until_asked_to_move(ecu: LibraryEcu) -> None:
    bench = Bench(ecu, Gate())
    bench.run(2.0)
    assert len(bench.sent) == 200
    assert not any(bench.duties())
    assert not any(decode(frame)["LatchRelease"] for _, frame in bench.sent)


def test_the_ecu_opens_and_closes_the_gate_on_request(ecu: LibraryEcu) -> None:
    bench = Bench(ecu, gate := Gate())
    bench.run(0.5)
    bench.press(OPEN, then=7.0)
    assert gate.count == END_STOP
    assert bench.duties(start=7.0)[-1] == 0.0
    bench.press(CLOSE, then=9.0)
    assert gate.latched
    assert bench.duties()[-1] == 0.0
    bench.press(OPEN, then=1.0)
    assert gate.count > 0.0


def test_the_gates_motion_does_not_depend_on_the_ecus_tick(library: Path) -> None:
    gates = [Gate() for _ in range(4)]
    for gate, tick_ns in zip(gates, (MS // 2, MS, 3 * MS, 25 * MS), strict=True):
        ecu = LibraryEcu(library)
        Bench(ecu, gate, tick_ns=tick_ns).press(OPEN, then=3.0)
        ecu.close()
    assert gates[0].count > 1000.0
    assert [gate.count for gate in gates[1:]] == pytest.approx([gates[0].count] * 3, abs=30.0)


def test_the_ecu_reverses_on_an_obstacle_and_refuses_to_close_meanwhile(ecu: LibraryEcu) -> None:
    bench = Bench(ecu, gate := Gate(trap=1100.0))
    bench.press(OPEN, then=7.0)
    bench.press(CLOSE, then=1.5)
    while bench.duties()[-1] < 0.0:
        bench.run(0.01)
    turned = gate.count
    assert 1000.0 < turned < 1100.0
    bench.press(CLOSE, then=0.5)
    assert bench.duties()[-1] > 0.0
    bench.run(4.0)
    assert bench.duties()[-1] == 0.0
    assert gate.count == pytest.approx(turned + 800.0, abs=50.0)


def test_a_reversal_ends_at_the_end_stop(ecu: LibraryEcu) -> None:
    bench = Bench(ecu, gate := Gate(trap=1600.0))
    bench.press(OPEN, then=7.0)
    bench.press(CLOSE, then=6.0)
    assert gate.count == END_STOP
    assert bench.duties()[-1] == 0.0


def test_a_stop_request_makes_the_motors_coast_in_the_next_cycle(ecu: LibraryEcu) -> None:
    bench = Bench(ecu, Gate())
    bench.press(OPEN, then=2.0)
    assert bench.duties()[-1] > 0.0
    bench.press(STOP, then=0.02)
    assert bench.duties()[-1] == 0.0
    bench.press(CLOSE, then=0.02)
    assert bench.duties()[-1] < 0.0


def test_a_gate_found_half_open_at_the_start_is_closed_into_its_latch_on_request(ecu: LibraryEcu) -> None:
    bench = Bench(ecu, gate := Gate(count=1500.0))
    bench.press(CLOSE, then=9.0)
    assert gate.latched


def test_a_request_waits_for_frames_of_the_gate_and_a_later_one_replaces_it(
    ecu: LibraryEcu, other: LibraryEcu
) -> None:
    for each in (ecu, other):
        each.request(OPEN)
        for now in range(0, 200 * MS, MS):
            each.step(now)
    other.request(STOP)
    for each, moves in ((ecu, True), (other, False)):
        bench = Bench(each, gate := Gate())
        bench.now_ns = 200 * MS
        bench.run(2.0)
        assert (gate.count > 0.0) is moves


def test_unknown_actions_are_ignored(ecu: LibraryEcu) -> None:
    bench = Bench(ecu, Gate())
    bench.press(OPEN, then=0.0)
    for action in (-1, 3, 2**31 - 1, -(2**31)):
        ecu.request(action)
    bench.run(1.0)
    assert bench.duties()[-1] > 0.0


def test_two_ecus_of_one_library_share_no_state(ecu: LibraryEcu, other: LibraryEcu, library: Path) -> None:
    alone = LibraryEcu(library)
    reference = Bench(alone, Gate())
    reference.press(OPEN, then=3.0)
    alone.close()
    busy, idle = Bench(ecu, Gate()), Bench(other, Gate(count=500.0))
    ecu.request(OPEN)
    for _ in range(3000):
        busy.run(0.001)
        idle.run(0.001)
    assert busy.sent == reference.sent
    assert not any(idle.duties())


def test_without_buffer_space_nothing_is_written_and_the_counter_stays(ecu: LibraryEcu) -> None:
    assert [decode(frame)["AliveCounter"] for frame in ecu.step(0)] == [0]
    assert ecu.step(10 * MS, capacity=0) == []  # a frame was due
    assert ecu.step(20 * MS, capacity=0) == []
    assert [decode(frame)["AliveCounter"] for frame in ecu.step(30 * MS, capacity=1)] == [1]


def wrong(frames: Sequence[Frame], kind: str) -> list[Frame]:
    """The frames made invalid in one of the ways of KINDS."""
    flags = {"extended": EXTENDED, "remote": REMOTE, "error": ERROR}
    lengths = {"short": -1, "long": 1, "empty": None, "absurd": 247}
    if kind in flags:
        return [each._replace(identifier=each.identifier | flags[kind]) for each in frames]
    if kind == "FD":
        return [each._replace(flags=FD) for each in frames]
    if kind == "foreign":
        return [each._replace(identifier=identifier) for each in frames for identifier in (0, COMMAND, SENSORS)]
    if kind == "checksum":  # Gate has none
        drives = [each for each in frames if each.identifier != GATE]
        return [
            each._replace(data=each.data[:at] + bytes([each.data[at] ^ bit]) + each.data[at + 1 :])
            for each in drives
            for at in range(8)
            for bit in (1, 128)
        ]
    more = lengths[kind]
    return [each._replace(length=0 if more is None else len(each.data) + more) for each in frames]


KINDS = (
    "extended", "remote", "error", "FD", "foreign", "checksum", "short", "long", "empty", "absurd",
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_frames_of_a_gate_that_sends_garbage_are_ignored(ecu: LibraryEcu, kind: str) -> None:
    sound = whole_gate(0.5, 0, latched=True)
    mixed = wrong(sound, kind) + (sound[2:] if kind == "checksum" else [])
    ecu.request(OPEN)
    sent = [frame for now in range(0, 500 * MS, MS) for frame in ecu.step(now, mixed)]
    assert len(sent) == 50
    assert not any(duty_of(frame) for frame in sent)


def test_garbage_frames_do_not_affect_a_motion(ecu: LibraryEcu, other: LibraryEcu) -> None:
    trapped_and_home = whole_gate(-30.0, 100_000, latched=True)
    noise = [frame for kind in KINDS for frame in wrong(trapped_and_home, kind)]
    clean, disturbed = Bench(ecu, Gate()), Bench(other, Gate(), noise)
    for bench in (clean, disturbed):
        bench.press(OPEN, then=3.0)
        bench.press(CLOSE, then=2.0)
    assert clean.duties()[-1] < 0.0
    assert disturbed.sent == clean.sent


def test_any_received_frames_leave_the_commands_valid(ecu: LibraryEcu) -> None:
    dice = random.Random(1)
    identifiers = [LEFT_DRIVE, RIGHT_DRIVE, GATE, 0, 0xFFFFFFFF]
    sent: list[Frame] = []
    for tick in range(5000):
        frames = [
            Frame(
                dice.choice(identifiers), data, dice.choice([0, 0, FD, 255]), dice.choice([5, 8, 8, 64, 255])
            )
            for data in (dice.randbytes(64) for _ in range(dice.randrange(4)))
        ]  # fmt: skip
        # Some of them as wild, but with their checksums right.
        frames += [
            Frame(identifier, with_checksum(identifier, dice.randbytes(8)))
            for identifier in dice.sample([LEFT_DRIVE, RIGHT_DRIVE], dice.randrange(3))
        ]
        ecu.request(dice.randrange(-1, 4))
        sent += ecu.step(tick * MS, frames)
    assert len(sent) == 500
    assert all(-1.0 <= duty_of(frame) <= 1.0 for frame in sent)
    assert {duty_of(frame) > 0.0 for frame in sent} == {True, False}
