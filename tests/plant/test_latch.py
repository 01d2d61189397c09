"""The detailed latch: claw, pawl, hook, cinching motor, its switches, and the pinch strips."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from liftgate_compiler import compiled
from liftgate_plant import dynamics
from liftgate_plant.initial import closed_state, initial_state
from liftgate_plant.latch import (
    AUTOMATIC,
    COMMANDED,
    FULL,
    HALF,
    NO_CINCH,
    OPEN,
    Claw,
    LatchState,
    hook_force,
    mean_pull,
    next_latch,
    pull_speed,
    pulled_force,
)
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.sensors import Sensors, strip_closes
from liftgate_plant.vehicle import Vehicle, load_of, plant_of
from tests.plant import runs
from tests.plant.runs import BRAKE, CLOSE, COAST, column, fast_run, inputs, state_of, suv

BUILT = ("latch.half=0.008", "latch.distance=0.95")


def built(*settings: str) -> Vehicle:
    """The SUV with a detailed latch."""
    return suv(*BUILT, *settings)


def go(vehicle: Vehicle, state: Any, command: Any, seconds: float, step: float = 1e-3, **load: Any):
    """States (as `COLUMNS`) of a run with constant inputs; the latch is not released unless stated."""
    given = inputs(vehicle, command, **{"latch_released": 0.0, **load})
    return fast_run(plant_of(vehicle), state, given, step, round(seconds / step))


def place(vehicle: Vehicle, rows: np.ndarray) -> np.ndarray:
    """Distance [m] of the striker from home."""
    return vehicle.latch.distance * column(rows, "angle")


def torque_without_hook(vehicle: Vehicle, angle: float, **load: Any) -> float:
    """Torque [N m] without the hook on a resting gate whose drives do not push."""
    plant, around = plant_of(vehicle), load_of(vehicle)._replace(**load)
    return dynamics.gate_torque(plant, initial_state(plant, angle), around)


def test_a_closed_gate_rests_in_its_latch():
    vehicle = built()
    start = closed_state(plant_of(vehicle), load_of(vehicle))
    rows = go(vehicle, start, COAST, 2.0)
    assert np.ptp(np.degrees(column(rows, "angle"))) < 1e-4
    assert (column(rows, "latched") == 1.0).all()
    assert (column(rows, "left_current") == 0.0).all()
    own = vehicle.latch
    pushed = torque_without_hook(vehicle, start.gate_angle) / own.distance
    assert pushed > 100.0
    assert place(vehicle, rows)[-1] == pytest.approx(own.full + pushed / own.stiffness, rel=1e-6)
    shown = dynamics.outputs(plant_of(vehicle), start, inputs(vehicle, COAST))
    assert shown.latch_force == pytest.approx(pushed, rel=1e-6)
    assert shown.gate_acceleration == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("time", [0.0, 0.0124, 0.2])
@pytest.mark.parametrize("step", [1e-4, 1e-3, 5e-3])
def test_releasing_the_detailed_latch_takes_its_release_time(time: float, step: float):
    vehicle = built(f"latch.release_time={time}")
    start = closed_state(plant_of(vehicle), load_of(vehicle))
    rows = go(vehicle, start, COAST, 0.5, step, latch_released=1.0)
    held = column(rows, "latched") == 1.0
    assert held[: held.sum()].all()
    assert held.sum() * step == pytest.approx(max(time, step), abs=0.51 * step)
    assert place(vehicle, rows)[-1] > 2.0 * place(vehicle, rows)[0]


def test_a_gate_that_stays_down_is_caught_again_after_the_release():
    """Snow keeps the gate from rising; a pawl that falls too early holds it."""
    vehicle = built("latch.hold_time=0.1", "latch.release_time=0.05")
    start = closed_state(plant_of(vehicle), load_of(vehicle))
    rows = go(vehicle, start, COAST, 0.1, latch_released=1.0, hand_force=-1000.0)
    assert column(rows, "claw")[-1] == OPEN
    after = go(vehicle, state_of(rows[-1]), COAST, 0.5, hand_force=-1000.0)
    fallen = np.flatnonzero(column(after, "claw") != OPEN)[0]
    assert fallen * 1e-3 == pytest.approx(0.1, abs=2e-3)
    assert column(after, "latched")[-1] == (place(vehicle, after)[-1] <= 0.0)
    assert column(after, "claw")[-1] in (HALF, FULL)


def test_a_gate_pushed_into_the_half_position_stays_there():
    vehicle = built()
    plant = plant_of(vehicle)
    start = initial_state(plant, 0.012 / vehicle.latch.distance)
    rows = go(vehicle, start, runs.BRAKE, 0.1)
    assert (column(rows, "claw") == OPEN).all()
    inside = state_of(rows[-1])._replace(gate_angle=0.006 / vehicle.latch.distance)
    rows = go(vehicle, inside, COAST, 0.01)
    assert column(rows, "claw")[-1] == HALF
    rows = go(vehicle, state_of(rows[-1]), runs.OPEN, 3.0)
    assert column(rows, "claw")[-1] == HALF
    assert (column(rows, "latched") == 0.0).all()
    # The drives pull on the hook and stall.
    assert place(vehicle, rows)[-1] == pytest.approx(vehicle.latch.half, abs=2e-3)
    assert column(rows, "left_speed")[-1] == 0.0


def test_the_drives_close_the_gate_fully_into_the_detailed_latch():
    """Claw, hook and seal on the way in; the striker then rests in the hook."""
    vehicle = built()
    plant = plant_of(vehicle)
    rows = go(vehicle, initial_state(plant, math.radians(5.0)), CLOSE, 3.0)
    claw = column(rows, "claw")
    half, full = np.argmax(claw == HALF), np.argmax(claw == FULL)
    assert 0 < half < full
    assert place(vehicle, rows)[half] <= vehicle.latch.half < place(vehicle, rows)[half - 1]
    assert place(vehicle, rows)[full] <= 0.0 < place(vehicle, rows)[full - 1]
    assert (np.diff(claw) >= 0.0).all()
    assert column(rows, "latched")[-1] == 1.0


def latch_as_obstacles(vehicle: Vehicle, claw: float) -> tuple[Vehicle, Obstacle, Obstacle]:
    """The same gate without a latch, and its hook and claw spring as obstacles."""
    own, free = vehicle.latch, vehicle._replace(latch=vehicle.latch._replace(half=0.0))
    at = (own.half if claw == HALF else own.full) / own.distance
    hook = Obstacle(at, own.distance, own.stiffness, own.damping, 0.0, -1.0)
    entry = own.entry / own.distance
    spring = Obstacle(entry, own.distance, own.claw_force / own.entry, 0.0, 0.0, 1.0)
    return free, hook, spring


@pytest.mark.parametrize("step", [1e-4, 1e-3])
@pytest.mark.parametrize("claw", [HALF, FULL])
def test_the_hooks_force_on_an_opening_gate_equals_that_of_an_equivalent_obstacle(claw: float, step: float):
    """Obstacles themselves are compared with the event-located solution."""
    vehicle = built("latch.claw_force=0", "latch.damping=800")
    free, hook, _ = latch_as_obstacles(vehicle, claw)
    start = initial_state(plant_of(vehicle), 0.0003)._replace(
        gate_rate=0.05, latch=LatchState(claw, 0.0, 0.0, 0.0)
    )
    own = go(vehicle, start, runs.OPEN, 0.5, step)
    other = go(free, start, runs.OPEN, 0.5, step, latch_released=1.0, obstacle=hook)
    for name in ("angle", "rate", "left_current", "left_speed"):
        assert column(own, name) == pytest.approx(column(other, name), rel=1e-9, abs=1e-9)


def test_the_claw_springs_force_on_a_closing_gate_equals_that_of_an_equivalent_obstacle():
    vehicle = built("latch.claw_force=400")
    free, _, spring = latch_as_obstacles(vehicle, OPEN)
    start = initial_state(plant_of(vehicle), 0.04)
    own = go(vehicle, start, CLOSE, 1.0, latch_released=1.0)
    other = go(free, start, CLOSE, 1.0, latch_released=1.0, obstacle=spring)
    assert place(vehicle, own).min() < 0.01
    for name in ("angle", "rate", "left_current"):
        assert column(own, name) == pytest.approx(column(other, name), rel=1e-9, abs=1e-9)


def half_closed(vehicle: Vehicle) -> Any:
    """State at rest in the half position, held by hook and spindles."""
    angle = 0.5 * vehicle.latch.half / vehicle.latch.distance
    start = initial_state(plant_of(vehicle), angle)
    return start._replace(latch=LatchState(HALF, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("step", [1e-4, 1e-3, 5e-3])
def test_the_cinching_motor_pulls_the_gate_home_and_returns(step: float):
    vehicle = built("latch.cinch=automatic", "latch.cinch_force=5000", "latch.cinch_speed=0.02")
    rows = go(vehicle, half_closed(vehicle), CLOSE, 2.0, step)
    claw, pull = column(rows, "claw"), column(rows, "pull")
    done = int(np.argmax(claw == FULL))
    assert done > 0
    assert (np.diff(pull[: done + 1]) >= 0.0).all()
    assert (np.diff(pull[done + 1 :]) <= 0.0).all()
    assert pull[-1] == 0.0
    back = (np.argmax(pull[done:] == 0.0)) * step
    assert back == pytest.approx(pull[done] / 0.02, abs=2 * step)
    assert column(rows, "latched")[-1] == 1.0


def test_a_stalled_cinching_motor_pulls_with_its_rated_force():
    vehicle = built("latch.cinch=automatic", "latch.cinch_force=700", "latch.damping=0")
    rod = Obstacle(0.003, 1.0, 1e6, 1e3, 0.0, 1.0)
    rows = go(vehicle, half_closed(vehicle), COAST, 3.0, obstacle=rod)
    own, end = vehicle.latch, state_of(rows[-1])
    assert end.latch.claw == HALF
    bent = own.distance * end.gate_angle - own.half + end.latch.pull
    assert own.stiffness * bent == pytest.approx(700.0, rel=1e-3)
    shown = dynamics.outputs(plant_of(vehicle), end, inputs(vehicle, COAST))
    assert shown.latch_force == pytest.approx(700.0, rel=1e-3)


def time_home(vehicle: Vehicle, step: float) -> float:
    """Time [s] in which the cinching motor goes from the half position, with shorted spindles, to home."""
    angle = vehicle.latch.half / vehicle.latch.distance
    start = initial_state(plant_of(vehicle), angle)._replace(latch=HALF_CLOSED)
    rows = go(vehicle, start, BRAKE, 1.5, step)
    home, angles = int(np.argmax(column(rows, "claw") == FULL)), column(rows, "angle")
    assert home > 0
    return step * (home - 1 + angles[home - 1] / (angles[home - 1] - angles[home]))


@pytest.mark.parametrize(
    ("stiffness", "force", "steps"),
    [(2e6, 1200.0, (1e-3, 5e-3)), (1e7, 1200.0, (1e-3, 5e-3)), (2e6, 3000.0, (1e-3, 5e-3)),
     (1e8, 2500.0, (1e-3,))],
)  # fmt: skip
def test_the_duration_of_cinching_does_not_depend_on_the_step(
    stiffness: float, force: float, steps: tuple[float, ...]
):
    """The hook yields to the motor while the gate follows: at 5 ms cinching once took at least 81 ms too long."""
    keys = (f"latch.stiffness={stiffness}", f"latch.cinch_force={force}")
    vehicle = built("latch.cinch=automatic", *keys)
    limit = time_home(vehicle, 2e-5)
    for step in steps:
        assert time_home(vehicle, step) == pytest.approx(limit, abs=2e-3), step


@pytest.mark.parametrize("stiff", [False, True])
@pytest.mark.parametrize("step", [1e-4, 1e-3, 5e-3])
def test_the_bending_of_a_pulled_hook_solves_its_differential_equation(stiff: bool, step: float):
    """db/dt = ṡ + v_c − y b, for a rate that goes from 4 to −6 mm/s (for a stiff hook, −6 mm/s all along)."""
    claw, bent, rate, rate_end = CLAW._replace(damping=500.0), 2e-4, 0.004, -0.006
    yielding = claw.cinch_speed * claw.stiffness / claw.cinch_force

    def slope(time: float, b: np.ndarray) -> np.ndarray:
        now = rate_end if stiff else rate + (rate_end - rate) * time / step
        return np.array([now + claw.cinch_speed - yielding * b[0], b[0]])

    end, area = solve_ivp(slope, (0.0, step), [bent, 0.0], rtol=1e-10, atol=1e-14).y[:, -1]
    force, there = pulled_force(claw, bent, rate, stiff, step)
    assert there.constant + there.slope * rate_end == pytest.approx(end, rel=1e-7)
    damped = claw.damping * (slope(step, np.array([end, 0.0]))[0] if stiff else (end - bent) / step)
    expected = claw.stiffness * (end if stiff else area / step) + damped
    assert force.constant + force.slope * rate_end == pytest.approx(expected, rel=1e-7)
    if not stiff:
        state = HALF_CLOSED._replace(pull=0.001)
        angle = (0.007 + bent) / claw.distance
        mean = mean_pull(claw, state, angle, rate, rate, 0.0, step)
        steady = solve_ivp(
            lambda _, b: [rate + claw.cinch_speed - yielding * b[0], b[0]],
            (0.0, step), [bent, 0.0], rtol=1e-10, atol=1e-14,
        )  # fmt: skip
        assert mean == pytest.approx(claw.cinch_speed - yielding * steady.y[1, -1] / step, rel=1e-7)


def test_a_returning_hook_lets_the_gate_follow_at_its_speed():
    """A command that ends half way: the hook is damped by the striker's rate less its own."""
    claw, state = (CLAW._replace(cinch=float(COMMANDED), damping=3e3), HALF_CLOSED._replace(pull=0.004))
    resting = hook_force(claw, state, 0.0042, 0.0, 1.0)
    assert resting == pytest.approx(2e6 * 2e-4 + 3e3 * (0.012 - 20.0 * 2e-4))
    assert hook_force(claw, state, 0.0042, 0.0, 0.0) == pytest.approx(2e6 * 2e-4 - 3e3 * 0.012)
    assert hook_force(claw, state._replace(claw=FULL), 0.0007, 0.0, 0.0) == pytest.approx(400.0)
    assert mean_pull(claw, state, 0.0042, 0.0, 0.0, 0.0, 1e-3) == -0.012
    assert mean_pull(claw, state._replace(pull=6e-6), 0.0042, 0.0, 0.0, 0.0, 1e-3) == -0.006


