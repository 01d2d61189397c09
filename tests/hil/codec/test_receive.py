"""Reception of frames: accepted whole or refused whole, and counted under exactly one cause."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
from hil_support import (
    BENCH_CONTROL,
    COMMAND,
    LEFT_DRIVE,
    OPEN,
    both,
    command_frame,
    command_payload,
    forgotten,
    frames_of,
    panel_frame,
    rig_of,
    shipped_rig,
    taken,
    with_checksum,
)

from liftgate_hil.codec.frames import ERROR, EXTENDED, REMOTE
from liftgate_hil.codec.receive import NO_COUNTS, Counts, Reception, nothing_received, rejected
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.config.rig import Rig
from liftgate_hil.signals import BUS_INPUTS, IN

MS = 1_000_000


@pytest.fixture
def bus(rig: Rig) -> BusConfig:
    return rig.input_config()


@pytest.fixture
def fresh(bus: BusConfig) -> Reception:
    return nothing_received(bus, len(BUS_INPUTS))


def take(
    bus: BusConfig, reception: Reception, *rows: tuple[int, bytes], counts: Counts = NO_COUNTS, now: int = 0
) -> tuple[Reception, Counts]:
    return taken(bus, reception, counts, frames_of(rows), now)


def value(reception: Reception, name: str) -> float:
    return float(reception.values[getattr(IN, name)])


def same(first: Reception, second: Reception) -> bool:
    """Tell whether two receptions are equal apart from the memory of refused and foreign frames."""
    first, second = (
        each._replace(read=each.values, refusals=each.values, foreign=each.values) for each in (first, second)
    )
    return all(
        np.array_equal(a, b, equal_nan=True) if a.dtype.kind == "f" else np.array_equal(a, b)
        for a, b in zip(first, second, strict=True)
    )


def test_a_valid_command_is_accepted(rig: Rig, bus: BusConfig, fresh: Reception):
    frame = command_frame(
        rig, 3, LeftDuty=12.3, RightDuty=100.0, LeftDirection=1, RightDirection=2, LatchRelease=1
    )
    reception, counts = take(bus, fresh, frame)
    assert counts == NO_COUNTS._replace(accepted=1)
    assert value(reception, "left_duty") == pytest.approx(12.3)
    assert value(reception, "right_duty") == 100.0
    assert value(reception, "left_direction") == 1.0
    assert value(reception, "right_direction") == 2.0
    assert value(reception, "latch_release") == 1.0
    assert np.isnan(value(reception, "hand_force"))


def test_values_of_a_bench_control_message_are_accepted(rig: Rig, bus: BusConfig, fresh: Reception):
    frame = panel_frame(
        rig, ObstacleAngle=35.0, ObstacleRate=10.0, RoadSlope=-12.0, SupplyVoltage=9.5,
        HandForce=-200.0,
    )  # fmt: skip
    reception, counts = take(bus, fresh, frame)
    assert counts.accepted == 1
    names = ("obstacle_angle", "obstacle_rate", "road_slope", "supply_voltage", "hand_force")
    assert [value(reception, name) for name in names] == pytest.approx([35.0, 10.0, -12.0, 9.5, -200.0])


def refusals(rig: Rig) -> dict[str, tuple[str, tuple[int, bytes]]]:
    good = command_payload(rig, 4, **both(50.0, OPEN))
    bad_sum = good[:7] + bytes([good[7] ^ 1])
    return {
        "another identifier": ("foreign", (0x121, good)),
        "the same identifier, extended": ("foreign", (COMMAND | EXTENDED, good)),
        "a message that we send": ("foreign", (LEFT_DRIVE, good)),
        "an error frame": ("error", (ERROR, bytes(8))),
        "an error frame with our identifier": ("error", (COMMAND | ERROR, good)),
        "a remote request for ours": ("remote", (COMMAND | REMOTE, bytes(8))),
        "a remote request for another": ("foreign", (0x333 | REMOTE, b"")),
        "no payload": ("wrong_length", (COMMAND, b"")),
        "one byte short": ("wrong_length", (COMMAND, good[:7])),
        "one byte long": ("wrong_length", (COMMAND, good + b"\0")),
        "a CAN FD payload": ("wrong_length", (COMMAND, good.ljust(64, b"\0"))),
        "a wrong checksum": ("checksum", (COMMAND, bad_sum)),
        "a checksum of another identifier": ("checksum", (COMMAND, with_checksum(0x121, good))),
        "a repeated counter": ("counter", command_frame(rig, 3, **both(60.0, OPEN))),
        "a duty over 100 %": ("out_of_range", command_frame(rig, 4, LeftDuty=100.1, LeftDirection=1)),
        "the other duty over 100 %": (
            "out_of_range",
            command_frame(rig, 4, LeftDuty=10.0, RightDuty=102.3, LeftDirection=1),
        ),
        "a supply voltage over 40 V": ("out_of_range", (BENCH_CONTROL, b"\0\0\0\0\xf0\xff\0\0")),
    }


@pytest.mark.parametrize("case", refusals(shipped_rig()))
def test_a_refused_frame_counts_once_and_changes_no_value(rig: Rig, bus: BusConfig, fresh: Reception, case: str):
    cause, frame = refusals(rig)[case]
    before, counts = take(bus, fresh, command_frame(rig, 3, **both(50.0, OPEN)))
    after, total = take(bus, before, frame, counts=counts, now=5 * MS)
    assert total == counts._replace(**{cause: 1})
    assert sum(total[:8]) == 2
    # A frame that came is one cycle more, and if its counter could be read, moves it on; nothing else is taken.
    is_cycle = cause not in ("foreign", "error", "remote", "counter")
    assert after.cycles.sum() - before.cycles.sum() == int(is_cycle)
    sound = cause == "out_of_range" and after.counter[0] != before.counter[0]
    assert after.unread.sum() == int(is_cycle and cause != "out_of_range")
    after = after._replace(cycles=before.cycles, unread=before.unread)
    assert same(before, after._replace(counter=before.counter) if sound else after)
    assert rejected(total) == int(cause not in ("foreign", "error"))


def test_the_cycles_of_a_message_are_its_frames_and_those_missing_by_its_counter(
    rig: Rig, bus: BusConfig, fresh: Reception
):
    state = fresh
    for turn, cycles in ((3, 1), (4, 2), (7, 5), (7, 5), (15, 13), (1, 15)):
        state, _ = take(bus, state, command_frame(rig, turn, **both(50.0, OPEN)))
        assert state.cycles.tolist()[0] == cycles


def test_an_invalid_frame_does_not_affect_valid_ones_of_the_same_read(rig: Rig, bus: BusConfig, fresh: Reception):
    reception, counts = take(
        bus,
        fresh,
        (0x400, bytes(8)),
        command_frame(rig, 1, LeftDuty=102.3),
        (COMMAND, bytes(3)),
        command_frame(rig, 2, **both(40.0, OPEN)),
        panel_frame(rig, HandForce=30.0),
    )
    assert (counts.accepted, counts.foreign, counts.out_of_range, counts.wrong_length) == (2, 1, 1, 1)
    assert value(reception, "left_duty") == pytest.approx(40.0)
    assert value(reception, "hand_force") == pytest.approx(30.0)


def test_reception_does_not_modify_its_arguments(rig: Rig, bus: BusConfig, fresh: Reception):
    before, counts = take(bus, fresh, command_frame(rig, 1, **both(40.0, OPEN)))
    kept = copy.deepcopy(before)
    frames = frames_of([command_frame(rig, 2, **both(70.0, OPEN)), panel_frame(rig)])
    kept_data = frames.data.copy()
    taken(bus, before, counts, frames, 10 * MS)
    forgotten(bus, before, 1000 * MS)
    assert same(before, kept)
    assert np.array_equal(frames.data, kept_data)


@pytest.mark.parametrize(
    ("turns", "counts", "duty"), [((15, 0), {"accepted": 2}, 60.0), ((5, 5), {"accepted": 1, "counter": 1}, 40.0)]
)
def test_the_later_of_two_commands_holds_unless_its_counter_is_repeated(
    rig: Rig, bus: BusConfig, fresh: Reception, turns: tuple[int, int], counts: dict[str, int], duty: float
):
    rows = [command_frame(rig, turn, **both(own, OPEN)) for turn, own in zip(turns, (40.0, 60.0), strict=True)]
    reception, found = take(bus, fresh, *rows)
    assert found == NO_COUNTS._replace(**counts)
    assert value(reception, "left_duty") == pytest.approx(duty)


@pytest.mark.parametrize(("last", "now", "lost"), [(0, 1, 0), (15, 0, 0), (3, 6, 2), (14, 1, 2), (5, 4, 14)])
def test_frames_missing_between_two_counter_values_count_as_lost(
    rig: Rig, bus: BusConfig, fresh: Reception, last: int, now: int, lost: int
):
    reception, counts = take(bus, fresh, command_frame(rig, last))
    assert counts.lost == 0
    _, counts = take(bus, reception, command_frame(rig, now), counts=counts)
    assert counts == NO_COUNTS._replace(accepted=2, lost=lost)


@pytest.mark.parametrize(("refused", "now", "lost"), [(2, 3, 0), (4, 5, 2)])  # 2 and 3 never came
def test_a_refused_frame_does_not_count_as_lost_but_missing_ones_before_it_do(
    rig: Rig, bus: BusConfig, fresh: Reception, refused: int, now: int, lost: int
):
    bad = command_frame(rig, refused, LeftDuty=102.3)
    _, counts = take(bus, fresh, command_frame(rig, 1), bad, command_frame(rig, now))
    assert counts == NO_COUNTS._replace(accepted=2, out_of_range=1, lost=lost)


@pytest.mark.parametrize(("now", "lost"), [(2, 0), (3, 0), (4, 1), (6, 3)])
def test_a_frame_without_a_readable_counter_counts_as_refused_and_not_as_lost(
    rig: Rig, bus: BusConfig, fresh: Reception, now: int, lost: int
):
    arbitration_id, data = command_frame(rig, 2)
    reception, counts = take(
        bus, fresh, command_frame(rig, 1), (arbitration_id, data[:-1]), command_frame(rig, now)
    )
    assert counts == NO_COUNTS._replace(accepted=2, wrong_length=1, lost=lost)
    _, counts = take(bus, reception, command_frame(rig, now + 2), counts=counts)  # it counts for one gap only
    assert counts.lost == lost + 1


def test_after_a_time_out_any_counter_value_is_accepted(rig: Rig, bus: BusConfig, fresh: Reception):
    reception, counts = take(bus, fresh, command_frame(rig, 7, **both(40.0, OPEN)))
    reception, stale = forgotten(bus, reception, 30 * MS)
    assert stale == 1
    reception, counts = take(bus, reception, command_frame(rig, 7, **both(50.0, OPEN)), counts=counts, now=40 * MS)
    assert counts == NO_COUNTS._replace(accepted=2)
    assert value(reception, "left_duty") == pytest.approx(50.0)
    _, counts = take(bus, reception, command_frame(rig, 7), counts=counts, now=50 * MS)
    assert counts.counter == 1


def test_values_become_stale_at_the_time_out_and_not_before(rig: Rig, bus: BusConfig, fresh: Reception):
    start = 17 * MS
    reception, _ = take(bus, fresh, command_frame(rig, 1, **both(40.0, OPEN)), panel_frame(rig), now=start)
    young, stale = forgotten(bus, reception, start + 30 * MS - 1)
    assert stale == 0
    assert same(young, reception)
    old, stale = forgotten(bus, reception, start + 30 * MS)
    assert stale == 1
    for name in BUS_INPUTS:
        if name in ("left_duty", "right_duty", "left_direction", "right_direction", "latch_release"):
            assert np.isnan(value(old, name)), name
        else:
            np.testing.assert_equal(value(old, name), value(reception, name), name)
    assert forgotten(bus, old, start + 60 * MS)[1] == 0


def test_values_of_a_bench_control_message_never_become_stale(rig: Rig, bus: BusConfig, fresh: Reception):
    reception, _ = take(bus, fresh, panel_frame(rig, HandForce=100.0))
    reception, stale = forgotten(bus, reception, 10**15)
    assert stale == 0
    assert value(reception, "hand_force") == pytest.approx(100.0)


def test_refused_frames_do_not_prolong_a_command(rig: Rig, bus: BusConfig, fresh: Reception):
    reception, _ = take(bus, fresh, command_frame(rig, 1, **both(40.0, OPEN)))
    for now in (10 * MS, 20 * MS):
        reception, _ = take(bus, reception, command_frame(rig, 1, **both(40.0, OPEN)), now=now)
    assert forgotten(bus, reception, 30 * MS)[1] == 1


DATABASE = """VERSION ""
BS_:
BU_: A
BO_ 2566844672 Antrieb: 8 A
 SG_ Tastgrad : 7|16@0- (0.001,0) [-1.2|1.2] "" A
 SG_ Richtung : 16|4@1+ (1,0) [0|15] "" A
 SG_ Zaehler : 24|2@1+ (1,0) [0|3] "" A
