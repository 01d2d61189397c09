"""Overload protection: the slip clutch and the thermal cut-out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from liftgate_compiler import compiled
from liftgate_plant import clutch, cutout, integrate
from liftgate_plant.contact import LinearizedForce
from liftgate_plant.cutout import Cutout
from liftgate_plant.dynamics import drive_force, places_of
from liftgate_plant.vehicle import plant_of
from tests.plant.runs import CLOSE, COAST, OPEN, at_rest, column, fast_run, inputs, state_of, suv

LIMIT, PLAY, STEP = 2500.0, 5e-5, 1e-3


def exact_way(stiffness: float, damping: float, bent: float, rate: float) -> float:
    """Slip [m] within a step while the mechanism has the clutch's force, k e + c ė = F_c, by small steps."""
    n, slip = 20_000, 0.0
    for _ in range(n):
        yields = (LIMIT - stiffness * bent) / damping
        slip += (rate - yields) * STEP / n
        bent += yields * STEP / n
    return slip


@pytest.mark.parametrize("along", [1.0, -1.0])
@pytest.mark.parametrize("rate", [0.05, 0.5])
@pytest.mark.parametrize(("stiffness", "damping"), [(5e5, 4e3), (5e6, 4e4), (5e5, 1e5), (0.0, 3e5)])
def test_the_slip_of_a_clutch_within_a_step_agrees_with_the_exact_solution(stiffness, damping, rate, along):
    bent = 0.9 * LIMIT / stiffness if stiffness else 1e-3
    slip = clutch.way(along * LIMIT, stiffness, damping, PLAY, along * (PLAY + bent), along * rate * STEP, STEP)
    expected = max(0.0, exact_way(stiffness, damping, bent, rate))
    assert along * slip == pytest.approx(expected, rel=1e-3, abs=1e-9)


def test_without_a_damper_a_slipping_clutch_limits_the_force_at_once():
    slip = clutch.way(LIMIT, 5e5, 0.0, PLAY, PLAY, 0.01, STEP)
    assert slip == pytest.approx(0.01 - LIMIT / 5e5)


def test_a_clutch_grips_up_to_its_force_and_a_zero_torque_means_no_clutch():
    push = LinearizedForce(9e9, 3.0)
    assert clutch.slipping(LIMIT, LIMIT) == clutch.slipping(0.0, -9e9) == 0.0
    assert clutch.slipping(LIMIT, -2600.0) == -LIMIT
    assert clutch.push_through(0.0, push) == push
    assert clutch.push_through(-LIMIT, push) == LinearizedForce(-LIMIT, 0.0)
    assert clutch.way(0.0, 5e5, 4e3, PLAY, 1.0, 1.0, STEP) == 0.0
    assert clutch.limited(0.0, -9e9) == -9e9
    assert clutch.limited(LIMIT, -9e9) == -LIMIT


TORQUE = 4.0  # N m on the spindle
FORCE = 2.0 * math.pi * TORQUE / 0.010


@pytest.mark.parametrize("step", [1e-4, 1e-3, 5e-3])
def test_motors_keep_turning_at_the_open_stop_while_their_clutch_slips(step):
    """In the open stop the force is the clutch's, the motors keep turning, and the count drifts from the gate."""
    vehicle = suv(f"clutch.torque={TORQUE}")
    plant = plant_of(vehicle)
    rows = fast_run(plant, at_rest(vehicle, 70.0), inputs(vehicle, OPEN), step, round(3.0 / step))
    end = state_of(rows[-1])
    assert drive_force(plant.left, end.left, places_of(plant, end).left) == pytest.approx(FORCE, rel=1e-6)
    # (4.2) at a constant speed: c1Φ i = κ F + τ_C, and (4.1) gives the speed.
    drive = plant.left
    current = (drive.torque_per_force * FORCE + drive.friction.coulomb) / drive.motor.torque_constant
    speed = (12.0 - drive.motor.resistance * current) / drive.motor.speed_constant
    assert end.left.current == pytest.approx(current, rel=1e-6)
    assert end.left.speed == pytest.approx(speed, rel=1e-6)
    assert end.left.slip > 0.01
    forces = [drive_force(plant.left, each.left, places_of(plant, each).left) for each in map(state_of, rows)]
    assert max(np.abs(forces)) <= FORCE * (1.0 + 1e-9)
    # Back home: as the spindle is shorter by what has slipped, the motor's way does not tell the gate's.
    back = fast_run(plant, end, inputs(vehicle, CLOSE), step, round(0.5 / step))
    gate = column(back, "angle")[-1]
    stroke = plant.link.stroke
    assert math.degrees(gate) < 79.0
    assert end.left.position * drive.travel - stroke > 0.01