def test_the_displayed_acceleration_of_a_gate_following_the_hook_agrees_with_its_step():
    """The gate's balance over a step includes the hook's returning speed: the displayed force pushes it out."""
    vehicle = built("latch.cinch=commanded", "latch.damping=5000")
    start = half_closed(vehicle)
    drawn = state_of(go(vehicle, start, COAST, 0.4, 1e-4, latch_cinched=1.0)[-1])
    assert drawn.latch.claw == HALF
    plant, given = plant_of(vehicle), inputs(vehicle, COAST, latch_released=0.0)
    step = 2e-5
    after = state_of(go(vehicle, drawn, COAST, step, step)[-1])
    middle = after._replace(
        gate_angle=0.5 * (drawn.gate_angle + after.gate_angle),
        gate_rate=0.5 * (drawn.gate_rate + after.gate_rate),
        latch=after.latch._replace(pull=0.5 * (drawn.latch.pull + after.latch.pull)),
    )
    acceleration = (after.gate_rate - drawn.gate_rate) / step
    assert dynamics.outputs(plant, middle, given).gate_acceleration == pytest.approx(acceleration, rel=0.02)


@pytest.mark.parametrize("step", [1e-3, 5e-3])
@pytest.mark.parametrize("above", [5e-5, 2e-4, 4e-4])
def test_a_claw_caught_within_a_step_is_pulled_from_that_moment_on(above: float, step: float):
    """The gate comes down at 80 mm/s, from this distance [m] above where the pawl catches the claw."""
    vehicle = built("latch.cinch=automatic")
    distance = vehicle.latch.distance
    start = initial_state(plant_of(vehicle), (vehicle.latch.half + above) / distance)
    start = start._replace(gate_rate=-0.08 / distance)
    pulls = {each: column(go(vehicle, start, COAST, 0.02, each), "pull")[-1] for each in (step, 1e-5)}
    assert pulls[1e-5] > 1e-4
    assert pulls[step] == pytest.approx(pulls[1e-5], abs=0.2 * step * vehicle.latch.cinch_speed)