BO_ 256 Heraus: 8 A
 SG_ Strom : 0|16@1- (1,0) [0|0] "mA" A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 2566844672 20;
BA_ "GenMsgCycleTime" BO_ 256 20;
VAL_ 2566844672 Richtung 9 "Auf" 5 "Zu" 0 "Frei" 12 "Unbekannt" ;
"""
THEIRS = 2566844672 & 0x1FFFFFFF | EXTENDED


def test_one_signal_may_drive_both_motors_with_its_sign_as_direction(tmp_path: Path):
    text = """
dbc = "their.dbc"
[inputs]
left_duty = { signal = "Antrieb.Tastgrad", scale = 100 }
right_duty = { signal = "Antrieb.Tastgrad", scale = -100 }
[outputs]
left_current = { signal = "Heraus.Strom", scale = 0.001 }
"""
    reception, counts = received(tmp_path, text, Tastgrad=-0.25)
    assert counts.accepted == 1
    assert value(reception, "left_duty") == pytest.approx(-25.0)
    assert value(reception, "right_duty") == pytest.approx(25.0)
    # In their range, but over 100 % in ours.
    _, counts = received(tmp_path, text, Tastgrad=1.1)
    assert counts.out_of_range == 1


LABELS = """
dbc = "their.dbc"
[inputs]
left_duty = { signal = "Antrieb.Tastgrad", scale = 100 }
[inputs.left_direction]
signal = "Antrieb.Richtung"
values = { open = "Auf", close = "Zu", coast = 0, brake = 3 }
[outputs]
left_current = { signal = "Heraus.Strom", scale = 0.001 }
[messages.Antrieb]
counter = "Zaehler"
timeout_cycles = 2
"""


def received(folder: Path, text: str, **values: float) -> tuple[Reception, Counts]:
    """Return the reception and its counts after one frame of a foreign rig."""
    rig = rig_of(folder, DATABASE, text)
    bus = rig.input_config()
    payload = rig.messages["Antrieb"].encode({"Richtung": 3, "Zaehler": 0, **values})
    return take(bus, nothing_received(bus, len(BUS_INPUTS)), (THEIRS, payload))


@pytest.mark.parametrize(("raw", "ours"), [(9, 1.0), (5, 2.0), (0, 0.0), (3, 3.0)])
def test_foreign_labels_and_numbers_are_mapped_to_our_enumeration(tmp_path: Path, raw: int, ours: float):
    reception, counts = received(tmp_path, LABELS, Tastgrad=0.5, Richtung=raw)
    assert counts.accepted == 1
    assert value(reception, "left_direction") == ours


@pytest.mark.parametrize("raw", [1, 2, 12, 15])
def test_an_unmapped_number_refuses_the_whole_frame(tmp_path: Path, raw: int):
    reception, counts = received(tmp_path, LABELS, Tastgrad=0.5, Richtung=raw)
    assert counts == NO_COUNTS._replace(out_of_range=1)
    assert np.isnan(reception.values).all()


def test_counter_width_and_time_out_of_a_foreign_rig_apply(tmp_path: Path):
    rig = rig_of(tmp_path, DATABASE, LABELS)
    bus = rig.input_config()
    reception = nothing_received(bus, len(BUS_INPUTS))
    counts = NO_COUNTS
    for now, counter in ((0, 3), (20, 0), (40, 3)):
        payload = rig.messages["Antrieb"].encode({"Tastgrad": 0.5, "Richtung": 9, "Zaehler": counter})
        reception, counts = take(bus, reception, (THEIRS, payload), counts=counts, now=now * MS)
    assert counts == NO_COUNTS._replace(accepted=3, lost=2)
    assert forgotten(bus, reception, 80 * MS - 1)[1] == 0
    assert forgotten(bus, reception, 80 * MS)[1] == 1
