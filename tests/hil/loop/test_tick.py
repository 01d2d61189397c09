"""The tick: from state, frames and external stimuli to state, frames, truth and sensed values."""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hil_support import (
    BENCH_STATUS,
    BRAKE,
    CLOSE,
    COAST,
    COMMAND,
    GATE,
    LEFT_DRIVE,
    OPEN,
    RIGHT_DRIVE,
    SENSORS,
    both,
    catch_up,
    command_frame,
    command_payload,
    decoded,
    frames_of,
    j1850,
    loop_config,
    outside,
    panel_frame,
    plain_tick,
    rig_of,
    rows_of,
    start_of,
    stimuli_alone,
)

from liftgate_compiler import compiled
from liftgate_hil.codec.frames import EXTENDED, Frames, empty_frames
from liftgate_hil.config.rig import Rig, load_rig
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.loop.tick import RUNNING, STOPPED, TIMEOUT, WAITING, LoopConfig, LoopState, copied, tick
from liftgate_hil.signals import Timing
from liftgate_hil.stimuli.moments import no_moments
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan
from liftgate_hil.stimuli.timeline import obstacle_at
from liftgate_plant.initial import initial_state
from liftgate_plant.signals import Sensed, Truth

NOTHING = empty_frames(0)
Tick = Callable[..., Any]


def equal(first: Any, second: Any) -> bool:
    """Whether two trees of tuples, arrays and numbers are the same to the last bit."""
    if isinstance(first, tuple):
        return len(first) == len(second) and all(map(equal, first, second))
    if isinstance(first, np.ndarray):
        return first.dtype == second.dtype and first.tobytes() == second.tobytes()
    return first == second or (first != first and second != second)


def cycles(rig: Rig) -> dict[int, int]:
    """Cycle times [ms] by identifier of the messages that the gate sends on any clock."""
    messages = {wire.message for wire in rig.outputs if wire.quantity not in Timing._fields}
    return {rig.messages[name].frame_id: rig.messages[name].cycle_time or 0 for name in messages}


def rest(config: LoopConfig) -> LoopState:
    """Return the state of a loop at rest, closed and latched."""
    return start_of(config)


def run(
    call: Tick,
    config: LoopConfig,
    state: LoopState,
    ticks: int,
    frames_at: Callable[[int], list[tuple[int, bytes]]] = lambda number: [],
    around: StimulusPlan | None = None,
) -> tuple[LoopState, list[Truth], list[Frames], list[Sensed]]:
    """Run this many ticks; `frames_at` returns the frames received before tick number n (from 0)."""
    truths, replies, sensed = [], [], []
    for number in range(ticks):
        rows = frames_at(number)
        state, sent, truth, seen = call(
            config, state, frames_of(rows) if rows else NOTHING, outside(around, state.tick * config.step)
        )
        truths.append(truth)
        replies.append(sent)
        sensed.append(seen)
    return state, truths, replies, sensed