def test_the_gates_path_during_cinching_converges_with_the_step():
    vehicle = built("latch.cinch=automatic")
    start = half_closed(vehicle)
    fine = go(vehicle, start, CLOSE, 0.4, 1e-5)[::100]
    errors = []
    for step in (1e-3, 5e-4):
        rows = go(vehicle, start, CLOSE, 0.4, step)[:: round(1e-3 / step)]
        errors.append(np.abs(place(vehicle, rows) - place(vehicle, fine)).max())
    assert errors[0] < 3e-5  # m, of a gate that bounces off its hook at 0.2 m/s
    assert errors[1] < 0.7 * errors[0]


CLAW = Claw(0.008, 0.0005, 0.02, 1.0, 2e3, 2e6, 0.0, 0.05, 0.3, AUTOMATIC, 0.012, 1200.0)
HALF_CLOSED = LatchState(HALF, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("cinch", "commanded", "expected"),
    [(NO_CINCH, 1.0, 0.0), (AUTOMATIC, 0.0, 0.012), (COMMANDED, 0.0, 0.0), (COMMANDED, 1.0, 0.012)],
)
def test_the_cinching_motor_starts_never_by_itself_or_on_command_as_configured(
    cinch: int, commanded: float, expected: float
):
    claw = CLAW._replace(cinch=float(cinch))
    assert pull_speed(claw, HALF_CLOSED, 0.004, commanded) == expected
    assert mean_pull(claw, HALF_CLOSED, 0.004, 0.0, 0.0, commanded, 1e-3) == expected


