"""Messages about the progress of a run."""

from __future__ import annotations

import numpy as np
import pytest
from hil_support import BENCH_CONTROL, command_payload, frames_of, panel_frame

from liftgate_hil.codec.frames import EXTENDED, REMOTE
from liftgate_hil.codec.receive import NO_COUNTS, receive
from liftgate_hil.codec.refusals import BAD_CHECKSUM, BAD_COUNTER
from liftgate_hil.ecu.events import IN_WORDS, Event
from liftgate_hil.loop.listener import Listener, RunStatus
from liftgate_hil.loop.progress_monitor import Moment, ProgressMonitor
from liftgate_hil.plan.plan import loop_config_of, start_of
from liftgate_hil.plan.setup import rig_from, vehicle_from
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH
from liftgate_hil.transport.base import LinkCounts

COMMAND = 0x120
APART = "two benches need a group each"
REMEDY = "check that `rig` is that of the ECU"


class NotingListener(Listener):
    """Listener that keeps messages and statuses."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.seen: list[RunStatus] = []

    def say(self, text: str) -> None:
        self.said.append(text)

    def happened(self, time_s: float, text: str) -> None:
        self.said.append(f"{time_s} {text}")

    def status(self, status: RunStatus) -> None:
        self.seen.append(status)


class Bench:
    """A receiving gate with a progress monitor; the test sets its clock."""

    def __init__(self, apart: str = "", within: str = "") -> None:
        self.now = 100.0
        self.rig = rig_from("liftgate")
        self.config = loop_config_of(vehicle_from("suv"), self.rig, 1000.0, 0)
        self.reception = start_of(self.config).reception
        self.counts = NO_COUNTS
        self.told = NotingListener()
        self.events: list[Event] = []
        self.link = LinkCounts()
        self.monitor = ProgressMonitor(
            self.rig,
            self.config,
            self.reception,
            self.told,
            lambda told: self.events[told:],
            lambda: self.now,
            apart=apart,
            within=within,
            why_full="the line has no room",
        )
        self.sum_at = int(self.config.inputs.messages[0].checksum_byte)
        self.row = np.zeros(ROW_WIDTH)
        self.row[COLUMN_PLACE["gate_angle_deg"]] = 12.5
        self.row[COLUMN_PLACE["left_current_a"]] = 1.5

    def receive(self, payload: bytes, identifier: int = COMMAND, tick: int = 0) -> None:
        frames = frames_of([(identifier, payload)])
        self.counts = receive(self.config.inputs, self.reception, self.counts, frames, tick * self.config.step_ns)

    def look(self, tick: int = 0, after: float = 1.0, is_last: bool = False) -> list[str]:
        """Set the clock `after` s ahead, let the monitor look, and return the messages that it gives."""
        self.now += after
        before = len(self.told.said)
        self.monitor.look(Moment(tick, self.row, 7, 3, self.link), is_last)
        return self.told.said[before:]


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_valid_command_is_shown_in_the_status_without_a_message(bench: Bench):
    bench.receive(command_payload(bench.rig, 1), tick=10)
    assert bench.look(tick=15) == []
    (status,) = bench.told.seen
    assert status == RunStatus(0.015, 12.5, 1.5, 0.0, pytest.approx(0.005), 7, 1, 0, 0, 3)


def test_the_first_refusal_of_each_kind_is_reported_once_with_the_expected_value(bench: Bench):
    good = command_payload(bench.rig, 1)
    bench.receive(good, tick=10)
    bench.receive(good, tick=20)
    bench.receive(good[:-1], tick=30)
    spoilt = bytearray(command_payload(bench.rig, 2))
    right = spoilt[bench.sum_at]
    spoilt[bench.sum_at] ^= 0xFF
    bench.receive(bytes(spoilt), tick=40)
    bench.receive(command_payload(bench.rig, 2, LeftDuty=102.0), tick=50)
    bench.receive(b"", COMMAND | REMOTE, tick=60)
    said = sorted(bench.look(tick=70))
    assert said == [
        "0.020 s: DriveCommand refused: AliveCounter is 1; expected 2",
        f"0.030 s: DriveCommand refused: {len(good) - 1} bytes; expected {len(good)}",
        f"0.040 s: DriveCommand refused: Checksum is 0x{right ^ 0xFF:X}; expected 0x{right:X}",
        "0.050 s: DriveCommand refused: LeftDuty is 102 %; allowed by the database: 0 to 100 %",
        "0.060 s: DriveCommand refused: a remote frame; allowed: a data frame",
    ]
    bench.receive(good[:-1], tick=80)
    assert bench.look(tick=90) == []
    assert bench.told.seen[-1].rejected == 6


def test_waiting_for_a_command_its_arrival_and_its_timeout_are_reported(bench: Bench):
    assert bench.look(after=0.0) == []
    assert bench.look(tick=1000) == []
    assert bench.look(tick=2500, after=1.5) == ["2.500 s: waits for DriveCommand (0x120), motors off"]
    assert bench.look(tick=9000, after=9.0) == []
    bench.receive(command_payload(bench.rig, 1), tick=9100)
    assert bench.look(tick=9101) == ["9.101 s: DriveCommand received"]
    bench.reception.seen_ns[:] = -1
    assert bench.look(tick=9200) == ["9.200 s: DriveCommand timed out: motors off"]
    bench.receive(command_payload(bench.rig, 2), tick=9300)
    assert bench.look(tick=9301) == ["9.301 s: DriveCommand received"]


def test_send_failures_are_reported_once_and_so_is_their_end(bench: Bench):
    bench.receive(command_payload(bench.rig, 1), tick=0)
    assert bench.look(tick=100) == []
    bench.link = LinkCounts(send_failures=12, send_queue_full=12)
    assert bench.look(tick=200) == []
    assert bench.told.seen[-1].unsent == 12
    bench.link = LinkCounts(send_failures=40, send_queue_full=40)
    assert bench.look(tick=300, after=0.1) == ["0.300 s: frames cannot be sent: the line has no room"]
    assert bench.look(tick=400, after=0.5) == []
    assert bench.look(tick=500, after=0.6) == ["0.500 s: frames are sent again; 40 were not sent"]
    assert bench.look(tick=600) == []
    bench.link = LinkCounts(send_failures=41, send_queue_full=40)
    bench.look(tick=700)
    assert bench.look(tick=800, after=1.5) == [
        "0.800 s: frames cannot be sent", "0.800 s: frames are sent again; 1 were not sent"
    ]  # fmt: skip


def test_send_failures_of_a_lost_link_are_not_reported(bench: Bench):
    bench.receive(command_payload(bench.rig, 1), tick=0)
    bench.look(tick=100)
    for tick, link in enumerate(
        (LinkCounts(send_failures=1), LinkCounts(send_failures=9, losses=1), LinkCounts(send_failures=9, losses=1))
    ):
        bench.link = link
        assert bench.look(tick=200 + tick, after=0.6) == []
    assert bench.look(tick=250, after=1.5) == []
    bench.link = LinkCounts(send_failures=10, losses=1)
    bench.look(tick=300)
    assert "frames cannot be sent" in bench.look(tick=400)[0]


def test_events_of_the_ecu_are_reported_as_they_happen(bench: Bench):
    bench.events.append(Event(0.5, IN_WORDS, "opening"))
    assert bench.look(tick=600) == []  # the rows up to it are judged by the next look
    assert bench.look(tick=700) == ["0.5 opening"]
    bench.events.append(Event(0.6, IN_WORDS, "open"))
    assert bench.look(tick=800, after=0.0) == []  # too soon
    assert bench.look(tick=800, after=0.0, is_last=True) == ["0.6 open"]
    assert bench.look(tick=900) == []


def test_a_bus_with_foreign_frames_only_is_reported_as_such(bench: Bench):
    bench.look()
    bench.receive(b"\1\2", identifier=0x1A0)
    assert bench.look(tick=2500, after=2.5) == [
        "2.500 s: waits for DriveCommand (0x120), motors off; 0x1A0 is on the bus, but not received by this rig; "
        f"{REMEDY}"
    ]
    assert bench.told.seen[-1].foreign == 1


def test_foreign_frames_after_the_report_of_a_missing_command_are_reported_once(bench: Bench):
    """An ECU with another database may be started after the gate."""
    bench.look()
    assert bench.look(tick=2500, after=2.5) == ["2.500 s: waits for DriveCommand (0x120), motors off"]
    bench.receive(b"\1\2", identifier=0x1A0)
    foreign = f"0x1A0 is on the bus, but not received by this rig; {REMEDY}"
    assert bench.look(tick=4500) == [f"4.500 s: {foreign}; waits for DriveCommand (0x120)"]
    assert bench.look(tick=5500) == []


def test_foreign_frames_after_a_valid_command_are_not_reported(bench: Bench):
    bench.look()
    bench.receive(command_payload(bench.rig, 1), tick=10)
    bench.look(tick=11)
    bench.reception.seen_ns[:] = -1
    assert bench.look(tick=200) == ["0.200 s: DriveCommand timed out: motors off"]
    bench.receive(b"\1\2", identifier=0x1A0)
    assert bench.look(tick=2500, after=2.5) == []


def test_on_a_shared_bus_foreign_frames_are_reported_with_how_to_separate_benches():
    bench = Bench(APART)
    bench.look()
    bench.receive(b"\1\2", identifier=0x1A0)
    (said,) = bench.look(tick=2500, after=2.5)
    assert said.endswith(f"0x1A0 is on the bus, but not received by this rig; {REMEDY}; {APART}")


def test_frames_of_another_bench_are_not_taken_for_a_wrong_rig():
    bench = Bench(APART)
    bench.look()
    bench.receive(b"\1\2", identifier=0x210)
    (said,) = bench.look(tick=2500, after=2.5)[-1:]
    assert "check that `rig`" not in said


def test_waiting_on_a_bus_that_no_other_process_reaches_is_reported():
    bench = Bench(within="a virtual bus is within one process")
    bench.look()
    (said,) = bench.look(tick=2500, after=2.5)
    assert said == ("2.500 s: waits for DriveCommand (0x120), motors off; a virtual bus is within one process")


def test_a_counter_that_keeps_jumping_is_reported_once():
    bench = Bench()
    bench.look()
    for number in range(40):
        bench.receive(command_payload(bench.rig, 3 * number % 16), tick=10 * number)
    said = [each for each in bench.look(tick=400) if "missing by their counter" in each]
    assert said == [
        "0.400 s: 78 of 118 DriveCommand frames are missing by their counter: they are lost, the counter goes in "
        "other steps, or two nodes send them"
    ]
    assert not [each for each in bench.look(tick=500) if "missing" in each]


@pytest.mark.parametrize(("is_sound", "number_of_them"), [(True, 3), (False, 4)])
def test_frames_of_another_message_do_not_hide_missing_commands(is_sound: bool, number_of_them: int):
    """Neither accepted nor refused frames of the test bench hide them."""
    bench = Bench()
    bench.look()
    payload = panel_frame(bench.rig)[1] if is_sound else b"\0"
    for number in range(60):
        bench.receive(command_payload(bench.rig, 3 * number % 16), tick=10 * number)
        for _ in range(number_of_them):
            bench.receive(payload, BENCH_CONTROL, tick=10 * number)
    assert any("are missing by their counter" in each for each in bench.look(tick=600))


def test_refused_frames_are_not_reported_as_missing():
    bench = Bench()
    bench.look()
    for number in range(100):
        payload = bytearray(command_payload(bench.rig, number % 16))
        if number % 5 < 2:
            payload[bench.sum_at] ^= 0xFF
        bench.receive(bytes(payload), tick=10 * number)
    said = bench.look(tick=1000)
    assert any("Checksum is" in each for each in said)
    assert not [each for each in said if "missing" in each]


def test_another_gate_is_reported_even_after_other_control_units_were_heard():
    bench = Bench()
    bench.look()
    for identifier in (0x3B3, 0x18FF0102 | EXTENDED, 0x210):
        bench.receive(bytes(8), identifier=identifier)
    (said,) = [each for each in bench.look(tick=1) if "which this gate sends" in each]
    assert "received LeftDrive (0x210)" in said


def test_a_frame_of_another_gate_is_not_also_reported_as_unknown():
    bench = Bench()
    bench.look()
    bench.receive(bytes(8), identifier=0x210)
    (another,) = bench.look(tick=1)
    assert "which this gate sends" in another
    assert bench.look(tick=2500, after=2.5) == ["2.500 s: waits for DriveCommand (0x120), motors off"]


@pytest.mark.parametrize("apart", ["", APART])
def test_another_gate_on_the_bus_is_reported_once_with_how_to_separate_benches_if_known(apart: str):
    bench = Bench(apart)
    bench.look()
    for number in range(3):
        bench.receive(command_payload(bench.rig, number + 1))
        bench.receive(bytes(8), identifier=0x210)
        said = [each for each in bench.look(tick=number) if "another" in each]
        expected = (
            "0.000 s: received LeftDrive (0x210), which this gate sends: another bench or a replay is on this bus"
            + (f"; {apart}" if apart else "")
        )
        assert said == ([expected] if number == 0 else [])


def test_a_64_bit_checksum_is_reported_to_the_last_digit(bench: Bench):
    refusal = bench.reception.refusals[BAD_CHECKSUM]
    refusal.count, refusal.message = 1, 0
    refusal.checksum, refusal.right_checksum = -1, 2**62 + 1
    (said,) = bench.look()
    assert said.endswith("Checksum is 0xFFFFFFFFFFFFFFFF; expected 0x4000000000000001")


def test_a_first_frame_with_an_impossible_counter_value_is_reported(bench: Bench):
    refusal = bench.reception.refusals[BAD_COUNTER]
    refusal.count, refusal.message, refusal.found, refusal.expected = 1, 0, 15.0, np.nan
    (said,) = bench.look()
    assert said.endswith("AliveCounter is 15; expected one of its values")