MECHANISMS = [(1e9, 4e3), (1e12, 0.0), (1e11, 4e3), (5e5, 1e8), (5e5, 3e6), (4e8, 4e3)]


@pytest.mark.parametrize("step", [1e-5, 1e-3, 5e-3])
@pytest.mark.parametrize(("stiffness", "damping"), MECHANISMS)
def test_a_reversal_with_a_clutch_ends_alike_for_mechanisms_of_any_stiffness(stiffness, damping, step):
    """A reversal in motion: the gate ends where one with a soft mechanism does, and currents stay bounded."""
    ends = {}
    for torque in (4.0, 900.0):
        vehicle = suv(
            f"clutch.torque={torque}", f"mechanism.stiffness={stiffness}", f"mechanism.damping={damping}"
        )
        plant, count = plant_of(vehicle), round(1.0 / step)
        rows = fast_run(plant, at_rest(vehicle, 70.0), inputs(vehicle, OPEN), step, count)
        back = fast_run(plant, state_of(rows[-1]), inputs(vehicle, CLOSE), step, count)
        ends[torque] = math.degrees(column(back, "angle")[-1])
        assert np.abs(column(back, "left_current")).max() < 1.05 * 2.0 * 12.0 / 0.708
        assert np.abs(column(back, "left_speed")).max() < 200.0
    assert ends[900.0] == pytest.approx(64.46, abs=0.1)
    assert ends[4.0] == pytest.approx(64.63, abs=0.25)


def test_a_clutch_that_never_slips_has_no_effect():
    rows = {}
    for torque in (0.0, 900.0):
        vehicle = suv(f"clutch.torque={torque}")
        rows[torque] = fast_run(plant_of(vehicle), at_rest(vehicle, 20.0), inputs(vehicle, OPEN), 1e-3, 1500)
    np.testing.assert_array_equal(rows[0.0], rows[900.0])


def test_the_thermal_cut_out_holds_and_trips_as_in_the_data_sheet():
    """Holds 5 A for ever and 8.5 A, but not 9 A, at 20 °C; trips at 25 A after 3.6 s (defaults with 36 mΩ)."""
    fuse = Cutout(resistance=0.036)

    def heated(current: float, seconds: float, h: float = 1e-3) -> float:
        temperature = 20.0
        for _ in range(round(seconds / h)):
            loss = cutout.soon(fuse, temperature, current, 0.5 * h) * current**2
            temperature = cutout.warm(fuse, temperature, 20.0, loss, h)
            if temperature > fuse.temperature:
                return temperature
        return temperature

    assert heated(5.0, 300.0) == pytest.approx(20.0 + 39.0 * 0.036 * 25.0, abs=0.1)
    assert heated(8.5, 300.0) < fuse.temperature < heated(9.0, 300.0)
    assert heated(25.0, 3.5) < fuse.temperature < heated(25.0, 3.9)
    assert cutout.resistance_at(fuse, 135.0) == pytest.approx(0.036 * math.e**2)


