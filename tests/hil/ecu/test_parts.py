"""Speed control, anti-trap protection and state machine of the reference ECU, each alone."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from liftgate_compiler import compiled
from liftgate_hil.ecu import memory
from liftgate_hil.ecu.anti_trap import begin_run, bin_at, learn, reference_at, watch
from liftgate_hil.ecu.calibration import FINE, FINE_FROM, FINE_TO, PLACES, Calibration
from liftgate_hil.ecu.controller import DriveCommand, Feedback, speed_over, take_feedback, update
from liftgate_hil.ecu.events import TrapDecision, events_since
from liftgate_hil.ecu.memory import EcuMemory, constants_of, new_memory
from liftgate_hil.ecu.speed_control import controlled_duty, measure_load, measure_speed

CYCLE = 0.01  # s
C = Calibration()
TRAVEL, HALFWAY = 2000.0, 1000.0  # counts
K = constants_of(C, CYCLE)


def new_guard() -> Any:
    return new_memory(1).guards[0]


def new_drive() -> Any:
    return new_memory(1).drives[0]


def feed(
    guard: Any, load: float, cycles: int, position: float = HALFWAY, step: float = 0.0
) -> TrapDecision | None:
    """Feed a guard a load from a position on, `step` counts a cycle; return its verdict if trapped, or None."""
    for cycle in range(cycles):
        place = position + cycle * step
        verdict = watch(K, guard, load, place, TRAVEL, hidden=0.0, in_seal=place < C.seal_zone)
        if verdict.is_trapped:
            return verdict
    return None


def learned(loads: dict[float, float]) -> Any:
    """Return a guard that has learned these loads at these positions [counts]."""
    guard = new_guard()
    begin_run(guard)
    pass_blank_time(guard)
    for position, load in loads.items():
        guard.offset = load
        watch(K, guard, load, position, TRAVEL, hidden=0.0, in_seal=False)
    learn(guard)
    begin_run(guard)
    return guard


def pass_blank_time(guard: Any) -> None:
    guard.time = C.blank_time


def duty_of(drive: Any, wanted: float, speed: float, voltage: float) -> float:
    """Return the controlled duty of a drive at a wanted and an actual speed [counts/s] and a voltage [V]."""
    drive.speed = speed
    return controlled_duty(K, drive, wanted, voltage)


# Speed.


def test_speed_is_the_change_of_counts_over_time() -> None:
    drive = new_drive()
    for count in range(0, 60, 5):
        measure_speed(K, drive, count, np.nan, CYCLE)
    assert drive.speed == pytest.approx(5.0 / CYCLE)


@pytest.mark.parametrize("cycle_ms", [1, 5, 10, 20, 50])
def test_speed_is_averaged_over_the_same_window_at_any_cycle(cycle_ms: int) -> None:
    """Counts older than the window are forgotten, as far as a cycle can resolve it."""
    cycle = 1e-3 * cycle_ms
    constants, drive = constants_of(C, cycle), new_drive()
    for n in range(round(1.0 / cycle)):
        measure_speed(constants, drive, 300.0 * cycle * n, np.nan, cycle)
    assert drive.speed == pytest.approx(300.0)
    last = drive.count
    for n in range(1, max(1, round(C.speed_window / cycle)) + 1):
        measure_speed(constants, drive, last - 200.0 * cycle * n, np.nan, cycle)
    assert drive.speed == pytest.approx(-200.0)


def test_a_speed_on_the_bus_is_used_directly() -> None:
    drive = new_drive()
    measure_speed(K, drive, 0.0, 75.0, CYCLE)
    assert drive.speed == pytest.approx(75.0 * C.counts_per_turn)


@pytest.mark.parametrize("counts", [1, 2, 6, 16])
@pytest.mark.parametrize("start", [0, 1500])
def test_counts_per_turn_are_learned_from_speed_and_counts(counts: int, start: int) -> None:
    """Only while both are received."""
    drive = new_drive()
    for cycle in range(100):
        turning = math.nan if cycle == 50 else -80.0
        jump = 700 if cycle >= 50 else 0
        count = start + jump - math.floor(80.0 * CYCLE * cycle * counts)
        measure_speed(K, drive, count, turning, CYCLE)
    assert drive.speed == pytest.approx(-80.0 * counts)


def test_late_or_doubled_samples_change_neither_load_nor_speed() -> None:
    """A sample counts at the time of its measurement: two in one cycle are no double acceleration."""
    slope, current = 90.0, 2.0 + C.inertia * 90.0
    both = {}
    for come in ([1] * 60, [1] * 20 + [0, 2, 0, 0, 3] + [1] * 3 + [2] + [1] * 30):
        (drive,) = new_memory(1).drives
        samples, loads, speeds = 0, [], []
        for new in come:
            samples += new
            turning = slope * CYCLE * samples
            count = 4.0 * 0.5 * slope * (CYCLE * samples) ** 2
            take_feedback(K, drive, CYCLE * samples, count, turning, current)
            loads.append(drive.load)
            take_feedback(K, drive, CYCLE * samples, count, turning, current)  # once more: nothing new
            speeds.append(drive.speed)
        both[len(come)] = loads[-1], speeds[-1], drive.counted / drive.turned
        assert max(loads[20:]) - min(loads[20:]) < 0.01
    assert both[60] == pytest.approx(both[59], rel=5e-3)


def test_counts_alone_give_the_speed_despite_missing_samples() -> None:
    drive = new_drive()
    for samples in [*range(20), 21, 24, 25, 27, 28]:
        measure_speed(K, drive, 3.0 * samples, np.nan, CYCLE * (samples - drive.count / 3.0 or 1))
    assert drive.speed == pytest.approx(3.0 / CYCLE)


def loads_while_accelerating(is_sharp: bool) -> list[float]:
    """Return the loads [A] of a drive that its current only accelerates; `is_sharp`: with its speed on the bus."""
    drive, speed, loads = new_drive(), 0.0, []
    for cycle in range(100):
        slope = 2.5 * cycle  # rev/s²
        speed += slope * CYCLE
        drive.turning = speed if is_sharp else np.nan
        measure_load(K, drive, C.inertia * slope, CYCLE)
        loads.append(drive.load)
    return loads


def test_current_that_accelerates_the_drive_does_not_count_as_load() -> None:
    assert max(map(abs, loads_while_accelerating(is_sharp=True))) < 1e-9
    assert loads_while_accelerating(is_sharp=False)[-1] == pytest.approx(C.inertia * 247.5, rel=0.02)


def test_a_saturated_speed_controller_does_not_wind_up() -> None:
    drive = new_drive()
    for _ in range(1000):
        assert duty_of(drive, 600.0, 0.0, 12.0) <= 1.0
    # Once the load is gone and the speed is there, the duty comes down within a few cycles.
    duties = [duty_of(drive, 600.0, 660.0, 12.0) for _ in range(30)]
    assert duties[-1] < 1.0


def test_a_low_supply_voltage_is_compensated_by_more_duty() -> None:
    low, high = duty_of(new_drive(), 200.0, 200.0, 9.0), duty_of(new_drive(), 200.0, 200.0, 15.0)
    assert low > high


# Anti-trap.


def test_a_constant_current_does_not_count_as_an_obstacle_however_high() -> None:
    assert feed(new_guard(), 4.0, 500) is None


def test_a_load_above_that_of_the_run_so_far_is_an_obstacle() -> None:
    guard = new_guard()
    begin_run(guard)
    feed(guard, 1.5, 100)
    assert feed(guard, 1.5 + 0.95 * C.excess_unlearned, 1) is None
    verdict = feed(guard, 1.5 + 1.3 * C.excess_unlearned, 5)
    assert verdict is not None
    assert verdict.load > verdict.expected + verdict.limit
    assert verdict.limit == C.excess_unlearned


def test_the_load_at_the_start_of_a_motion_is_not_judged() -> None:
    guard = new_guard()
    begin_run(guard)
    assert feed(guard, 0.0, int(0.5 * C.blank_time / CYCLE)) is None
    assert feed(guard, 9.0, int(0.4 * C.blank_time / CYCLE)) is None


def test_a_slow_rise_of_the_load_over_the_travel_is_followed() -> None:
    guard = new_guard()
    begin_run(guard)
    for step in range(600):
        assert feed(guard, 1.0 + 0.002 * step, 1) is None


def test_a_learned_load_reference_has_a_narrower_limit() -> None:
    between = 1.5 + 0.99 * C.excess_unlearned
    known, fresh = learned({HALFWAY: 1.5}), new_guard()
    for guard in known, fresh:
        begin_run(guard)
        feed(guard, 1.5, 100)
    assert feed(known, between, 6) is not None
    assert feed(fresh, between, 6) is None


def test_a_steep_learned_load_reference_has_a_wider_limit() -> None:
    """It is wider by the load that the possible error of the position makes."""
    fine = (FINE_TO - FINE_FROM) / FINE
    centres = {FINE_FROM + (k + 0.5) * fine: 0.0 for k in range(FINE)}
    flat = learned(centres)
    steep = learned({place: 0.05 * place for place in centres})  # A, 0.05 a count
    place = FINE_FROM + 20.0 * fine
    for guard, level in ((flat, 0.0), (steep, 0.05 * place)):
        pass_blank_time(guard)
        assert feed(guard, level, 3, place) is None
    beyond = 1.2 * C.excess_learned
    assert feed(flat, beyond, 3, place) is not None
    assert feed(steep, 0.05 * place + beyond, 3, place) is None
    steep.offset = 0.0
    tolerated = beyond + 0.05 * C.excess_per_slope + C.excess_share * 0.06 * place
    assert feed(steep, 0.05 * place + tolerated, 3, place) is not None


def test_the_load_reference_is_extrapolated_beyond_its_last_known_position() -> None:
    """A gate one count beyond the farthest position so far does not count as trapped."""
    fine = (FINE_TO - FINE_FROM) / FINE
    guard = learned({FINE_FROM + (k + 0.5) * fine: -0.1 * k for k in range(5, 20)})
    beyond = FINE_FROM + 4.5 * fine
    known, steep = reference_at(guard, bin_at(beyond, TRAVEL))
    assert known == pytest.approx(-0.4)
    assert steep == pytest.approx(0.1)
    assert np.isnan(reference_at(guard, bin_at(FINE_FROM + 0.5 * fine, TRAVEL))[0])


def test_the_load_limit_is_wider_while_the_wanted_speed_changes() -> None:
    """It is wider by the load that the possible error of the inertia makes."""
    for hidden, is_trapped in ((0.0, True), (1.0, False)):
        guard = learned({HALFWAY: 1.0})
        pass_blank_time(guard)
        watch(K, guard, 1.0, HALFWAY, TRAVEL, hidden, in_seal=False)
        load = 1.0 + C.excess_learned + 0.5
        for _ in range(K.samples):
            verdict = watch(K, guard, load, HALFWAY, TRAVEL, hidden, in_seal=False)
        assert verdict.is_trapped == is_trapped


def test_the_load_of_the_seal_is_judged_only_after_it_was_learned() -> None:
    guard = new_guard()
    begin_run(guard)
    feed(guard, 1.0, 100)
    assert feed(guard, 9.0, 20, position=0.5 * C.seal_zone) is None
    learn(guard)
    begin_run(guard)
    feed(guard, 1.0, 100)
    assert feed(guard, 9.0, 1, position=0.5 * C.seal_zone) is None
    assert feed(guard, 9.0 + 2.0 * C.excess_learned + 9.0 * C.excess_share, 5, 0.5 * C.seal_zone) is not None


def test_a_learned_load_reference_is_updated_slowly_by_later_runs() -> None:
    guard = new_guard()
    for load in (1.0, 2.0):
        begin_run(guard)
        feed(guard, load, 200)
        learn(guard)
    known = guard.reference[~np.isnan(guard.reference)]
    assert len(known) == 1  # the bin in the middle
    assert 1.1 < known[0] < 1.5


# The state machine.


def feedback(count: float, latched: bool = False, current: float = 1.0) -> Feedback:
    """Return feedback of a gate with the left drive alone, at a position `count`, with 12 V."""
    nan = np.nan
    return Feedback(current, nan, count, nan, nan, nan, latched, latched, 12.0, nan, nan, nan)


class Controller:
    """A state machine with one drive alone, whose gate is at `count` when it starts."""

    def __init__(self, count: float = 1500.0, latched: bool = False) -> None:
        self.memory: EcuMemory = new_memory(1)
        self.update(0.0, feedback(count, latched))

    def request(self, action: int) -> None:
        self.memory.control[0].request = action

    def update(self, now: float, heard: Feedback) -> DriveCommand:
        return update(K, self.memory, now, heard._replace(left_time=now))

    @property
    def state(self) -> int:
        return int(self.memory.control[0].state)

    @property
    def texts(self) -> list[str]:
        return [event.text for event in events_since(self.memory, 0)]


def test_no_motor_is_driven_before_a_request() -> None:
    controller = Controller(0.0, latched=True)
    command = controller.update(1.0, feedback(0.0, latched=True))
    assert controller.state == memory.CLOSED
    assert np.isnan(command.left_duty)
    assert np.isnan(command.right_duty)
    assert not command.latch_release


def test_the_latch_is_released_only_while_it_is_engaged() -> None:
    controller = Controller(0.0, latched=True)
    controller.request(memory.REQUEST_OPEN)
    # A request is obeyed from the next cycle on.
    assert not controller.update(0.01, feedback(0.0, latched=True)).latch_release
    assert controller.update(0.02, feedback(0.0, latched=True)).latch_release
    assert not controller.update(0.03, feedback(1.0)).latch_release


def test_a_stop_of_the_driver_brakes_in_the_same_cycle() -> None:
    controller = Controller()
    controller.request(memory.REQUEST_CLOSE)
    controller.update(0.01, feedback(1500.0))
    assert controller.update(0.02, feedback(1500.0)).left_duty < 0.0
    controller.request(memory.STOP)
    assert controller.update(0.03, feedback(1500.0)).left_duty == 0.0


def test_a_gate_found_open_at_start_is_stopped_and_can_be_closed() -> None:
    controller = Controller()
    assert controller.state == memory.STOPPED
    controller.request(memory.REQUEST_CLOSE)
    controller.update(0.01, feedback(1500.0))
    assert controller.update(0.02, feedback(1500.0)).left_duty < 0.0


def test_the_wanted_speed_decreases_towards_the_ends() -> None:
    for speeds in C.opening_speed, C.closing_speed:
        assert len(speeds) == len(PLACES)
        assert speed_over(speeds, 0.55) == pytest.approx(0.5 * sum(speeds[6:8]))
        assert speed_over(speeds, -0.1) == speeds[0]
        assert speed_over(speeds, 1.1) == speeds[-1]
    assert speed_over(C.closing_speed, 0.02) < 0.5 * speed_over(C.closing_speed, 0.5)
    assert speed_over(C.opening_speed, 0.99) < 0.5 * speed_over(C.opening_speed, 0.5)


def test_a_blocked_closing_gate_reverses() -> None:
    controller = Controller()
    controller.request(memory.REQUEST_CLOSE)
    for cycle in range(1, 200):
        controller.update(0.01 * cycle, feedback(1500.0, current=-1.0))
    assert any("reversing" in text for text in controller.texts)


def test_requests_without_an_effect_are_ignored() -> None:
    controller = Controller(0.0, latched=True)
    for action in (memory.REQUEST_CLOSE, memory.STOP):
        controller.request(action)
        controller.update(0.01, feedback(0.0, latched=True))
    assert controller.state == memory.CLOSED
    assert controller.texts == []


def test_only_the_latest_events_are_kept() -> None:
    controller = Controller()
    for n in range(100):
        controller.request(memory.REQUEST_OPEN if n % 2 else memory.STOP)
        controller.update(0.01 * (n + 1), feedback(1500.0))
    told = events_since(controller.memory, 0)
    assert len(told) == memory.EVENTS
    assert [event.text for event in told[-2:]] == ["stopped by the driver", "opening"]
    assert told[-1].time == pytest.approx(1.0)
    assert events_since(controller.memory, 98) == told[-1:]


def records_of(own: EcuMemory) -> dict[str, Any]:
    """Return the 64-bit words of a memory by record, without events, statuses and checksums over all cycles."""
    names = ("command", "control", "drives", "guards")
    return {name: getattr(own, name).view(np.uint64).reshape(-1) for name in names}


def test_checksums_over_all_cycles_differ_after_one_different_value() -> None:
    left_out = new_memory(2)
    left_out.drives.history[...] = left_out.guards.reference[...] = 1.0
    left_out.guards.total[...], left_out.guards.samples[...] = 1.0, 1
    for name, words in records_of(new_memory(2)).items():
        for place in np.flatnonzero(records_of(left_out)[name] == words):
            same, other = new_memory(2), new_memory(2)
            for cycle in range(12):
                before = records_of(other)[name][place]
                if cycle == 7:
                    records_of(other)[name][place] ^= np.uint64(1)
                memory.note_course(same, False)
                memory.note_course(other, False)
                records_of(other)[name][place] = before
                assert np.array_equal(same.course, other.course) == (cycle < 7)


def test_checksums_over_all_cycles_include_collected_loads_only_when_a_motion_ends() -> None:
    same, other = new_memory(2), new_memory(2)
    other.guards.total[1, 99] = 1.0
    for has_changed_state in (False, True):
        memory.note_course(same, has_changed_state)
        memory.note_course(other, has_changed_state)
        assert np.array_equal(same.course, other.course) != has_changed_state


def test_checksums_over_all_control_cycles_are_the_same_in_machine_code_and_python() -> None:
    ours, plain = new_memory(2), new_memory(2)
    random = np.random.default_rng(1)
    for k in range(20):
        for name, words in records_of(ours).items():
            words[:] = random.integers(0, 2**64, len(words), dtype=np.uint64)
            records_of(plain)[name][:] = words
        compiled(memory.note_course)(ours, k % 3 == 0)
        memory.note_course(plain, k % 3 == 0)
    assert np.array_equal(ours.course, plain.course)


@pytest.mark.parametrize(("cycle_ms", "samples"), [(1.0, 5), (5.0, 1), (7.5, 2), (10.0, 2), (20.0, 2)])
def test_cycles_longer_than_the_load_filter_take_two_samples_per_obstacle(cycle_ms: float, samples: int) -> None:
    """With currents every 10 ms and a voltage in steps of 0.1 V, one sample stopped every second closing."""
    assert constants_of(C, 1e-3 * cycle_ms).samples == samples
