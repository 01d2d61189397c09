"""The closed loop in machine code: each frame once and on time, and how a run ends."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hil_support import (
    BENCH_STATUS,
    COMMAND,
    GATE,
    LEFT_DRIVE,
    OF_DRIVES,
    OPEN,
    RIGHT_DRIVE,
    SENSORS,
    SWITCHES,
    both,
    command_payload,
    decoded,
    frames_of,
    j1850,
    loop_config,
    shipped_rig,
    start_of,
    stimulus_plan,
)
from run_support import CYCLE, NOISE, Keeper, ScriptedEcu, episode_of, message, releasing, reversing, run_kept

import liftgate_hil as lh
from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, REMOTE, bits_of
from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.settings import settings_of
from liftgate_hil.ecu import wire
from liftgate_hil.ecu.adapter import ReferenceEcu
from liftgate_hil.ecu.python_object import PythonEcu
from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.formats.content import Content
from liftgate_hil.isolate.recorders import RecordingSink
from liftgate_hil.loop.episode import Episode, LoopStart
from liftgate_hil.loop.observers import Extremes, Trace
from liftgate_hil.plan.setup import vehicle_from
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI, TimedStimuli
from liftgate_hil.stimuli.timeline import Profile


@pytest.fixture
def log(tmp_path: Path) -> tuple[Path, ...]:
    """The bus log to which a test records, as the argument `records`."""
    return (tmp_path / "bus.log",)


# The bus.


def test_the_gate_sends_its_messages_on_time_and_decodable(rig: Rig, log: tuple[Path, ...]) -> None:
    result, keeper = run_kept(releasing(), records=log)
    sent = keeper.wires(is_sent=True)
    for identifier, name, cycle in (
        (LEFT_DRIVE, "LeftDrive", 5), (RIGHT_DRIVE, "RightDrive", 5), (GATE, "Gate", 10),
        (SENSORS, "Sensors", 100), (BENCH_STATUS, "BenchStatus", 100),
    ):  # fmt: skip
        rows = [row for row in sent if row[1] == identifier]
        times = [time for time, _, _ in rows]
        assert times == [*range(cycle, 601, cycle), 601]
        values = decoded(rig, frames_of([(number, data) for _, number, data in rows]), name)
        if identifier in (LEFT_DRIVE, RIGHT_DRIVE):
            counters = [value["AliveCounter"] for value in values]
            assert counters == [n % 16 for n in range(len(rows))]
            assert all(data[7] == j1850(identifier, data, 7) for _, _, data in rows)
            side = name.removesuffix("Drive").lower()
            counts = keeper.rows[[round(time) - 1 for time in times], COLUMN_PLACE[f"sensed_{side}_hall_count"]]
            assert [value["HallCount"] for value in values] == counts.tolist()
    assert result.summary.frames_sent == len(sent)


def test_a_frame_of_the_ecu_reaches_the_gate_one_tick_later(rig: Rig, log: tuple[Path, ...]) -> None:
    _, keeper = run_kept(releasing(), records=log)
    commands = keeper.wires(is_sent=False)
    # It speaks before the first tick, and after each cycle; logged at the end of the tick that reads it.
    assert [time for time, _, _ in commands] == [1 + CYCLE * n for n in range(60)]
    values = decoded(rig, frames_of([(number, data) for _, number, data in commands]), "DriveCommand")
    assert [value["AliveCounter"] for value in values] == [n % 16 for n in range(60)]
    duties = [value["LeftDuty"] for value in values]
    # Asked at 50 ms, obeyed one cycle later; sent after tick 60, read in tick 61.
    first = next(n for n, duty in enumerate(duties) if duty > 0.0)
    assert commands[first][0] == 61.0
    duty = keeper.rows[:, COLUMN_PLACE["left_duty"]]
    assert duty[59] == 0.0
    assert duty[60] == pytest.approx(duties[first] / 100.0)


WRONG: dict[str, Callable[[int, bytes], can.Message]] = {
    "checksum": lambda n, data: message(COMMAND, data[:7] + bytes([data[7] ^ 1])),
    "wrong_length": lambda n, data: message(COMMAND, data[:7]),
    "remote": lambda n, data: message(COMMAND, is_remote_frame=True, dlc=8),
    "error": lambda n, data: can.Message(is_error_frame=True, arbitration_id=0x80, data=bytes(8)),
    "foreign": lambda n, data: message(0x121, data),
}


@pytest.mark.parametrize("cause", WRONG)
def test_an_invalid_command_is_counted_and_has_no_effect(rig: Rig, cause: str) -> None:
    sound = [command_payload(rig, n, **both(60.0, OPEN, release=1)) for n in range(30)]

    def says(turn: int) -> list[can.Message]:
        good = message(COMMAND, sound[turn])
        # The counter of the bad one is that of the next: the good one still follows the last good one.
        return [good, WRONG[cause](turn, command_payload(rig, turn + 1, **both(0.0, OPEN)))]

    scenario = Scenario(NO_STIMULI, (), 0.3, settings=tuple(settings_of(NOISE)))
    clean, bare = run_kept(scenario, ScriptedEcu(lambda turn: [message(COMMAND, sound[turn % 30])]))
    result, keeper = run_kept(scenario, ScriptedEcu(lambda turn: says(turn % 30)))
    assert clean.summary.received == NO_COUNTS._replace(accepted=30)
    assert result.summary.received == NO_COUNTS._replace(accepted=30, **{cause: 30})
    motion = COLUMN_PLACE["gate_angle_deg"]
    assert keeper.rows[:, motion].tobytes() == bare.rows[:, motion].tobytes()
    assert keeper.rows[-1, motion] > 0.0


def test_a_command_whose_counter_stands_still_is_refused_and_times_out(rig: Rig) -> None:
    frozen = message(COMMAND, command_payload(rig, 3, **both(60.0, OPEN, release=1)))
    result, keeper = run_kept(Scenario(NO_STIMULI, (), 0.2), ScriptedEcu(lambda turn: [frozen]))
    received = result.summary.received
    # The first is taken, and once it is stale the next one is the first again.
    assert received == NO_COUNTS._replace(accepted=5, counter=15)
    assert result.summary.command_timeouts == 5
    assert keeper.rows[:, COLUMN_PLACE["left_coast"]].max() == 1.0


def test_many_frames_in_one_tick_all_arrive_in_order(log: tuple[Path, ...]) -> None:
    most = wire.CAPACITY
    ecu = ScriptedEcu(
        lambda turn: [message(0x100 + n % 16, bytes([turn, n // 256, n % 256])) for n in range(most)],
        period_s=0.001,
    )
    result, keeper = run_kept(Scenario(NO_STIMULI, (), 0.05), ecu, records=log)
    assert result.summary.received == NO_COUNTS._replace(foreign=50 * most)
    # What it said last came after the last tick.
    assert [(time, data) for time, _, data in keeper.wires(is_sent=False)] == [
        (turn + 1.0, bytes([turn, n // 256, n % 256])) for turn in range(50) for n in range(most)
    ]
    assert len(keeper.blocks) > 3
    assert len(log[0].read_text().splitlines()) == len(keeper.frames)
    bits = sum(bits_of(int(row["identifier"]), int(row["length"])) for row in keeper.frames)
    percent = 100.0 * bits / (500_000 * result.summary.model_time_s)
    assert result.summary.bus_load_percent == pytest.approx(percent)


def test_frames_of_every_kind_from_the_ecu_are_received_and_recorded(rig: Rig, log: tuple[Path, ...]) -> None:
    kinds = [
        message(0x7FF, b"\xff"),
        message(0x000),
        can.Message(arbitration_id=0x1ABCDEF0, is_extended_id=True, data=bytes(range(8))),
        message(0x333, is_remote_frame=True, dlc=4),
        message(0x400, bytes(range(64)), is_fd=True),
    ]
    ecu = ScriptedEcu(lambda turn: kinds if turn == 0 else [])
    _, keeper = run_kept(Scenario(NO_STIMULI, (), 0.02), ecu, records=log)
    assert [(number, data) for _, number, data in keeper.wires(is_sent=False)] == [
        (0x7FF, b"\xff"),
        (0x000, b""),
        (0x1ABCDEF0 | EXTENDED, bytes(range(8))),
        (0x333 | REMOTE, bytes(4)),
        (0x400 | FD, bytes(range(64))),
    ]
    assert not any(number & ERROR for _, number, _ in keeper.wires(is_sent=True))
    heard = [each for _, frames in ecu.heard for each in frames]
    assert {each.arbitration_id for each in heard} == {*OF_DRIVES, GATE, SWITCHES}
    assert not any(each.is_fd or each.is_remote_frame or each.is_extended_id for each in heard)


# A plant that diverges.


@pytest.mark.parametrize(
    ("quantity", "value"),
    [
        ("supply_voltage_v", np.inf),
        ("external_torque_nm", -np.inf),
        ("road_slope_deg", np.inf),
        ("hand_force_n", 1e308),
    ],
)
@pytest.mark.parametrize("clock", ["free", "lockstep"])
def test_a_plant_that_diverges_is_an_error_of_the_run_and_no_crash(
    quantity: str, value: float, clock: str
) -> None:
    profile = Profile([(0.0, 0.0), (0.3, value)], is_linear=False)
    scenario = Scenario(TimedStimuli({quantity: profile}), (Request(Instant(0.0), "open"),), 5.0)
    result = lh.run(scenario, clock=clock, trace=True)
    assert result.verdict == "error"
    assert result.reason.startswith("the plant diverged at 0.30")
    assert "allowed" in result.reason
    # The rows until then are there, and so is the one that shows it.
    assert 301 <= len(result.trace["time_s"]) <= 304
    assert np.isfinite(result.trace["gate_angle_deg"][:300]).all()
    assert lh.run(reversing()).verdict == "pass"


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_impossible_vehicle_diverges_in_its_first_tick(value: float) -> None:
    vehicle = vehicle_from("suv")
    vehicle = vehicle._replace(gate=vehicle.gate._replace(mass=value))
    result = lh.run("demo", vehicle=vehicle, initial=40.0, trace=True)
    assert result.verdict == "error"
    assert result.reason.startswith("the plant diverged at 0.001 s")
    assert len(result.trace["time_s"]) == 1


def test_a_diverged_drive_is_noticed_even_if_the_gate_stands_still(rig: Rig) -> None:
    config = loop_config(rig=rig)
    state = start_of(config)
    right = state.plant.right._replace(current=np.nan)
    keeper = Keeper()
    with ReferenceEcu(rig, 2) as adapter:
        broken = state._replace(plant=state.plant._replace(right=right))
        episode = Episode(LoopStart(config, broken, stimulus_plan(config)), adapter, sinks=[keeper])
        with pytest.raises(PlantDivergedError, match=r"0\.001 s"):
            episode.run(100)
        episode.close()
    assert len(keeper.rows) == 1


# What is seen of it.


def test_extremes_agree_with_the_trace_for_any_blocks_of_rows() -> None:
    random = np.random.default_rng(1)
    rows = random.normal(size=(1000, ROW_WIDTH))
    rows[:, COLUMN_PLACE["time_s"]] = 0.001 * (1.0 + np.arange(1000))
    force = rows[:, COLUMN_PLACE["pinch_force_n"]]
    for size in (1, 7, 333, 1000):
        extremes, trace = Extremes(), Trace(10)
        for start in range(0, 1000, size):
            for sink in (extremes, trace):
                sink.take(rows[start : start + size], ())
                sink.take(rows[:0], ())
        assert extremes.high is not None
        assert extremes.low is not None
        assert extremes.high.tolist() == rows.max(axis=0).tolist()
        assert extremes.low.tolist() == rows.min(axis=0).tolist()
        assert extremes.pinch_time == 0.001 * (1.0 + force.argmax())
        assert trace.rows().tolist() == rows[::10].tolist()
        assert trace.columns()["time_s"].tolist() == rows[::10, COLUMN_PLACE["time_s"]].tolist()


def test_without_rows_there_are_no_extremes_and_without_contact_no_pinch_time() -> None:
    assert Extremes().high is None
    extremes = Extremes()
    extremes.take(np.zeros((3, ROW_WIDTH)), ())
    assert np.isnan([Extremes().pinch_time, extremes.pinch_time]).all()
    assert Trace().rows().shape == (0, ROW_WIDTH)
    assert len(Trace().columns()["time_s"]) == 0


def test_the_pinch_time_is_that_of_the_largest_force() -> None:
    result = lh.run(reversing(), trace=True)
    peak = int(np.argmax(result.trace["pinch_force_n"]))
    assert result.pinch_time_s == result.trace["time_s"][peak] > 0.5
    assert result.maxima["pinch_force_n"] == result.trace["pinch_force_n"][peak]


def test_a_summary_before_the_first_tick_is_all_zero() -> None:
    rig = shipped_rig()
    with PythonEcu(ScriptedEcu(lambda turn: []), rig, 2) as adapter:
        episode = episode_of([], adapter)
        summary = episode.summary(rig.bitrate)
        episode.close()
    assert (summary.ticks, summary.bus_load_percent, summary.frames_sent) == (0, 0.0, 0)


def test_recorders_get_only_as_many_frames_as_were_counted(rig: Rig) -> None:
    """Replies are arrays with room for more than was sent; a sink gets just the frames."""
    seen: list[Any] = []

    class Writer:
        written = 0

        def begin(self, epoch_ns: int) -> None:
            assert epoch_ns == 0

        def write_rows(self, rows: np.ndarray) -> None:
            pass

        def write_frames(self, frames: Any) -> None:
            seen.append(frames)

        def flush(self) -> None:
            pass

        def close(self) -> None:
            pass

    keeper = Keeper()
    with ReferenceEcu(rig, 2) as adapter:
        recording = RecordingSink([Writer()], Content(()))
        episode = episode_of([recording, keeper], adapter)
        episode.run(100)
        recording.flush()
        episode.close()
    assert sum(map(len, seen)) == len(keeper.frames)
