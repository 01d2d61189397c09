"""Components of the plant, one by one, against closed forms and independent numerics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.linalg import expm

from liftgate_plant import (
    bridge,
    contact,
    current,
    environment,
    friction,
    gate,
    hall,
    latch,
    motor,
    noise,
    obstacle,
    seal,
    sensors,
    shunt,
    spring,
    supply,
    thermal,
    transmission,
)
from liftgate_plant.faults import SOUND_CURRENT
from tests.plant.runs import suv

CALM = settings(deadline=None, derandomize=True, database=None, max_examples=100)
ROUND_OFF = 1e-9  # relative; a few hundred operations in double precision


# Motor and supply.


def coupled_windings(windings, source_resistance, source, currents, speeds, ends, step):
    """Currents [A] of both windings at the end of a step and their means over it, by a matrix exponential."""
    left, right = windings
    inverse = np.diag([1.0 / left.inductance, 1.0 / right.inductance])
    duty = np.array([left.duty, right.duty])
    resistance = np.diag([left.resistance, right.resistance])
    a = -inverse @ (resistance + source_resistance * np.outer(duty, duty))
    emf = np.array([left.speed_constant, right.speed_constant])
    applied = np.array([left.voltage, right.voltage]) + duty * source
    b0 = inverse @ (applied - emf * speeds)
    rises = np.array([left.rise, right.rise])
    b0 -= 0.5 * inverse @ rises
    b1 = inverse @ (rises - emf * (ends - speeds)) / step
    # States: i (2), ∫i (2), 1, t.
    system = np.zeros((6, 6))
    system[:2, :2] = a
    system[:2, 4] = b0
    system[:2, 5] = b1
    system[2:4, :2] = np.eye(2)
    system[5, 4] = 1.0
    end = expm(system * step) @ np.array([*currents, 0.0, 0.0, 1.0, 0.0])
    return end[:2], end[2:4] / step


@CALM
@given(
    duties=st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
    inductances=st.tuples(st.floats(2e-5, 5e-3), st.floats(2e-5, 5e-3)),
    resistances=st.tuples(st.floats(0.2, 3), st.floats(0.2, 3)),
    currents=st.tuples(st.floats(-20, 20), st.floats(-20, 20)),
    speeds=st.tuples(st.floats(-160, 160), st.floats(-160, 160)),
    changes=st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
    rises=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    source_resistance=st.sampled_from([0.0, 0.03, 0.5]),
    step=st.sampled_from([1e-5, 1e-4, 1e-3, 5e-3]),
)
def test_currents_of_coupled_windings_agree_with_the_matrix_exponential(
    duties, inductances, resistances, currents, speeds, changes, rises, source_resistance, step
) -> None:
    windings = [
        motor.Winding(r, inductance, 0.0769, duty, 0.0, rise)
        for r, inductance, duty, rise in zip(resistances, inductances, duties, rises, strict=True)
    ]
    ends = np.array(speeds) + np.array(changes)
    left, right, _, _ = motor.solve_windings(*windings, currents, speeds, 12.0, source_resistance, step)
    end, mean = coupled_windings(windings, source_resistance, 12.0, currents, np.array(speeds), ends, step)
    ours = [
        motor.end_current(left, ends[0], ends[1]),
        motor.end_current(right, ends[1], ends[0]),
        motor.mean_current(left, ends[0], ends[1]),
        motor.mean_current(right, ends[1], ends[0]),
    ]
    assert ours == pytest.approx([*end, *mean], rel=1e-8, abs=1e-8)  # expm's own accuracy


@pytest.mark.parametrize("z", [-1e-9, -0.1, -0.4999, -0.5001, -16.0, -200.0])
def test_phi_functions_agree_with_their_integrals(z: float) -> None:
    values = motor.phi_functions(z)
    assert values[0] == pytest.approx(math.exp(z), rel=ROUND_OFF)
    for k in (1, 2, 3):
        exact, _ = quad(lambda s, k=k: math.exp((1 - s) * z) * s ** (k - 1) / math.factorial(k - 1), 0, 1)
        assert values[k] == pytest.approx(exact, rel=1e-7)  # quad's own accuracy


def test_the_terminal_voltage_falls_with_the_current_of_both_bridges() -> None:
    assert supply.terminal_voltage(12.0, 0.05, 10.0, 2.0) == pytest.approx(11.4)
    assert supply.terminal_voltage(12.0, 0.05, -10.0, 0.0) == pytest.approx(12.5)


# Bridge.


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (bridge.OPEN, bridge.DriveInput(0.7, 0.0, 0.0)),
        (bridge.CLOSE, bridge.DriveInput(-0.7, 0.0, 0.0)),
        (bridge.BRAKE, bridge.DriveInput(0.0, 0.0, 0.0)),
        (bridge.COAST, bridge.DriveInput(0.0, 0.0, 1.0)),
    ],
)
def test_bridge_states_apply_the_voltages_of_their_table(state, expected) -> None:
    assert bridge.drive_input(state, 0.7) == expected


@CALM
@given(current=st.floats(-20, 20), emf=st.floats(-11, 11), step=st.sampled_from([1e-5, 1e-4, 1e-3, 5e-3]))
def test_a_coasting_current_decays_to_zero_through_the_diodes(current, emf, step) -> None:
    resistance, inductance, limit = 0.708, 4.37e-5, 13.4
    result = bridge.coasting(current, emf, resistance, inductance, limit, 0.0, step)
    if current == 0.0:
        assert result == bridge.Coasting(0.0, 0.0, 0.0, step)
        return
    against = -math.copysign(limit, current)

    def slope(_, x):
        return [(against - resistance * x[0] - emf) / inductance, x[0]]

    def empty(_, x):
        return x[0]

    empty.terminal = True
    solution = solve_ivp(slope, (0, step), [current, 0.0], "DOP853", events=empty, rtol=1e-11, atol=1e-13)
    if solution.status == 0:  # the step ends first
        assert result == bridge.Coasting(1.0, against, 0.0, step)
    else:
        assert result.conducts == 0.0
        assert result.mean * step == pytest.approx(solution.y[1, -1], rel=1e-6, abs=1e-12)


def test_a_fast_coasting_motor_charges_the_source() -> None:
    result = bridge.coasting(0.0, 15.0, 0.708, 4.37e-5, 13.4, 0.0, 1e-3)
    assert result == bridge.Coasting(1.0, 13.4, 0.0, 1e-3)
    assert bridge.blocked(0.5, -1.0) == 0.0
    assert bridge.blocked(-0.5, -1.0) == -0.5


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_coasting_motor_that_overspeeds_within_a_step_charges_the_source_from_there_on(way):
    """EMF rises from 13.3 V by 0.4 V over the step, against a limit of 13.4 V."""
    result = bridge.coasting(0.0, way * 13.3, 0.708, 4.37e-5, 13.4, 0.4, 1e-3)
    assert result == pytest.approx((0.0, way * 13.4, 0.0, 0.25e-3), abs=1e-12)
    slower = bridge.coasting(0.0, way * 13.3, 0.708, 4.37e-5, 13.4, 0.09, 1e-3)
    assert slower == (0.0, 0.0, 0.0, 1e-3)


# Friction.


@CALM
@given(drive=st.floats(-5, 5), limit=st.floats(0, 2))
def test_dry_friction_never_drives(drive: float, limit: float) -> None:
    left = friction.soft_threshold(drive, limit)
    assert abs(left) == pytest.approx(max(0.0, abs(drive) - limit), abs=1e-15)
    assert left * drive >= 0.0


def test_friction_falls_from_static_to_coulomb_over_the_stribeck_speed() -> None:
    law = friction.DryFriction(2.0, 1.5, 10.0, 0.0)
    assert friction.level(law, 0.0) == 3.0
    assert friction.level(law, 10.0) == pytest.approx(2.0 * (1.0 + 0.5 / math.e))
    assert friction.level(law, -10.0) == friction.level(law, 10.0)
    assert friction.level(law, 1000.0) == 2.0
    plain = friction.DryFriction(2.0, 1.5, 0.0, 0.0)
    assert friction.level(plain, 1e-9) == 2.0


def test_friction_while_breaking_away_is_the_rising_torque_until_the_limit() -> None:
    limit, final, decay, step = 1.0, 10.0, 16000.0, 1e-3
    mean = friction.breakaway(limit, 0.0, final, decay, step)
    # Friction follows the rising torque until it is exceeded, and is the limit from there on.
    exact, _ = quad(lambda t: min(limit, final * (1.0 - math.exp(-decay * t))), 0.0, step, limit=200)
    assert mean == pytest.approx(exact / step, rel=1e-6)
    assert friction.breakaway(limit, 2.0, final, decay, step) == limit


def test_a_shaft_turns_back_only_if_driven_beyond_its_friction() -> None:
    assert friction.turns(1.0, 0.5, -2.0)
    assert not friction.turns(1.0, 5.0, -2.0 + 5.0)
    assert not friction.turns(1.0, 0.1, -0.5)  # it stops, and friction holds it


# Transmission.


def test_cold_increases_the_gears_friction() -> None:
    assert transmission.temperature_factor(0.01, 20.0) == 1.0
    assert transmission.temperature_factor(0.01, -30.0) == pytest.approx(1.5)
    assert transmission.temperature_factor(0.0, -55.0) == 1.0


@pytest.mark.parametrize(
    ("extension", "rate", "expected"),
    [
        (0.0, 5.0, 0.0),
        (0.04, 5.0, 0.0),
        (0.15, 0.0, 10.0),
        (-0.15, 0.0, -10.0),
        (0.15, -200.0, 0.0),  # the damper cannot pull
        (-0.15, 200.0, 0.0),
    ],
)
def test_the_mechanism_transmits_force_only_beyond_its_play(extension, rate, expected) -> None:
    force = transmission.mechanism_force(100.0, 0.1, 0.05, extension, rate)
    assert force == pytest.approx(expected)


# Contact.


@CALM
@given(
    depth=st.floats(-1e-3, 1e-3),
    rate=st.floats(-0.2, 0.2),
    change=st.floats(-0.05, 0.05),
    damping=st.floats(0, 5000),
    step=st.sampled_from([1e-5, 1e-4, 1e-3]),
)
def test_the_mean_force_of_a_contact_is_its_integral(depth, rate, change, damping, step) -> None:
    stiffness = 5e5
    end = rate + change
    when = contact.window(stiffness, damping, depth, rate, end, 1e-6, step)
    push = contact.push(stiffness, damping, depth, rate, 1e-6, step, when)
    mean = push.constant + push.slope * end

    def law(s: float) -> float:
        now = depth + step * (rate * s + 0.5 * change * s * s)
        return contact.force(stiffness, damping, now, rate + change * s)

    samples = (np.arange(4000) + 0.5) / 4000.0
    exact = float(np.mean([law(s) for s in samples]))
    # The window is that of straight lines: off by the curvature of the path, change · step / 8.
    slack = stiffness * abs(change) * step + 2e-3 * (abs(exact) + damping * abs(rate))
    assert mean == pytest.approx(exact, abs=slack + 1e-9)


@pytest.mark.parametrize("number", [0.5, 1.2, 5.0, 1e6])
def test_a_contact_of_any_stiffness_stays_stable(number: float) -> None:
    # One mass on a spring that never opens, k h²/m = number, through Newmark's momentum balance.
    step, stiffness, mobility = 1e-3, 1.0, number / 1e-6
    when = contact.PushWindow(0.0, 1.0)
    depth, rate = 1.0, 0.0
    peak = 0.0
    for _ in range(5000):
        push = contact.push(stiffness, 0.0, depth, rate, mobility, step, when)
        gain = step * mobility
        new = (rate - gain * push.constant) / (1.0 + gain * push.slope)
        depth += 0.5 * step * (rate + new)
        rate = new
        peak = max(peak, abs(depth))
    assert peak < 1.5


# Spring, seal, gate, obstacle, latch, environment.


def test_the_force_of_a_gas_spring_is_progressive_and_rises_with_temperature() -> None:
    gas = spring.Spring(0.0, 0.0, 1e6, 1e3, 500.0, 1.4, 1.0)
    assert spring.force(gas, 0.25, 0.25, 20.0) == pytest.approx(500.0)
    assert spring.force(gas, 0.0, 0.25, 20.0) == pytest.approx(700.0)
    assert spring.force(gas, 0.25, 0.25, -20.0) == pytest.approx(500.0 * 253.15 / 293.15)


def test_a_coil_spring_pushes_by_its_compression_and_a_lost_one_not_at_all() -> None:
    coil = spring.Spring(900.0, 330.0, 1e6, 1e3)
    assert spring.force(coil, 0.1, 0.25, 20.0) == pytest.approx(330.0 + 900.0 * 0.15)
    assert spring.force(coil._replace(health=0.0), 0.1, 0.25, 20.0) == 0.0


def test_the_seals_depth_ends_where_its_force_is_zero() -> None:
    rubber = seal.Seal(200.0, 2e5, 0.9)
    assert seal.depth(rubber, 0.0) * rubber.stiffness == pytest.approx(200.0)
    assert seal.depth(rubber, 1e-3) == pytest.approx(0.0, abs=1e-15)
    assert seal.depth(seal.Seal(0.0, 0.0, 0.9), -1.0) == 0.0


@CALM
@given(angle=st.floats(0.0, math.radians(80.0)))
def test_angle_and_length_are_inverse_and_the_lever_arm_is_their_slope(angle: float) -> None:
    link = gate.linkage(suv().gate)
    extended = gate.extension(link, angle)
    assert gate.angle_of_extension(link, extended) == pytest.approx(angle, abs=1e-9)
    slope = (gate.extension(link, angle + 1e-6) - gate.extension(link, angle - 1e-6)) / 2e-6
    assert gate.lever(link, angle) == pytest.approx(slope, rel=1e-7)


@pytest.mark.parametrize(("direction", "angle", "rate"), [(1.0, 0.48, -0.2), (-1.0, 0.52, 0.2)])
def test_an_obstacle_pushes_against_the_motion_that_hit_it(direction, angle, rate) -> None:
    body = obstacle.Obstacle(0.5, 0.9, 10e3, 100.0, 0.003, direction)
    expected = 10e3 * (0.02 * 0.9 - 0.003) + 100.0 * 0.2 * 0.9
    assert obstacle.pinch_force(body, angle, rate) == pytest.approx(expected)
    assert obstacle.pinch_force(body, 1.0 - angle, rate) == 0.0


def test_the_latch_catches_at_home_unless_released() -> None:
    assert latch.takes_up(0.0, 0.0)
    assert latch.takes_up(-1e-6, 0.0)
    assert not latch.takes_up(1e-6, 0.0)
    assert not latch.takes_up(0.0, 1.0)


def test_wind_hand_and_snow_act_with_their_levers() -> None:
    place = environment.Environment()._replace(wind_area=2.0, wind_lever=0.5, hand_distance=0.9, snow_distance=0.4)
    assert environment.steady_torque(place, 100.0, 20.0, 3.0) == pytest.approx(121.0)
    assert environment.snow_inertia(place, 10.0) == pytest.approx(1.6)
    link = gate.linkage(suv().gate)
    level = -link.gravity_angle  # where the centre of gravity is level with the hinge
    torque = environment.snow_torque(place, 10.0, link, level, 0.0)
    assert torque == pytest.approx(10.0 * 9.81 * 0.4)


# Thermal.


def test_a_motor_warms_up_to_the_temperature_at_which_its_losses_are_dissipated() -> None:
    body = thermal.Thermal(enabled=1.0)
    winding = housing = 20.0
    for _ in range(20_000):
        winding, housing = thermal.warm(body, winding, housing, 20.0, 5.0, 0.5)
    assert housing == pytest.approx(20.0 + 5.0 * body.housing_resistance, rel=1e-5)
    assert winding == pytest.approx(housing + 5.0 * body.winding_resistance, rel=1e-5)


def test_a_warm_motor_has_more_resistance_and_less_flux_if_its_thermal_model_is_enabled() -> None:
    body = thermal.Thermal(enabled=1.0)
    assert thermal.resistance_factor(body, 120.0) == pytest.approx(1.393)
    assert thermal.flux_factor(body, 120.0) == pytest.approx(0.9)
    cold = thermal.Thermal()
    assert thermal.resistance_factor(cold, 120.0) == thermal.flux_factor(cold, 120.0) == 1.0
    assert thermal.warm(cold, 20.0, 20.0, 0.0, 100.0, 1.0) == (20.0, 20.0)


# Sensors and noise.


def test_the_hall_count_is_the_shaft_position_rounded_to_quarter_turns() -> None:
    table = sensors.Sensors()
    assert [sensors.hall_count(table, p) for p in (0.0, 0.12, 0.13, -0.12, -0.13, 10.0)] == [
        0, 0, 1, 0, -1, 40,
    ]  # fmt: skip


STILL = hall.MotorShaft(0.0, 0.0)


def sensed_current(table: sensors.Sensors, amperes: float, filtered: float = 0.0):
    """Filtered current and reading [A] of the sensor for a constant current in a motor that rests at 0 rev."""
    when, before = hall.Tick(0.0, 1e-3, 0, False), shunt.MeanWindow(filtered, 0.0)
    path = current.held(amperes)
    motor = suv().left.motor
    after, reading = sensors.sensed_current(table, SOUND_CURRENT, motor, path, (STILL, STILL), before, 0.0, when)
    return after.mean, reading


def test_the_current_sensor_scales_quantizes_filters_and_saturates() -> None:
    table = sensors.Sensors()._replace(
        current_gain=2.0, current_offset=0.3, current_resolution=0.25, current_limit=20.0
    )
    assert sensed_current(table, 3.0) == (3.0, 6.25)
    assert sensed_current(table, 50.0)[1] == 20.0
    slow = sensors.Sensors()._replace(current_filter=0.01)
    filtered = 0.0
    for _ in range(10):
        filtered, _ = sensed_current(slow, 3.0, filtered)
    assert filtered == pytest.approx(3.0 * (1.0 - math.exp(-1.0)))


def test_noise_is_repeatable_normal_and_independent_between_channels() -> None:
    values = np.array([[noise.gaussian(7, k, c) for k in range(20_000)] for c in (0, 1)])
    assert noise.gaussian(7, 123, 1) == values[1, 123]
    # Four standard errors of 20,000 samples.
    assert np.abs(values.mean(axis=1)).max() < 4.0 / math.sqrt(20_000)
    assert np.abs(values.std(axis=1) - 1.0).max() < 4.0 / math.sqrt(40_000)
    assert abs(np.corrcoef(values)[0, 1]) < 4.0 / math.sqrt(20_000)
    assert abs(np.corrcoef(values[0, :-1], values[0, 1:])[0, 1]) < 4.0 / math.sqrt(20_000)
    assert noise.gaussian(8, 123, 1) != values[1, 123]
    assert noise.disturbance(0.0, 7, 1, 1) == 0.0


def test_the_linkage_agrees_with_the_hand_calculation_wherever_the_hinge_is() -> None:
    vehicle = suv()
    link = gate.linkage(vehicle.gate)
    assert link.closed_length == pytest.approx(0.457411, abs=5e-7)
    assert link.stroke == pytest.approx(0.253945, abs=5e-7)
    assert math.degrees(link.offset) == pytest.approx(28.969, abs=5e-4)
    assert gate.inertia(vehicle.gate, link) == pytest.approx(10.5467, abs=5e-5)
    moved = vehicle.gate._replace(
        hinge=(1.0, 2.0), gate_point=(1.085, 1.82), body_point=(0.96, 1.38), gravity_point=(1.30, 1.55)
    )
    assert gate.linkage(moved) == pytest.approx(link, rel=1e-12)
