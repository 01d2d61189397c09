"""The reference solution itself: hand checks, closed forms, laws and tolerances."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest
from event_solution import DriveInput, Geometry, Obstacle, Phase, Solution, StimulusPlan, solve

SUV: dict[str, Any] = {
    "drives": 2,
    "motor": {
        "resistance": 0.708,
        "inductance": 4.37e-5,
        "rotor_inertia": 1.28e-5,
        "torque_constant": 0.0122,
        "speed_constant": 0.0769,
        "efficiency": 0.82,
        "load_torque": 0.00124,
    },
    "gear": {"ratio": 29, "inertia": 2.0e-6, "efficiency": 0.75, "friction_torque": 0.6, "backlash": 0.01},
    "spindle": {"lead": 0.010, "efficiency": 0.85, "friction_force": 1000},
    "spring": {"stiffness": 900, "preload": 330, "stop_stiffness": 2.0e6, "stop_damping": 8000},
    "gate": {
        "mass": 28,
        "length": 1.0,
        "thickness": 0.1,
        "open_angle_deg": 80,
        "hinge": [0, 0],
        "gate_point": [0.085, -0.18],
        "body_point": [-0.04, -0.62],
        "gravity_point": [0.30, -0.45],
        "hinge_friction": 0,
    },
    "seal": {"force": 200, "stiffness": 2.0e5, "arm": 0.9},
    "mechanism": {"stiffness": 5.0e5, "damping": 4000},
    "supply": {"voltage": 12, "internal_resistance": 0},
    "environment": {"road_slope_deg": 0},
}
BRAKE, COAST = DriveInput("brake"), DriveInput("coast")
OPEN, CLOSE = DriveInput("open", 1.0), DriveInput("close", 1.0)
WINDING_TIME = 4.37e-5 / 0.708
AT_HOME = 1e-9  # rad: ten times the tolerance of `solve`; a gate that comes home moves 1e-4 a sample


@pytest.fixture
def suv() -> dict[str, Any]:
    return copy.deepcopy(SUV)


def both(end: float, command: DriveInput, **more: Any) -> Phase:
    return Phase(end, command, command, **more)


def columns(solution: Solution) -> dict[str, np.ndarray]:
    return {key: value for key, value in vars(solution).items() if key != "events"}


def test_derived_constants_agree_with_hand_calculations(suv: dict[str, Any]) -> None:
    geometry = Geometry(suv["gate"])
    stimuli = StimulusPlan(suv, [suv], geometry, both(1.0, BRAKE), 0.0)
    (drive,) = stimuli.drives
    assert drive.shaft.limit is not None
    assert f"{drive.shaft.limit(geometry.view(0.0, [0.0] * 5)):.6f}" == "0.013628"
    assert f"{geometry.inertia:.4f}" == "10.5467"
    assert f"{geometry.closed_length:.6f}" == "0.457411"
    assert f"{geometry.open_travel:.6f}" == "0.253945"
    assert f"{math.degrees(geometry.theta):.3f}" == "28.969"
    assert 2 * drive.half_play == pytest.approx(1e-4, rel=1e-12)


def test_the_gates_inertia_can_be_specified(suv: dict[str, Any]) -> None:
    suv["gate"]["inertia"] = 7.5
    assert Geometry(suv["gate"]).inertia == 7.5


def test_the_reference_solution_reproduces_the_table_of_an_opening(suv: dict[str, Any]) -> None:
    times = np.array([0.002, 0.050, 0.200, 1.0, 3.0, 5.0, 6.0])
    s = solve(suv, [both(6.0, OPEN)], times, tolerance=1e-9)
    rows = [
        f"{i:.3f} {n:.2f} {math.degrees(a):.3f}"
        for i, n, a in zip(s.left_current, s.left_speed, s.angle, strict=True)
    ]
    assert rows == [
        "16.468 4.58 0.003",
        "7.223 89.62 0.781",
        "0.647 150.10 3.472",
        "0.255 153.70 18.387",
        "0.886 147.88 49.028",
        "1.484 142.39 80.018",
        "16.949 0.00 80.602",
    ]
    assert s.left_current[-1] == pytest.approx(12 / 0.708, rel=1e-9)
    assert s.left_speed[-1] == 0.0
    np.testing.assert_allclose(s.right_current, s.left_current, rtol=0, atol=1e-9)
    np.testing.assert_allclose(s.right_position, s.left_position, rtol=0, atol=1e-9)


def test_the_current_of_a_blocked_rotor_has_its_closed_form(suv: dict[str, Any]) -> None:
    suv["spindle"]["friction_force"] = 1e6  # nothing moves the rotor
    times = np.linspace(0.0, 2e-3, 201)
    phases = [both(1e-3, OPEN), both(2e-3, BRAKE)]
    s = solve(suv, phases, times, initial_angle=0.7)
    top = 12 / 0.708
    rise = top * -np.expm1(-times / WINDING_TIME)
    held = top * -math.expm1(-1e-3 / WINDING_TIME) * np.exp((1e-3 - times) / WINDING_TIME)
    np.testing.assert_allclose(s.left_current, np.where(times < 1e-3, rise, held), atol=1e-8)
    assert np.all(s.left_speed == 0.0)
    assert np.ptp(s.left_position) == 0.0


def test_currents_of_blocked_rotors_behind_a_source_resistance_have_their_closed_form(suv: dict[str, Any]) -> None:
    """Both currents drop the voltage for both: R + 2 R_source seen from each at full duty."""
    suv["spindle"]["friction_force"] = 1e6
    suv["supply"]["internal_resistance"] = 0.05
    times = np.linspace(0.0, 1e-3, 101)
    s = solve(suv, [both(1e-3, CLOSE)], times, initial_angle=0.7)
    total = 0.708 + 2 * 0.05
    expected = -12 / total * -np.expm1(-times * total / 4.37e-5)
    np.testing.assert_allclose(s.left_current, expected, atol=1e-8)
    np.testing.assert_allclose(s.terminal_voltage, 12 + 2 * 0.05 * expected, atol=1e-8)


def test_a_coasting_current_reaches_exactly_zero(suv: dict[str, Any]) -> None:
    """Blocked rotor: decay towards −V/R through the diodes until the current is used up."""
    suv["spindle"]["friction_force"] = 1e6
    times = np.linspace(0.0, 2e-3, 2001)
    s = solve(suv, [both(1e-3, OPEN), both(2e-3, COAST)], times, initial_angle=0.7)
    start, pull = 12 / 0.708 * -math.expm1(-1e-3 / WINDING_TIME), (12 + 1.4) / 0.708
    end = 1e-3 + WINDING_TIME * math.log((start + pull) / pull)
    decay = (start + pull) * np.exp((1e-3 - times) / WINDING_TIME) - pull
    during = (times >= 1e-3) & (times < end)
    np.testing.assert_allclose(s.left_current[during], decay[during], atol=1e-8)
    assert np.all(s.left_current[times > end] == 0.0)


def test_a_coasting_motor_conducts_only_if_its_emf_exceeds_the_supply(suv: dict[str, Any]) -> None:
    times = np.linspace(0.0, 1.2, 1201)
    phases = [both(1.0, OPEN), both(1.1, COAST), both(1.2, COAST, supply_voltage=6.0)]
    s = solve(suv, phases, times)
    off = (times > 1.001) & (times < 1.1)
    assert np.all(s.left_current[off] == 0.0)
    assert s.left_speed[1099] > 10  # still turning: only the back-EMF is too low to conduct
    emf = 0.0769 * s.left_speed[1101]
    assert (s.left_current[1101] < 0.0) == (emf > 6.0 + 1.4)
    assert emf > 6.0 + 1.4, "the case is meant to conduct"


def test_an_open_gate_left_alone_stays(suv: dict[str, Any]) -> None:
    """The gate sinks into the play, then the stuck shafts hold it: exactly stopped, no creep."""
    times = np.linspace(0.0, 3.0, 121)
    s = solve(suv, [both(3.0, COAST)], times, initial_angle=math.radians(40))
    assert np.all(s.left_speed == 0.0)
    assert np.all(s.left_current == 0.0)
    assert np.ptp(s.left_position) == 0.0
    assert abs(math.degrees(s.angle[-1]) - 40) < 0.2
    settled = times > 1.5
    assert np.ptp(s.angle[settled]) < 1e-9
    assert np.abs(s.rate[settled]).max() < 1e-9


def test_hinge_friction_holds_exactly_until_it_is_exceeded(suv: dict[str, Any]) -> None:
    suv["gate"]["hinge_friction"] = 60.0
    at = math.radians(40)
    free = solve(suv, [both(0.3, BRAKE)], np.array([0.0, 0.3]), initial_angle=at)
    assert free.angle[0] == pytest.approx(at, rel=1e-12)
    assert free.angle[1] == free.angle[0]
    assert free.rate[1] == 0.0
    phases = [both(0.1, BRAKE), both(0.3, BRAKE, external_torque=200.0)]
    pulled = solve(suv, phases, np.array([0.0, 0.05, 0.3]), initial_angle=at)
    assert pulled.angle[1] == pulled.angle[0]
    assert pulled.angle[2] > at + 1e-6


def test_energy_is_conserved_without_losses(suv: dict[str, Any]) -> None:
    """A gate swinging in an elastic gear, no friction: kinetic + potential energy stays."""
    for table in ("motor", "gear", "spindle"):
        suv[table]["efficiency"] = 1.0
    suv["mechanism"]["damping"] = 0.0
    suv["gear"]["backlash"] = 0.0
    suv["motor"]["torque_constant"] = suv["motor"]["speed_constant"] = 0.0
    times = np.linspace(0.0, 0.5, 101)
    at = math.radians(40)
    s = solve(suv, [both(0.5, BRAKE)], times, initial_angle=at, tolerance=1e-11)
    geometry = Geometry(suv["gate"])
    travel = np.array([geometry.length(a) for a in s.angle]) - geometry.closed_length
    stretch = s.left_position * 0.010 / 29 - travel
    inertia = 1.28e-5 + 2.0e-6 / 29**2
    spring = 330 * travel + 900 * (geometry.open_travel * travel - travel**2 / 2)
    energy = (
        geometry.inertia * s.rate**2 / 2
        + 2 * inertia * (2 * math.pi * s.left_speed) ** 2 / 2
        + 2 * 5.0e5 * stretch**2 / 2
        - 2 * spring
        + geometry.weight_moment * np.sin(s.angle + geometry.weight_angle)
    )
    assert np.ptp(s.angle) > 1e-3
    assert np.ptp(energy) < 1e-6


def test_forces_of_play_and_obstacle_obey_their_laws_at_every_sample(suv: dict[str, Any]) -> None:
    """Forces in the located regime equal those by max() and min() of the laws of play and obstacle."""
    suv["right"] = {"gear": {"friction_torque": 0.9, "backlash": 0.03}}
    rod = Obstacle(math.radians(30), 0.9, 2.0e4, damping=50.0, gap=0.002)
    times = np.linspace(0.0, 2.5, 5001)
    phases = [both(0.4, OPEN, external_torque=-150.0), both(0.8, COAST), both(2.5, CLOSE, obstacle=rod)]
    s = solve(suv, phases, times, initial_angle=math.radians(35))
    geometry, advance = Geometry(suv["gate"]), 0.010 / 29
    views = [geometry.view(0.0, pair) for pair in zip(s.angle, s.rate, strict=True)]
    travel = np.array([v.middle.travel for v in views])
    travel_rate = np.array([v.middle.travel_rate for v in views])
    for side, half in (("left", 0.5e-4), ("right", 1.5e-4)):
        x = getattr(s, f"{side}_position") * advance - travel
        rate = getattr(s, f"{side}_speed") * advance - travel_rate
        upper = np.where(x > half, np.maximum(0.0, 5e5 * (x - half) + 4000 * rate), 0.0)
        lower = np.where(x < -half, np.minimum(0.0, 5e5 * (x + half) + 4000 * rate), 0.0)
        np.testing.assert_allclose(getattr(s, f"{side}_force"), upper + lower, atol=1e-5)
        assert upper.max() > 0 > lower.min()
    depth = (math.radians(30) - s.angle) * 0.9 - 0.002
    law = np.where(depth > 0, np.maximum(0.0, 2e4 * depth - 50.0 * 0.9 * s.rate), 0.0)
    law[times < 0.8] = 0.0
    np.testing.assert_allclose(s.pinch_force, law, atol=1e-5)
    assert s.pinch_force.max() > 100.0


def test_solutions_of_different_tolerances_agree_over_a_whole_cycle(suv: dict[str, Any]) -> None:
    phases = [both(6.5, OPEN), both(7.5, BRAKE), both(14.0, CLOSE)]
    times = np.linspace(0.0, 14.0, 1401)
    coarse = solve(suv, phases, times, tolerance=1e-7)
    fine = solve(suv, phases, times, tolerance=1e-9)
    assert coarse.events == fine.events
    rms = math.sqrt(float(np.mean((coarse.left_current - fine.left_current) ** 2)))
    assert rms < 1e-7
    assert np.degrees(np.abs(coarse.angle - fine.angle)).max() < 1e-6
    assert fine.left_current[-1] == pytest.approx(-12 / 0.708, abs=1e-6)  # stalled closed
    assert fine.left_speed[-1] == 0.0


def test_two_unlike_drives_have_their_own_currents(suv: dict[str, Any]) -> None:
    """Both free-running halves obey their own static balance, and the gate joins the speeds."""
    suv["right"] = {"motor": {"resistance": 0.8}, "gear": {"friction_torque": 0.9}}
    s = solve(suv, [both(2.0, OPEN)], np.array([1.9, 2.0]))
    assert abs(s.left_current[1] - s.right_current[1]) > 0.05
    assert s.left_speed[1] == pytest.approx(s.right_speed[1], rel=1e-3)
    for current, speed, resistance in (
        (s.left_current[1], s.left_speed[1], 0.708),
        (s.right_current[1], s.right_speed[1], 0.8),
    ):
        assert current == pytest.approx((12 - 0.0769 * speed) / resistance, abs=1e-3)
    one = solve(suv, [Phase(0.5, OPEN, BRAKE)], np.array([0.5]))
    assert one.left_current[0] > 1.0 > one.right_current[0]


def test_a_voltage_input_equals_a_bridge_on_an_ideal_source(suv: dict[str, Any]) -> None:
    times, fine = (np.linspace(0.0, 0.5, 51), 1e-12)  # a mechanism of 5e5 N/m magnifies the solver's error
    bridge = solve(suv, [both(0.5, DriveInput("close", 0.5))], times, math.radians(50), fine)
    suv["supply"]["internal_resistance"] = 0.3  # must not matter to the voltage mode
    volts = solve(suv, [both(0.5, DriveInput("voltage", -6.0))], times, math.radians(50), fine)
    for key, value in columns(bridge).items():
        np.testing.assert_allclose(columns(volts)[key], value, rtol=0, atol=1e-7, err_msg=key)


def test_with_one_drive_the_right_columns_are_zero(suv: dict[str, Any]) -> None:
    suv["drives"] = 1
    suv["spring"] = {**suv["spring"], "stiffness": 1800, "preload": 660}
    s = solve(suv, [both(1.0, OPEN)], np.array([0.5, 1.0]))
    assert s.angle[1] > math.radians(10)
    for key in ("right_current", "right_speed", "right_position", "right_force"):
        assert np.all(columns(s)[key] == 0.0)


def test_the_latch_catches_a_gate_at_home_and_lets_go_when_released(suv: dict[str, Any]) -> None:
    times = np.linspace(0.0, 2.5, 2501)
    phases = [both(1.5, CLOSE, released=False), both(2.0, BRAKE, released=False), both(2.5, OPEN)]
    s = solve(suv, phases, times, math.radians(5.0))
    # The first sample after it was caught: on the way to it the gate moves, from then on it rests.
    home = int(np.argmax(s.angle < AT_HOME))
    assert 100 < home < 1400
    assert s.rate[home - 1] < -0.05
    assert np.all(s.angle[home:2001] == 0.0)
    assert np.all(s.rate[home:2001] == 0.0)
    assert s.left_current[1499] == pytest.approx(-12 / 0.708, rel=1e-6)  # stalled against it
    assert s.angle[-1] > math.radians(2.0)
    free = solve(suv, [both(1.5, CLOSE)], times[:1501], math.radians(5.0))
    assert free.angle[-1] < math.radians(-0.1)


def test_the_temperature_of_a_winding_has_its_closed_form(suv: dict[str, Any]) -> None:
    """A blocked rotor, copper without temperature dependence, a housing that hardly warms up."""
    suv["spindle"]["friction_force"] = 1e6
    suv["thermal"] = {"enabled": 1.0, "copper_coefficient": 0.0, "housing_capacity": 1e6}
    times = np.linspace(0.0, 5.0, 51)
    s = solve(suv, [both(5.0, OPEN)], times, initial_angle=0.7)
    rise = 4.0 * 12**2 / 0.708 * -np.expm1(-times / (4.0 * 4.0))
    np.testing.assert_allclose(s.left_winding_temperature - 20.0, rise, atol=5e-3)
    np.testing.assert_allclose(s.left_housing_temperature, 20.0, atol=1e-2)
    suv["thermal"]["copper_coefficient"] = 0.00393
    warm = solve(suv, [both(5.0, OPEN)], times, initial_angle=0.7)
    by_warmth = 0.708 * (1.0 + 0.00393 * (warm.left_winding_temperature - 20.0))
    np.testing.assert_allclose(warm.left_current[1:], 12.0 / by_warmth[1:], rtol=2e-5)


def test_a_shaft_breaks_away_above_static_friction_and_keeps_sliding_below_it(suv: dict[str, Any]) -> None:
    """τ_s = 1.5 τ_C: 1.3 τ_C hold it, and move it once 1.6 τ_C have."""
    suv["friction"] = {"static_ratio": 1.5}
    suv["spring"] |= {"stiffness": 0.0, "preload": 0.0}
    suv["gate"]["mass"] = 1e-3  # nothing to lift
    unit = 0.013628 * 0.708 / 0.0122  # V for τ_C at rest
    held = DriveInput("voltage", 1.3 * unit)
    phases = [both(0.1, held), both(0.2, DriveInput("voltage", 1.6 * unit)), both(0.3, held)]
    s = solve(suv, phases, np.array([0.05, 0.1, 0.2, 0.3]), initial_angle=0.7)
    assert s.left_speed[0] == s.left_speed[1] == 0.0
    assert s.left_speed[2] > 0.5
    assert s.left_speed[3] > 0.2


def test_friction_depends_on_speed_load_temperature_and_position(suv: dict[str, Any]) -> None:
    """The motor torque of a steady motion, at the shaft."""
    suv["friction"] = {
        "static_ratio": 1.4, "stribeck_speed": 40.0, "viscous": 2e-5, "temperature_coefficient": 0.01,
        "position_table": [[0.0, 1.0], [1.0, 2.0]],
    }  # fmt: skip
    suv["spindle"]["load_friction"] = 0.1
    s = solve(suv, [both(2.0, OPEN, ambient=-10.0)], np.array([1.9]))
    geometry, advance = Geometry(suv["gate"]), 0.010 / 29
    n, factor = (float(s.left_speed[0]), 1.3 * (1.0 + s.left_position[0] * advance / geometry.open_travel))
    dry = 0.013628 * (1.0 + 0.4 * math.exp(-((n / 40.0) ** 2)))
    lever = advance / (2.0 * math.pi)
    force = float(s.left_force[0])
    taken = factor * (dry + 2e-5 * n) + 0.1 * lever * abs(force) + lever * force
    assert 0.0122 * s.left_current[0] == pytest.approx(taken, rel=0.02)  # it hardly accelerates


def test_a_start_without_play_does_not_chatter(suv: dict[str, Any]) -> None:
    suv["gear"]["backlash"] = 0.0
    s = solve(suv, [both(1.0, COAST)], np.array([1.0]), initial_angle=math.radians(40))
    assert s.events < 50
    assert s.left_speed[0] == 0.0


def test_invalid_arguments_of_the_reference_solution_are_refused(suv: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="sample times"):
        solve(suv, [both(1.0, OPEN)], np.array([0.0, 1.1]))
    with pytest.raises(ValueError, match="one after the other"):
        solve(suv, [both(1.0, OPEN), both(0.5, OPEN)], np.array([0.0]))
    with pytest.raises(ValueError, match="unknown drive mode"):
        solve(suv, [both(1.0, DriveInput("hold"))], np.array([0.0]))