def test_the_cinching_motors_speed_falls_with_its_load_and_never_reverses():
    assert pull_speed(CLAW, HALF_CLOSED, 0.0083, 0.0) == pytest.approx(0.006)  # at half force
    assert pull_speed(CLAW, HALF_CLOSED, 0.02, 0.0) == 0.0
    drawn = LatchState(OPEN, 0.003, 0.0, 0.0)
    assert pull_speed(CLAW, drawn, 0.02, 1.0) == -0.012
    assert pull_speed(CLAW, drawn._replace(pull=0.0), 0.02, 1.0) == 0.0
    assert next_latch(CLAW, drawn._replace(pull=1e-6), 0.02, 0.02, -0.012, 0.0, 0.0, 1e-3).pull == 0.0


def test_a_release_opens_the_claw_while_its_hook_is_cinched():
    state = HALF_CLOSED._replace(pull=0.004)
    for _ in range(60):
        state = next_latch(CLAW, state, 0.004, 0.004, 0.0, 0.0, 1.0, 1e-3)
    assert state.claw == OPEN


@pytest.mark.parametrize(
    ("lateral", "force", "direction", "expected"),
    [
        (0.5, 20.0, 1.0, (1.0, 0.0)),
        (-0.5, 20.0, 1.0, (0.0, 1.0)),
        (0.0, 20.0, 1.0, (0.0, 0.0)),
        (0.5, 9.9, 1.0, (0.0, 0.0)),
        (0.5, 20.0, -1.0, (0.0, 0.0)),
    ],
)
def test_a_pinch_strip_senses_obstacles_on_its_side(lateral, force, direction, expected):
    rod = Obstacle(0.5, 1.0, 1e4, 0.0, 0.0, direction, lateral)
    own = Sensors(strip_force=10.0, strip_begin=0.3)
    assert tuple(strip_closes(own, side, rod, force) for side in (1.0, -1.0)) == expected
    assert strip_closes(Sensors(), 1.0, rod, force) == 0.0


