"""Properties that hold for every state and input of the plant."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from liftgate_compiler import compiled
from liftgate_plant import dynamics, gate, integrate, seal
from liftgate_plant.bridge import DriveInput
from liftgate_plant.dynamics import DriveState, Plant, State
from liftgate_plant.vehicle import plant_of
from tests.plant.runs import BRAKE, COAST, GATE, at_rest, column, fast_run, fill, inputs, load, run, state_of, suv

CALM = settings(deadline=None, derandomize=True, database=None, max_examples=60)
OTHER_RIGHT = ("right.motor.resistance=0.9", "right.gear.backlash=0.03", "right.spring.preload=300")
VEHICLES = {
    "suv": suv(),
    "unlike drives": suv(*OTHER_RIGHT, "supply.internal_resistance=0.03"),
    "hinge friction": suv("gate.hinge_friction=10", "friction.static_ratio=1.2"),
}


@st.composite
def states(draw: st.DrawFn, plant: Plant) -> State:
    """Any possible state of a gate: between the stops, drives near their play, moving."""
    angle = math.radians(draw(st.floats(0.5, 79.5)))
    extended = gate.extension(plant.link, angle)

    def drive() -> DriveState:
        position = (extended + draw(st.floats(-5e-4, 5e-4))) / plant.left.travel
        return DriveState(draw(st.floats(-15, 15)), draw(st.floats(-120, 120)), position, 20.0, 20.0, 20.0)

    return State(drive(), drive(), angle, draw(st.floats(-0.5, 0.5)), 0.0)


commands = st.one_of(
    st.sampled_from([BRAKE, COAST]), st.floats(-1.0, 1.0).map(lambda duty: DriveInput(duty, 0.0, 0.0))
)


def energy(plant: Plant, state: State, ambient_load: dynamics.Load) -> float:
    """Kinetic, magnetic, elastic and potential energy [J]; springs and weight by quadrature of their torque."""
    link = plant.link
    total = 0.5 * plant.gate_inertia * state.gate_rate**2
    extended = gate.extension(link, state.gate_angle)
    for drive, moving in ((plant.left, state.left), (plant.right, state.right)):
        total += 0.5 * drive.motor.inductance * moving.current**2
        # Motor speed in rev/s: J ω²/2 with ω = 2π n.
        total += 0.5 * drive.inertia * (2.0 * math.pi * moving.speed) ** 2
        beyond = max(0.0, abs(moving.position * drive.travel - extended) - drive.half_play)
        total += 0.5 * drive.mechanism.stiffness * beyond**2
        for depth in (extended - link.stroke, -extended):
            total += 0.5 * drive.spring.stop_stiffness * max(0.0, depth) ** 2
    rubber = max(0.0, seal.depth(plant.seal, extended))
    # M_2 has its own constant arm, so its potential is in φ, not in l_S.
    if rubber > 0.0:
        angles = np.linspace(state.gate_angle, gate.angle_of_extension(link, 1e-3), 200)
        torques = [
            plant.seal.arm * plant.seal.stiffness * max(0.0, seal.depth(plant.seal, gate.extension(link, a)))
            for a in angles
        ]
        total += float(np.trapezoid(torques, angles))
    grid = np.linspace(0.7, state.gate_angle, 400)
    smooth = [dynamics.smooth_torque(plant, ambient_load, float(a)) for a in grid]
    return total - float(np.trapezoid(smooth, grid))


@pytest.mark.parametrize("name", VEHICLES)
@pytest.mark.parametrize("command", [BRAKE, COAST], ids=["brake", "coast"])
@CALM
@given(data=st.data())
def test_an_unpowered_gate_gains_no_energy(name: str, command: DriveInput, data: st.DataObject) -> None:
    vehicle = VEHICLES[name]
    plant = plant_of(vehicle)
    state = data.draw(states(plant))
    around = load(vehicle)
    before = energy(plant, state, around)
    rows = fast_run(plant, state, inputs(vehicle, command), 1e-3, 400)
    levels = [before, *(energy(plant, state_of(row), around) for row in rows[1::57])]
    # The current of the first step is shed within microseconds; from then on nothing may come back
    # but the solver's own error: 1e-4 of what is stored, and a quadrature error of 1e-5 J.
    slack = 1e-4 * max(abs(level) for level in levels) + 1e-3
    assert max(np.diff(levels)) < slack, levels
    assert levels[-1] <= levels[0] + slack


@pytest.mark.parametrize("name", VEHICLES)
@CALM
@given(data=st.data())
def test_swapping_left_and_right_swaps_the_result(name: str, data: st.DataObject) -> None:
    vehicle = VEHICLES[name]
    plant = plant_of(vehicle)
    state = data.draw(states(plant))
    left, right = data.draw(commands), data.draw(commands)
    other = plant._replace(left=plant.right, right=plant.left)
    mirrored = state._replace(left=state.right, right=state.left)
    one = integrate.step(plant, state, inputs(vehicle, left, right), 1e-3)
    two = integrate.step(other, mirrored, inputs(vehicle, right, left), 1e-3)
    assert two.left == pytest.approx(one.right, rel=1e-9, abs=1e-9)
    assert two.right == pytest.approx(one.left, rel=1e-9, abs=1e-9)
    assert two.gate_angle == pytest.approx(one.gate_angle, rel=1e-12)
    assert two.gate_rate == pytest.approx(one.gate_rate, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("name", VEHICLES)
@CALM
@given(data=st.data())
def test_the_compiled_plant_equals_the_plain_one(name: str, data: st.DataObject) -> None:
    vehicle = VEHICLES[name]
    plant = plant_of(vehicle)
    state = data.draw(states(plant))
    given_inputs = inputs(vehicle, data.draw(commands), data.draw(commands))
    plain = run(plant, state, given_inputs, 1e-3, 5)
    machine = fast_run(plant, state, given_inputs, 1e-3, 5)
    # Fused multiply-adds and libm may differ in the last bits; five steps amplify them a little.
    assert np.allclose(machine, plain, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("step", [1e-5, 1e-4, 1e-3, 5e-3])
@CALM
@given(data=st.data())
def test_a_step_from_any_state_gives_a_finite_state(step: float, data: st.DataObject) -> None:
    vehicle = VEHICLES["unlike drives"]
    plant = plant_of(vehicle)
    state = data.draw(states(plant))
    end = fast_run(plant, state, inputs(vehicle, data.draw(commands)), step, 200)[-1]
    assert np.isfinite(end).all()
    assert -math.radians(5.0) < end[GATE] < math.radians(90.0)


def test_a_missing_drive_has_no_effect() -> None:
    vehicle = suv("drives=1", "supply.internal_resistance=0.1")
    plant = plant_of(vehicle)
    start = at_rest(vehicle, 20.0)
    open_left = DriveInput(1.0, 0.0, 0.0)
    alone = fast_run(plant, start, inputs(vehicle, open_left, BRAKE), 1e-3, 500)
    driven = fast_run(plant, start, inputs(vehicle, open_left, open_left), 1e-3, 500)
    assert np.array_equal(alone, driven)
    right = [column(alone, f"right_{name}") for name in ("current", "speed", "position", "slip")]
    assert not np.any(right)


def test_the_compiler_is_enabled_for_the_tests_of_the_plant() -> None:
    assert compiled(fill) is not fill