def driving(rig: Rig, every: int = 10, **values: float) -> Callable[[int], list[tuple[int, bytes]]]:
    """Return `frames_at` (see `run`) of an ECU that sends the same command every `every` ticks."""
    values = values or both(80.0, OPEN, release=1)

    def frames_at(number: int) -> list[tuple[int, bytes]]:
        return [command_frame(rig, number // every, **values)] if number % every == 0 else []

    return frames_at


def open_at(rig: Rig, call: Tick, config: LoopConfig, angle_deg: float) -> LoopState:
    """State of a loop whose gate rests unlatched at this angle, with matching drives."""
    return start_of(config, math.radians(angle_deg), latched=False)


# Purity.


@pytest.mark.parametrize("which", ["plain", "compiled"])
def test_a_tick_writes_only_the_arrays_of_its_own_state(rig: Rig, fast_tick: Tick, which: str):
    call = tick if which == "plain" else compiled(tick)
    config = loop_config(rig=rig)
    state, _, _, _ = run(fast_tick, config, rest(config), 25, driving(rig))
    kept, kept_config = copy.deepcopy(state), copy.deepcopy(config)
    frames = frames_of([command_frame(rig, 9, **both(30.0, OPEN)), panel_frame(rig)])
    kept_frames = copy.deepcopy(frames)
    for way in ({}, {"silent": True, "missed": 3}, {"stop": True}):
        around = outside(**way)
        kept_around = copy.deepcopy(around)
        own = copied(state)
        after, _, _, _ = call(config, own, frames, around)
        assert equal(state, kept)  # a copy shares nothing
        assert equal(config, kept_config)
        assert equal(frames, kept_frames)
        assert equal(around, kept_around)
        assert after.reception.values is own.reception.values or equal(after.reception, own.reception)


@pytest.mark.parametrize("which", ["plain", "compiled"])
def test_a_tick_is_deterministic(rig: Rig, fast_tick: Tick, which: str):
    call = plain_tick if which == "plain" else fast_tick
    noisy = ["sensors.current_noise=0.5", "sensors.angle_noise_deg=0.1"]
    config = loop_config(rig=rig, settings=noisy, seed=7)
    first = run(call, config, rest(config), 60, driving(rig))
    second = run(call, config, rest(config), 60, driving(rig))
    assert equal(first[0], second[0])
    assert all(map(equal, first[1], second[1]))
    assert all(map(equal, first[2], second[2]))
    assert all(map(equal, first[3], second[3]))


def test_another_seed_gives_other_noise_but_the_same_plant(rig: Rig, fast_tick: Tick):
    noisy = ["sensors.current_noise=0.5"]
    ends = []
    for seed in (1, 2):
        config = loop_config(rig=rig, settings=noisy, seed=seed)
        state, _, replies, _ = run(fast_tick, config, rest(config), 60, driving(rig))
        ends.append((state.plant, [rows_of(frames) for frames in replies]))
    assert equal(ends[0][0], ends[1][0])
    assert ends[0][1] != ends[1][1]


def test_the_compiled_tick_agrees_with_the_plain_python_one(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig, settings=["sensors.current_noise=0.1"], seed=3)

    def frames_at(number: int) -> list[tuple[int, bytes]]:
        rows = driving(rig)(number)
        if number == 150:
            rows.append(panel_frame(rig, ObstacleAngle=1.0, ObstacleRate=5.0, HandForce=-50.0))
        if number % 37 == 0:
            rows += [(COMMAND, bytes(5)), (0x55, b"abc"), (COMMAND, bytes(8))]
        return [] if 200 <= number < 260 else rows  # a time-out on the way

    plain = run(plain_tick, config, rest(config), 400, frames_at)
    fast = run(fast_tick, config, rest(config), 400, frames_at)
    assert plain[0].counts == fast[0].counts
    assert (plain[0].timeouts, plain[0].tick) == (fast[0].timeouts, fast[0].tick)
    for mine, theirs in zip(plain[1] + plain[3], fast[1] + fast[3], strict=True):
        # The machine may fuse or reorder a sum, so a last digit may differ.
        assert np.allclose(np.array(mine), np.array(theirs), rtol=1e-9, atol=1e-9)
    for mine, theirs in zip(plain[2], fast[2], strict=True):
        assert [row[0] for row in rows_of(mine)] == [row[0] for row in rows_of(theirs)]


# Command time-out.


def test_motors_coast_exactly_from_the_command_timeout_on(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)

    def once(number: int) -> list[tuple[int, bytes]]:
        return [command_frame(rig, 1, **both(50.0, OPEN))] if number == 7 else []

    state, truths, _, _ = run(fast_tick, config, rest(config), 80, once)
    coasting = [truth.left_coast for truth in truths]
    # The command came at 7 ms; step number n covers n … n + 1 ms.
    assert coasting == [1] * 7 + [0] * 30 + [1] * 43
    assert [truth.right_coast for truth in truths] == coasting
    assert [truth.left_duty for truth in truths] == [0.0] * 7 + [0.5] * 30 + [0.0] * 43
    assert state.timeouts == 1


def test_commands_in_each_cycle_or_with_two_lost_do_not_time_out(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)

    def with_gaps(number: int) -> list[tuple[int, bytes]]:
        # Of every three frames the last two are lost.
        return driving(rig)(number) if number % 30 == 0 else []

    state, truths, _, _ = run(fast_tick, config, rest(config), 300, with_gaps)
    # At 30 ms sharp the next command is there already.
    assert state.timeouts == 0
    assert not any(truth.left_coast for truth in truths)


def test_the_next_valid_command_resumes_and_each_time_out_counts_once(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)

    def bursts(number: int) -> list[tuple[int, bytes]]:
        if number in (100, 300, 500):
            return [command_frame(rig, 5, **both(50.0, OPEN))]  # the same counter each time
        if number in (150, 151, 350):
            payload = bytearray(command_payload(rig, 6, **both(50.0, OPEN)))
            payload[7] ^= 0xFF
            return [(COMMAND, bytes(payload))]  # a bad one does not resume
        return []

    state, truths, replies, _ = run(fast_tick, config, rest(config), 600, bursts)
    running = [number for number, truth in enumerate(truths) if not truth.left_coast]
    assert running == [*range(100, 130), *range(300, 330), *range(500, 530)]
    assert state.timeouts == 3
    assert state.counts.checksum == 3
    status = [row for frames in replies for row in decoded(rig, frames, "BenchStatus")]
    # Sent at 100, 200, 300 … ms, before the command that comes at that time is known.
    assert [row["CommandTimeouts"] for row in status] == [0, 1, 1, 2, 2, 3]
    states = [WAITING, TIMEOUT, TIMEOUT, TIMEOUT, TIMEOUT, TIMEOUT]
    assert [row["EmulatorState"] for row in status] == states


def test_a_command_timeout_within_a_catch_up_takes_effect_at_its_own_step(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    start = rest(config)
    one = frames_of([command_frame(rig, 1, **both(80.0, OPEN, release=1))])
    at_once = catch_up(fast_tick, config, start, one, 50)[-1][0]
    singly, _, _, _ = run(
        fast_tick,
        config,
        start,
        50,
        lambda number: [command_frame(rig, 1, **both(80.0, OPEN, release=1))] if number == 0 else [],
    )
    assert equal(at_once.plant, singly.plant)
    assert (at_once.timeouts, at_once.tick) == (1, 50)


def test_a_silent_cyclic_benchcontrol_message_is_no_command_timeout(rig: Rig, fast_tick: Tick, tmp_path: Path):
    text = (Path(__file__).parents[3] / "configs/rigs/liftgate.toml").read_text()
    path = tmp_path / "panel.toml"
    path.write_text(text + "\n[messages.BenchControl]\ncycle_ms = 50\n")
    cyclic = load_rig(path)
    config = loop_config(rig=cyclic)

    def frames_at(number: int) -> list[tuple[int, bytes]]:
        rows = driving(rig, **both(0.0, BRAKE))(number)
        return [*rows, panel_frame(rig, HandForce=100.0)] if number == 0 else rows

    state, truths, _, _ = run(fast_tick, config, rest(config), 300, frames_at)
    assert truths[0].hand_force_n == pytest.approx(100.0)
    assert state.timeouts == 0


# Catch-up.


@pytest.mark.parametrize("steps", [2, 3, 7, 25])
def test_several_steps_at_once_equal_single_ticks_in_plant_and_rows(rig: Rig, fast_tick: Tick, steps: int):
    config = loop_config(rig=rig)
    state, _, _, _ = run(fast_tick, config, rest(config), 200, driving(rig))
    command = frames_of([command_frame(rig, 3, **both(60.0, OPEN))])
    ticked = catch_up(fast_tick, config, state, command, steps)
    at_once = ticked[-1][0]
    singly, truths, _, sensed = run(
        fast_tick,
        config,
        state,
        steps,
        lambda number: [command_frame(rig, 3, **both(60.0, OPEN))] if number == 0 else [],
    )
    assert equal(at_once.plant, singly.plant)
    assert equal(at_once.sensors, singly.sensors)
    assert equal(at_once.arming, singly.arming)
    assert at_once.counts == singly.counts
    assert at_once.tick == singly.tick == state.tick + steps
    # Each missed tick has its row.
    assert equal(tuple(each[2] for each in ticked), tuple(truths))
    assert equal(tuple(each[3] for each in ticked), tuple(sensed))
    assert [each[1].count for each in ticked[:-1]] == [0] * (steps - 1)


def test_a_catch_up_applies_the_timeline_tick_by_tick(rig: Rig, fast_tick: Tick, around: StimulusPlan):
    config = loop_config(rig=rig)
    ticked = catch_up(fast_tick, config, rest(config), NOTHING, 401, around=around)
    _, truths, _, _ = run(fast_tick, config, rest(config), 401, around=around)
    assert equal(tuple(each[2] for each in ticked), tuple(truths))
    assert len({truth.road_slope_deg for truth in truths}) == 401


def test_a_catch_up_sends_each_message_once_and_the_next_ones_on_time(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    ticked = catch_up(fast_tick, config, rest(config), NOTHING, 23)
    assert [each[1].count for each in ticked[:-1]] == [0] * 22
    state, sent, _, _ = ticked[-1]
    assert Counter(row[0] for row in rows_of(sent)) == {
        identifier: 1 for identifier, cycle in cycles(rig).items() if cycle <= 23
    }
    _, _, replies, _ = run(fast_tick, config, state, 8)
    at = [24 + number for number, frames in enumerate(replies) if frames.count]
    assert at == [25, 30]


def test_a_tick_that_makes_up_for_a_missed_one_sends_no_message(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    state, _, _, _ = run(fast_tick, config, rest(config), 99)
    _, sent, _, _ = fast_tick(config, state, NOTHING, outside(silent=True, missed=1))
    assert sent.count == 0
    _, sent, _, _ = fast_tick(config, state, NOTHING, outside(silent=True, missed=1, stop=True))
    assert sent.count == len(cycles(rig))  # in the last one


def test_skipped_periods_are_reported_on_the_bus_up_to_the_largest_value_of_the_signal(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    sent = catch_up(fast_tick, config, rest(config), NOTHING, 100)[-1][1]
    assert decoded(rig, sent, "BenchStatus")[0]["TickOverruns"] == 99
    many = rest(config)._replace(timeouts=10**6)
    _, sent, _, _ = fast_tick(config, many, NOTHING, outside(missed=10**9, stop=True))
    status = decoded(rig, sent, "BenchStatus")[0]
    assert (status["TickOverruns"], status["CommandTimeouts"]) == (65535, 255)


# The messages.


def sent_times(fast_tick: Tick, config: LoopConfig, ticks: int) -> tuple[Counter[int], dict[int, list[int]]]:
    """Return by identifier how many frames were sent, and in which ticks, counted from 1."""
    _, _, replies, _ = run(fast_tick, config, rest(config), ticks)
    times: dict[int, list[int]] = {}
    for number, frames in enumerate(replies):
        for identifier, _ in rows_of(frames):
            times.setdefault(identifier, []).append(number + 1)
    return Counter({identifier: len(each) for identifier, each in times.items()}), times


@pytest.mark.parametrize(("rate", "slack"), [(1000, 0), (10_000, 0), (300, 1), (250, 1), (1024, 1)])
def test_messages_are_sent_in_their_cycle_times(rig: Rig, fast_tick: Tick, rate: int, slack: int):
    counts, times = sent_times(fast_tick, loop_config(float(rate), rig), rate)
    known = {LEFT_DRIVE: 5, RIGHT_DRIVE: 5, GATE: 10, SENSORS: 100, BENCH_STATUS: 100}
    assert cycles(rig).items() >= known.items()
    for identifier, cycle_ms in cycles(rig).items():
        assert abs(counts[identifier] - 1000 // cycle_ms) <= slack, hex(identifier)
        ideal = cycle_ms * rate / 1000
        gaps = np.diff([0, *times[identifier]])
        assert gaps.min() >= math.floor(ideal)
        assert gaps.max() <= math.ceil(ideal) + slack
    assert set(counts) == set(cycles(rig))


def test_counters_and_checksums_of_sent_frames_are_correct(rig: Rig, fast_tick: Tick):
    _, _, replies, _ = run(fast_tick, loop_config(rig=rig), rest(loop_config(rig=rig)), 200)
    for name, identifier in (("LeftDrive", LEFT_DRIVE), ("RightDrive", RIGHT_DRIVE)):
        rows = [row for frames in replies for row in decoded(rig, frames, name)]
        assert [row["AliveCounter"] for row in rows] == [number % 16 for number in range(40)]
        for frames in replies:
            for sender, payload in rows_of(frames):
                if sender == identifier:
                    assert payload[7] == j1850(identifier, payload, 7)


def test_sent_signals_agree_with_the_plant(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    state, truths, replies, _ = run(fast_tick, config, rest(config), 2000, driving(rig))
    truth = truths[-1]
    assert truth.gate_angle_deg > 5.0
    left = decoded(rig, replies[-1], "LeftDrive")[0]
    right = decoded(rig, replies[-1], "RightDrive")[0]
    gate = decoded(rig, replies[-1], "Gate")[0]
    assert left["MotorCurrent"] == pytest.approx(truth.left_current_a, abs=0.0026)
    assert right["MotorCurrent"] == pytest.approx(truth.right_current_a, abs=0.0026)
    assert left["HallCount"] == truth.left_hall_count
    assert right["HallCount"] == truth.right_hall_count
    assert left["HallSpeed"] == pytest.approx(truths[-1].left_hall_count - truths[-6].left_hall_count, abs=0)
    assert gate["Angle"] == pytest.approx(truth.gate_angle_deg, abs=0.0051)
    assert gate["LatchState"] == 0
    assert gate["TerminalVoltage"] == pytest.approx(12.0)
    assert state.plant.gate_angle * 180.0 / math.pi == pytest.approx(truth.gate_angle_deg)


def test_the_gates_first_frames_report_closed_latched_and_waiting_for_a_command(rig: Rig, fast_tick: Tick):
    _, _, replies, _ = run(fast_tick, loop_config(rig=rig), rest(loop_config(rig=rig)), 100)
    gate = decoded(rig, replies[9], "Gate")[0]
    assert gate == {"Angle": 0.0, "LatchState": 1, "TerminalVoltage": 12.0}
    assert decoded(rig, replies[99], "BenchStatus")[0]["EmulatorState"] == WAITING
    sensors = decoded(rig, replies[99], "Sensors")[0]
    assert sensors["AmbientTemperature"] == 20
    assert sensors["RoadSlope"] == 0


def test_refused_frames_are_reported_on_the_bus(rig: Rig, fast_tick: Tick):
    bad = [(COMMAND, bytes(8)), (COMMAND, bytes(2)), (0x6E1, bytes(1)), (0x111, bytes(8))]
    _, _, replies, _ = run(
        fast_tick, loop_config(rig=rig), rest(loop_config(rig=rig)), 100, lambda n: bad if n == 3 else []
    )
    assert decoded(rig, replies[99], "BenchStatus")[0]["RejectedFrames"] == 3


# Stopping.


def test_a_stop_turns_the_motors_off_and_sends_every_message_once(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    state, _, replies, _ = run(fast_tick, config, rest(config), 501, driving(rig))
    running = [row for frames in replies for row in decoded(rig, frames, "BenchStatus")]
    assert running[-1]["EmulatorState"] == RUNNING
    last = frames_of([command_frame(rig, 51, **both(100.0, OPEN))])
    state, sent, truth, _ = fast_tick(config, state, last, outside(stop=True))
    assert Counter(row[0] for row in rows_of(sent)) == dict.fromkeys(cycles(rig), 1)
    assert (truth.left_coast, truth.right_coast) == (1, 1)
    assert (truth.left_duty, truth.right_duty) == (0.0, 0.0)
    assert decoded(rig, sent, "BenchStatus")[0]["EmulatorState"] == STOPPED


# Bridges, latch and panel.


def test_each_bridge_state_acts_as_its_name_says(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    start = open_at(rig, fast_tick, config, 45.0)
    ends = {}
    for direction in (COAST, OPEN, CLOSE, BRAKE):
        _state, truths, _, _ = run(fast_tick, config, start, 100, driving(rig, **both(70.0, direction)))
        ends[direction] = truths[-1]
        assert truths[-1].left_coast == (direction == COAST)
    assert ends[OPEN].left_speed_rps > 1.0
    assert ends[CLOSE].left_speed_rps < -1.0
    assert ends[OPEN].left_duty == pytest.approx(0.7)
    assert ends[CLOSE].left_duty == pytest.approx(-0.7)
    assert ends[BRAKE].left_duty == 0.0
    assert abs(ends[BRAKE].left_speed_rps) < 0.5


def test_left_and_right_motor_are_driven_separately(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    start = open_at(rig, fast_tick, config, 45.0)
    values = {"LeftDuty": 60.0, "LeftDirection": OPEN, "RightDuty": 30.0, "RightDirection": CLOSE}
    _, truths, _, _ = run(fast_tick, config, start, 15, driving(rig, **values))
    assert truths[-1].left_duty == pytest.approx(0.6)
    assert truths[-1].right_duty == pytest.approx(-0.3)


def test_the_latch_holds_until_released_and_catches_the_closed_gate(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    state, truths, _, _ = run(fast_tick, config, rest(config), 400, driving(rig, **both(40.0, OPEN)))
    assert truths[-1].latched == 1
    assert truths[-1].gate_angle_deg == 0.0
    state, truths, _, _ = run(fast_tick, config, state, 1500, driving(rig, **both(60.0, OPEN, 1)))
    assert truths[-1].latched == 0
    assert truths[-1].gate_angle_deg > 3.0
    state, truths, _, _ = run(fast_tick, config, state, 4000, driving(rig, **both(60.0, CLOSE)))
    assert truths[-1].latched == 1
    assert truths[-1].gate_angle_deg == pytest.approx(0.0, abs=0.2)


def test_a_released_latch_does_not_catch_the_gate(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    _, truths, _, _ = run(fast_tick, config, rest(config), 300, driving(rig, **both(0.0, BRAKE, 1)))
    assert not any(truth.latched for truth in truths)


SCENARIO = """
[[profile]]
quantity = "supply_voltage_v"
interpolation = "hold"
points = [[0.1, 10.0], [0.2, 14.0]]
[[profile]]
quantity = "road_slope_deg"
points = [[0.0, 0.0], [0.4, 8.0]]
[[obstacle]]
start = 0.05
angle_deg = 40
stiffness = 5000
"""


@pytest.fixture
def around(tmp_path: Path) -> StimulusPlan:
    path = tmp_path / "scenario.toml"
    path.write_text(SCENARIO)
    return stimuli_alone(load_scenario(path).stimuli)


def test_profiles_change_the_surroundings_over_time(rig: Rig, fast_tick: Tick, around: StimulusPlan):
    config = loop_config(rig=rig)
    _, truths, _, _ = run(fast_tick, config, rest(config), 401, around=around)
    volts = [truth.supply_voltage_v for truth in truths]
    # Step n begins at n ms and is recorded at its end.
    assert volts == [12.0] * 100 + [10.0] * 100 + [14.0] * 201
    slopes = [truth.road_slope_deg for truth in truths]
    # What moves on a straight line is recorded with its mean over the step.
    assert slopes == pytest.approx([*(8.0 * (n + 0.5) / 400 for n in range(400)), 8.0])


def test_benchcontrol_replaces_the_scenario_from_its_first_frame_on(
    rig: Rig, fast_tick: Tick, around: StimulusPlan
):
    config = loop_config(rig=rig)

    def frames_at(number: int) -> list[tuple[int, bytes]]:
        values = {"SupplyVoltage": 9.0, "RoadSlope": -10.0, "HandForce": 25.0}
        return [panel_frame(rig, **values)] if number == 150 else []

    _, truths, _, _ = run(fast_tick, config, rest(config), 300, frames_at, around)
    assert truths[149].supply_voltage_v == 10.0
    for truth in truths[150:]:
        assert truth.supply_voltage_v == pytest.approx(9.0)
        assert truth.road_slope_deg == pytest.approx(-10.0)
        assert truth.hand_force_n == pytest.approx(25.0)


def test_a_benchcontrol_obstacle_rate_of_zero_removes_the_scenarios_obstacle(
    rig: Rig, fast_tick: Tick, around: StimulusPlan
):
    config = loop_config(rig=rig)
    start = open_at(rig, fast_tick, config, 41.0)
    close = driving(rig, **both(80.0, CLOSE))
    _, met, _, _ = run(fast_tick, config, start, 500, close, around)
    assert max(truth.pinch_force_n for truth in met) > 20.0

    def removed(number: int) -> list[tuple[int, bytes]]:
        return [panel_frame(rig, ObstacleRate=0.0), *close(number)] if number == 0 else close(number)

    _, free, _, _ = run(fast_tick, config, start, 500, removed, around)
    assert max(truth.pinch_force_n for truth in free) == 0.0
    assert free[-1].gate_angle_deg < met[-1].gate_angle_deg


# Obstacles.


def closing_onto(
    rig: Rig, fast_tick: Tick, panels: dict[int, dict[str, float]], angle_deg: float, ticks: int
) -> list[Truth]:
    """Run a closing from this angle, with BenchControl values by tick number; return the truth of each tick."""
    config = loop_config(rig=rig)
    start = open_at(rig, fast_tick, config, angle_deg)
    close = driving(rig, **both(80.0, CLOSE))

    def frames_at(number: int) -> list[tuple[int, bytes]]:
        rows = close(number)
        return [*rows, panel_frame(rig, **panels[number])] if number in panels else rows

    return run(fast_tick, config, start, ticks, frames_at)[1]


def test_an_obstacle_in_the_path_of_the_gate_is_hit_at_its_angle(rig: Rig, fast_tick: Tick):
    truths = closing_onto(rig, fast_tick, {0: {"ObstacleAngle": 44.0, "ObstacleRate": 10.0}}, 45.0, 800)
    for truth in truths:
        assert (truth.pinch_force_n > 0.0) <= (truth.gate_angle_deg < 44.0)
    last = truths[-1]
    assert last.pinch_force_n > 50.0
    # 10 N/mm at the gate's edge, 1 m from the hinge.
    assert last.pinch_force_n == pytest.approx(10_000.0 * math.radians(44.0 - last.gate_angle_deg), rel=0.01)


def test_an_obstacle_that_appears_behind_the_gate_is_not_hit(rig: Rig, fast_tick: Tick):
    truths = closing_onto(rig, fast_tick, {100: {"ObstacleAngle": 60.0, "ObstacleRate": 10.0}}, 45.0, 800)
    assert max(truth.pinch_force_n for truth in truths) == 0.0


def test_an_obstacle_behind_the_gate_is_hit_once_the_gate_has_been_clear_of_it(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    start = open_at(rig, fast_tick, config, 45.0)

    def frames_at(number: int) -> list[tuple[int, bytes]]:
        direction = OPEN if number < 1000 else CLOSE
        rows = driving(rig, **both(80.0, direction))(number)
        if number == 50:
            rows.append(panel_frame(rig, ObstacleAngle=46.0, ObstacleRate=10.0))
        return rows

    _, truths, _, _ = run(fast_tick, config, start, 3000, frames_at)
    assert max(truth.gate_angle_deg for truth in truths) > 47.0
    assert max(truth.pinch_force_n for truth in truths[:1000]) == 0.0
    assert truths[-1].pinch_force_n > 50.0


@pytest.mark.parametrize("angle_deg", [50.0, 70.0])
def test_an_obstacle_moved_behind_the_gate_is_not_hit(rig: Rig, fast_tick: Tick, angle_deg: float):
    panels = {
        0: {"ObstacleAngle": 20.0, "ObstacleRate": 10.0},
        100: {"ObstacleAngle": angle_deg, "ObstacleRate": 10.0},
    }
    truths = closing_onto(rig, fast_tick, panels, 45.0, 300)
    assert max(truth.pinch_force_n for truth in truths) == 0.0


def test_an_obstacle_that_replaces_another_behind_the_gate_is_not_hit(rig: Rig, fast_tick: Tick, tmp_path: Path):
    path = tmp_path / "scenario.toml"
    path.write_text("[[obstacle]]\nend = 0.1\nangle_deg = 20\n[[obstacle]]\nstart = 0.1\nangle_deg = 60\n")
    config = loop_config(rig=rig)
    start = open_at(rig, fast_tick, config, 45.0)
    around = stimuli_alone(load_scenario(path).stimuli)
    close = driving(rig, **both(80.0, CLOSE))
    _, truths, _, _ = run(fast_tick, config, start, 300, close, around)
    assert max(truth.pinch_force_n for truth in truths) == 0.0


def test_a_rod_placed_while_the_gate_is_closed_pinches_only_on_the_way_back(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)

    def frames_at(number: int) -> list[tuple[int, bytes]]:
        direction = OPEN if number < 2500 else CLOSE
        rows = driving(rig, **both(90.0, direction, release=1))(number)
        if number == 0:
            rows.append(panel_frame(rig, ObstacleAngle=5.0, ObstacleRate=10.0))
        return rows

    _, truths, _, _ = run(fast_tick, config, rest(config), 6000, frames_at)
    assert max(truth.gate_angle_deg for truth in truths) > 10.0
    assert max(truth.pinch_force_n for truth in truths[:2500]) == 0.0
    assert truths[-1].pinch_force_n > 50.0


# Extremes.


def test_a_tick_with_a_diverged_plant_still_sends_its_frames(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    state = rest(config)
    broken = state.plant._replace(gate_angle=math.nan, left=state.plant.left._replace(current=math.inf))
    _, sent, _, _ = fast_tick(config, state._replace(plant=broken), NOTHING, outside(stop=True))
    assert sent.count == len(cycles(rig))
    assert decoded(rig, sent, "BenchStatus")[0]["EmulatorState"] == STOPPED


DATABASE = """VERSION ""
BS_:
BU_: A
BO_ 2566844672 Cmd: 8 A
 SG_ Duty : 7|16@0- (0.001,0) [-1|1] "" A
BO_ 256 Out: 8 A
 SG_ I : 0|16@1- (0.01,0) [0|0] "A" A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 2566844672 20;
BA_ "GenMsgCycleTime" BO_ 256 20;
"""


@pytest.mark.parametrize(("duty", "expected"), [(0.4, (0.4, 0)), (-0.4, (-0.4, 0)), (0.0, (0.0, 0))])
def test_in_a_rig_without_a_direction_signal_the_duty_is_signed_and_zero_brakes(
    fast_tick: Tick, tmp_path: Path, duty: float, expected: tuple[float, int]
):
    text = """
dbc = "their.dbc"
[inputs]
left_duty = { signal = "Cmd.Duty", scale = 100 }
right_duty = { signal = "Cmd.Duty", scale = 100 }
[outputs]
left_current = "Out.I"
"""
    signed = rig_of(tmp_path, DATABASE, text)
    config = loop_config(rig=signed)
    payload = signed.messages["Cmd"].encode({"Duty": duty})
    frames = frames_of([(2566844672 & 0x1FFFFFFF | EXTENDED, payload)])
    state = start_of(config, math.radians(45.0), latched=False)
    state, _, truth, _ = fast_tick(config, state, frames, outside())
    assert state.counts.accepted == 1
    assert (truth.left_duty, truth.left_coast) == pytest.approx(expected)
    assert (truth.right_duty, truth.right_coast) == pytest.approx(expected)


def test_of_the_obstacles_of_a_scenario_the_first_present_one_is_used(tmp_path: Path):
    path = tmp_path / "scenario.toml"
    path.write_text(
        "[[obstacle]]\nstart = 1.0\nend = 2.0\nangle_deg = 10\nmeets = 'opening'\ngap = 0.1\n"
        "lateral = 0.3\n"
        "[[obstacle]]\nangle_deg = 20\nstiffness = 5\ndamping = 6\ndistance = 0.5\n"
    )
    timeline, moments = stimuli_alone(load_scenario(path).stimuli).timeline, no_moments()
    before, during, after = (obstacle_at(timeline, moments, time) for time in (0.9, 1.0, 2.0))
    assert before == after == (math.radians(20.0), 0.5, 5.0, 6.0, 0.0, 1.0, 0.0)
    assert during == (math.radians(10.0), 1.0, 10_000.0, 0.0, 0.1, -1.0, 0.3)


def test_an_initial_state_is_at_rest_and_stays_there_without_a_command(rig: Rig, fast_tick: Tick):
    config = loop_config(rig=rig)
    start = initial_state(config.plant, 0.0, latched=True)
    state, _, _, _ = run(fast_tick, config, rest(config), 500)
    assert state.plant.gate_angle == start.gate_angle == 0.0
    assert state.plant.latched == 1.0
    assert (state.plant.left.speed, state.plant.right.speed) == (0.0, 0.0)