def test_the_compiled_latch_equals_the_python_one():
    vehicle = built("latch.cinch=automatic")
    plant, given = plant_of(vehicle), inputs(vehicle, CLOSE, latch_released=0.0)
    state = half_closed(vehicle)
    plain, fast = np.empty((200, len(runs.COLUMNS))), np.empty((200, len(runs.COLUMNS)))
    runs.fill(plant, runs.LAW, state, given, 1e-3, plain)
    compiled(runs.fill)(plant, runs.LAW, state, given, 1e-3, fast)
    assert fast == pytest.approx(plain, rel=1e-9, abs=1e-12)


def test_the_pawl_does_not_engage_behind_a_hook_pulled_home():
    """A gate cinched and released at once must not be pulled home by the motor's return."""
    vehicle = built("latch.cinch=automatic", "latch.hold_time=0.02", "latch.cinch_speed=0.002")
    start = initial_state(plant_of(vehicle), 0.004)._replace(latch=LatchState(FULL, vehicle.latch.half, 0.0, 0.0))
    rows = go(vehicle, start, COAST, 0.06, latch_released=1.0)
    inside = state_of(rows[-1])._replace(gate_angle=0.004, gate_rate=0.0)
    after = go(vehicle, inside, COAST, 4.0, hand_force=-100.0)
    claw, pull = column(after, "claw"), column(after, "pull")
    beyond = place(vehicle, after) - (vehicle.latch.half - pull)
    caught = int(np.argmax(claw == HALF))
    assert caught > 0
    assert beyond[caught] <= 1e-4


@pytest.mark.parametrize("time", [0.0, 0.004, 0.3])
@pytest.mark.parametrize("step", [1e-5, 1e-3, 5e-3])
def test_the_pawl_stays_lifted_for_its_specified_time(time: float, step: float):
    claw = CLAW._replace(hold_time=time)
    state = next_latch(claw, LatchState(FULL, 0.0, 1.0, 0.0), 0.001, 0.001, 0.0, 0.0, 1.0, step)
    assert state.claw == OPEN
    count = 0
    while state.claw == OPEN:
        state = next_latch(claw, state, 0.001, 0.001, 0.0, 0.0, 0.0, step)
        count += 1
    assert count * step == pytest.approx(max(time, step), abs=0.51 * step)