def test_the_cut_out_switches_a_stalled_motor_off_until_it_has_cooled():
    vehicle = suv("cutout.resistance=0.036")
    plant = plant_of(vehicle)
    stalled = fast_run(plant, at_rest(vehicle, 79.0), inputs(vehicle, OPEN), 1e-3, 30_000)
    current, warmth = column(stalled, "left_current"), column(stalled, "left_cutout_temperature")
    tripped = int(np.argmax(warmth > 125.0))
    assert 5_000 < tripped < 20_000
    assert current[tripped - 2000] > 10.0
    assert current[-1] < 0.5
    # At rest, what it lets through keeps it hot: U²/R = (T − T_amb)/R_th.
    end = state_of(stalled[-1]).left
    loss = cutout.resistance_at(plant.left.cutout, end.cutout_temperature) * end.current**2
    assert loss == pytest.approx((end.cutout_temperature - 20.0) / 39.0, rel=0.02)
    # Without power it cools down with its time constant, and lets all of it through again.
    coasting = OPEN._replace(duty=0.0, coast=1.0)
    cold = fast_run(plant, state_of(stalled[-1]), inputs(vehicle, coasting), 1e-3, 60_000)
    fallen = column(cold, "left_cutout_temperature")[-1] - 20.0
    assert fallen == pytest.approx((end.cutout_temperature - 20.0) * math.exp(-60.0 / (39.0 * 0.75)), rel=1e-3)
    again = fast_run(plant, state_of(cold[-1]), inputs(vehicle, OPEN), 1e-3, 100)
    assert column(again, "left_current").max() > 10.0


def test_the_temperature_of_the_cut_out_agrees_with_its_equations():
    """A blocked rotor, solved by scipy."""
    vehicle = suv("cutout.resistance=0.3", "cutout.capacity=0.1", "spindle.friction_force=1e5")
    plant = plant_of(vehicle)
    rows = fast_run(plant, at_rest(vehicle, 40.0), inputs(vehicle, OPEN), 1e-3, 3000)
    fuse = plant.left.cutout

    def slope(_: float, y: list[float]) -> list[float]:
        resistance = cutout.resistance_at(fuse, y[0])
        current = 12.0 / (0.708 + resistance)
        return [(resistance * current**2 - (y[0] - 20.0) / 39.0) / 0.1]

    times = 1e-3 * np.arange(3001)
    warmth = solve_ivp(slope, (0.0, 3.0), [20.0], "LSODA", times, rtol=1e-10, atol=1e-10).y[0]
    np.testing.assert_allclose(column(rows, "left_cutout_temperature"), warmth, atol=0.05)


@pytest.mark.parametrize("damping", [4e3, 2e5])
@pytest.mark.parametrize("step", [1e-5, 1e-3])
def test_a_latch_that_catches_a_gate_pressed_into_the_seal_does_not_push_the_drives(damping, step):
    """The gate stays beyond φ = 0, so that it is caught without crossing home within the step."""
    vehicle = suv(f"mechanism.damping={damping}")
    plant = plant_of(vehicle)
    pressed = fast_run(plant, at_rest(vehicle, 3.0), inputs(vehicle, CLOSE), step, round(1.0 / step))
    start = state_of(pressed[-1])
    assert start.gate_angle < 0.0
    given = inputs(vehicle, CLOSE, latch_released=0.0)
    end = state_of(fast_run(plant, start, given, step, 1)[-1])
    assert end.latched == 1.0
    assert end.gate_angle == 0.0
    assert end.left.speed == pytest.approx(start.left.speed, abs=0.1)
    assert end.left.current == pytest.approx(start.left.current, abs=0.1)


@pytest.mark.parametrize("stiffness", [0.0, 5e5, 1e8, 1e10])
@pytest.mark.parametrize("voltage", [0.0, 3.0, 12.0])
@pytest.mark.parametrize("step", [1e-3, 5e-3])
def test_a_coasting_motor_only_ever_charges_the_source(stiffness, voltage, step):
    """Pushed by a hand: the mean current opposes the back-EMF, whatever the mechanism does."""
    vehicle = suv(f"mechanism.stiffness={stiffness}")
    plant, state = plant_of(vehicle), at_rest(vehicle, 40.0)
    given = inputs(vehicle, COAST, supply_voltage=voltage, hand_force=-400.0)
    advance = compiled(integrate.advance)
    for _ in range(round(0.4 / step)):
        before = state
        state, flow = advance(plant, state, given, step)
        emf = before.left.speed + state.left.speed
        assert flow.left.mean * math.copysign(1.0, emf) < 0.01
