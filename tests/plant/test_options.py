"""Options that the reference SUV leaves off, and quantities derived from a state, in the whole plant."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from liftgate_plant import dynamics, gate, integrate, obstacle, sensors
from liftgate_plant.bridge import DriveInput
from liftgate_plant.dynamics import State
from liftgate_plant.faults import SOUND
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.signals import Sensed
from liftgate_plant.vehicle import Vehicle, load_of, plant_of
from tests.plant.runs import COAST, OPEN, at_rest, column, fast_run, inputs, load, state_of, suv

CALM = settings(deadline=None, derandomize=True, database=None, max_examples=60)
STEP = 1e-3
ROUND_OFF = 1e-9  # relative; a thousand steps in double precision
TORQUE_CONSTANT, SPEED_CONSTANT, RESISTANCE = 0.0122, 0.0769, 0.708
KAPPA = 0.010 / 29 / (2.0 * math.pi)  # N m of the motor per N of the spindle
COULOMB = 0.18 * 0.00124 + 0.25 * 0.6 / 29 + 0.15 * 1000 * KAPPA

# The motor reaches the gate through nothing; heat would take years to change its temperatures.
ALONE = (
    "mechanism.stiffness=0",
    "mechanism.damping=0",
    "thermal.winding_capacity=1e5",
    "thermal.housing_capacity=1e6",
)


def run_to(vehicle: Vehicle, state: State, drive: DriveInput, seconds: float, **changes) -> State:
    given_inputs = inputs(vehicle, drive, **changes)
    steps = round(seconds / STEP)
    return state_of(fast_run(plant_of(vehicle), state, given_inputs, STEP, steps)[-1])


def with_drives(state: State, **changes: float) -> State:
    return state._replace(left=state.left._replace(**changes), right=state.right._replace(**changes))


# The motor.


@pytest.mark.parametrize("ambient", [-30.0, 20.0, 50.0])
@pytest.mark.parametrize("duty", [1.0, -0.6])
def test_an_unloaded_motor_runs_at_the_balance_of_torque_and_voltage(duty: float, ambient: float) -> None:
    """U = R i + c2Φ n and c1Φ i = (τ_C + d |n|) k: cold, viscous friction and a warm motor at once."""
    vehicle = suv(
        *ALONE,
        "friction.viscous=5e-5",
        "friction.temperature_coefficient=0.01",
        "thermal.enabled=1",
        f"environment.ambient_temperature_degc={ambient}",
    )
    warm = with_drives(at_rest(vehicle, 40.0), winding_temperature=100.0, housing_temperature=70.0)
    end = run_to(vehicle, warm, DriveInput(duty, 0.0, 0.0), 3.0).left
    flux = 1.0 - 0.001 * (70.0 - 20.0)
    cold = 1.0 + 0.01 * (20.0 - ambient)
    friction = cold * (math.copysign(COULOMB, duty) + 5e-5 * end.speed)
    # Temperatures move by 1e-4 K in these seconds: 1e-6 of the resistance, and the start has died out.
    assert flux * TORQUE_CONSTANT * end.current == pytest.approx(friction, rel=1e-5)
    resistance = RESISTANCE * (1.0 + 0.00393 * 80.0)
    volts = resistance * end.current + flux * SPEED_CONSTANT * end.speed
    assert volts == pytest.approx(12.0 * duty, rel=1e-5)


def test_static_friction_holds_up_to_its_level_then_sliding_has_coulomb_friction() -> None:
    vehicle = suv(*ALONE, "friction.static_ratio=1.5")
    start = at_rest(vehicle, 40.0)
    volts = 1.5 * COULOMB / TORQUE_CONSTANT * RESISTANCE
    held = run_to(vehicle, start, DriveInput(0.0, 0.99 * volts, 0.0), 0.5)
    assert held.left.speed == 0.0
    assert held.left.position == start.left.position
    slid = run_to(vehicle, start, DriveInput(0.0, 1.01 * volts, 0.0), 3.0)
    # Once it slides, the current is that of Coulomb's friction.
    assert TORQUE_CONSTANT * slid.left.current == pytest.approx(COULOMB, rel=1e-6)


def test_a_blocked_motor_warms_up_to_the_temperature_at_which_its_loss_is_dissipated() -> None:
    """U²/R(T) = (T − T_ambient)/(R_wh + R_ha): a quadratic in the rise over 20 °C."""
    vehicle = suv(
        "spindle.friction_force=1e5",  # nothing turns it
        "thermal.enabled=1",
        "thermal.winding_capacity=0.5",
        "thermal.housing_capacity=1",
        "environment.ambient_temperature_degc=-20",
    )
    end = run_to(vehicle, at_rest(vehicle, 40.0), DriveInput(0.0, 2.0, 0.0), 400.0).left
    outward, alpha = 18.0, 0.00393
    loss = 2.0**2 / RESISTANCE
    # (θ + 40)(1 + α θ) = loss · outward with θ = T − 20 °C.
    b = 1.0 + 40.0 * alpha
    rise = (-b + math.sqrt(b * b - 4.0 * alpha * (40.0 - loss * outward))) / (2.0 * alpha)
    assert end.winding_temperature == pytest.approx(20.0 + rise, abs=1e-3)  # 20 time constants
    resistance = RESISTANCE * (1.0 + alpha * rise)
    assert end.current == pytest.approx(2.0 / resistance, rel=1e-5)
    flow = end.current**2 * resistance
    assert end.housing_temperature == pytest.approx(-20.0 + 14.0 * flow, abs=1e-2)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_motor_that_coasts_faster_than_the_source_charges_it_through_the_diodes(direction: float) -> None:
    vehicle = suv(*ALONE, "bridge.diode_drop=0.9")
    start = with_drives(at_rest(vehicle, 40.0), speed=direction * 150.0)
    end = run_to(vehicle, start, COAST, STEP, supply_voltage=6.0).left
    beyond = direction * SPEED_CONSTANT * end.speed - (6.0 + 2.0 * 0.9)
    # The step is 16 time constants of the winding; its lag behind the falling EMF is 0.3 %.
    assert direction * end.current == pytest.approx(-beyond / RESISTANCE, rel=0.01)
    slower = run_to(vehicle, start, COAST, STEP, supply_voltage=12.0).left
    assert slower.current == 0.0
    assert abs(end.speed) < abs(slower.speed)


def test_load_dependent_friction_holds_a_larger_force() -> None:
    """At the limit the spindle's force F has κ F = τ_C + μ κ F."""
    share = 0.3
    vehicle = suv(f"spindle.load_friction={share}")
    plant = plant_of(vehicle)
    settled = run_to(vehicle, at_rest(vehicle, 45.0), COAST, 3.0)
    arm = gate.lever(plant.link, settled.gate_angle)
    held = 2.0 * COULOMB / KAPPA / (1.0 - share) * arm
    own = dynamics.smooth_torque(plant, load(vehicle), settled.gate_angle)
    for sign in (1.0, -1.0):
        breakaway = sign * held - own
        # The pulled gate gives way by some 0.1°, which changes both torques by less than 1 %; a step of
        # torque overshoots on the mechanism's spring, so it is put on in ten parts.
        for factor, moves in ((0.97, False), (1.03, True)):
            state = settled
            for part in range(1, 11):
                torque = 0.1 * part * factor * breakaway
                state = run_to(vehicle, state, COAST, 0.4, external_torque=torque)
            moved = abs(state.left.position - settled.left.position)
            assert (moved > 0.05) is moves, f"{sign}, {factor}: {moved} rev"


# The gate and what acts on it.


def test_an_inertia_in_the_vehicle_file_replaces_that_of_a_plate() -> None:
    assert plant_of(suv("gate.inertia=20")).gate_inertia == pytest.approx(20.0, rel=1e-9)


@CALM
@given(
    angle=st.floats(0.05, 1.39),
    slope=st.floats(-0.2, 0.2),
    snow=st.floats(0.0, 60.0),
    wind=st.floats(-200.0, 200.0),
    hand=st.floats(-100.0, 100.0),
    other=st.floats(-50.0, 50.0),
)
def test_weight_snow_wind_and_hand_torques_add_up(angle, slope, snow, wind, hand, other) -> None:
    """Each torque is calculated once more from the numbers of the file."""
    vehicle = suv("environment.snow_distance=0.6", "environment.wind_area=1.5")
    plant = plant_of(vehicle)
    around = load(
        vehicle, road_slope=slope, snow_mass=snow, wind_pressure=wind, hand_force=hand, external_torque=other
    )
    towards = math.atan2(-0.45, 0.30)
    weight = 9.81 * (28.0 * math.hypot(0.30, 0.45) + snow * 0.6) * math.cos(angle + towards + slope)
    extended = gate.extension(plant.link, angle)
    springs = 2.0 * (330.0 + 900.0 * (plant.link.stroke - extended)) * gate.lever(plant.link, angle)
    expected = springs - weight + wind * 1.5 * 0.5 + hand * 0.9 + other
    found = dynamics.smooth_torque(plant, around, angle)
    assert found == pytest.approx(expected, rel=ROUND_OFF, abs=ROUND_OFF)


def test_the_vehicle_files_surroundings_act_as_load() -> None:
    around = load_of(
        suv(
            "environment.snow_mass=12",
            "environment.wind_pressure=34",
            "environment.hand_force=-56",
            "environment.road_slope_deg=7",
            "environment.ambient_temperature_degc=-8",
            "supply.voltage=13.5",
        )
    )
    forces = (around.snow_mass, around.wind_pressure, around.hand_force)
    assert forces == pytest.approx((12.0, 34.0, -56.0), rel=1e-9)
    assert math.degrees(around.road_slope) == pytest.approx(7.0)
    assert around.ambient_temperature == pytest.approx(-8.0, rel=1e-9)
    assert around.supply_voltage == pytest.approx(13.5, rel=1e-9)


# Outputs.


@CALM
@given(
    angle_deg=st.floats(-0.05, 80.05),
    rate=st.one_of(st.just(0.0), st.floats(0.01, 0.5), st.floats(-0.5, -0.01)),
    speed=st.floats(-100.0, 100.0),
    snow=st.floats(0.0, 40.0),
    direction=st.sampled_from([1.0, -1.0]),
)
def test_the_displayed_acceleration_agrees_with_a_short_step(angle_deg, rate, speed, snow, direction) -> None:
    """Also in either stop, in the seal, under snow, with hinge friction and with a rod in the way."""
    vehicle = suv("gate.hinge_friction=12", "gear.backlash=0.03")
    plant = plant_of(vehicle)
    state = at_rest(vehicle, angle_deg)
    state = with_drives(state, speed=speed, position=state.left.position + 0.4)._replace(gate_rate=rate)
    rod = Obstacle(math.radians(40.0) + 0.02 * direction, 0.9, 2e4, 50.0, 0.001, direction)
    given_inputs = inputs(vehicle, OPEN, snow_mass=snow, obstacle=rod)
    extended = gate.extension(plant.link, state.gate_angle)
    touching = (extended, extended - plant.link.stroke, extended - 1e-3, obstacle.depth(rod, state.gate_angle))
    assume(min(abs(depth) for depth in touching) > 1e-6)  # not just where a contact begins
    shown = dynamics.outputs(plant, state, given_inputs).gate_acceleration
    step = 1e-8
    after = integrate.step(plant, state, given_inputs, step)
    # In 10 ns rate and depths change by less than 1e-6; the difference has a round-off of 1e-7 rad/s².
    assert (after.gate_rate - rate) / step == pytest.approx(shown, rel=1e-4, abs=1e-3)


def test_the_displayed_motor_voltage_is_that_at_the_motor() -> None:
    vehicle = suv("supply.internal_resistance=0.05", "bridge.diode_drop=0.6")
    plant = plant_of(vehicle)
    base = at_rest(vehicle, 40.0)

    def shown(drive: DriveInput, **changes: float) -> float:
        state = base._replace(left=base.left._replace(**changes))
        return dynamics.outputs(plant, state, inputs(vehicle, drive, OPEN)).left_voltage

    assert shown(DriveInput(-0.5, 0.0, 0.0)) == pytest.approx(-6.0)
    # 12 V less 0.05 Ω times the share of the current that the bridge takes from the source.
    assert shown(DriveInput(0.5, 0.0, 0.0), current=8.0) == pytest.approx(0.5 * (12.0 - 0.2))
    assert shown(DriveInput(0.0, 3.0, 0.0)) == pytest.approx(3.0, rel=1e-9)
    assert shown(COAST, speed=100.0) == pytest.approx(7.69)
    assert shown(COAST, current=5.0) == pytest.approx(-13.2)
    assert shown(COAST, current=-5.0) == pytest.approx(13.2)


def test_a_missing_drive_shows_no_voltage() -> None:
    vehicle = suv("drives=1")
    state = with_drives(at_rest(vehicle, 40.0), speed=50.0)
    assert dynamics.outputs(plant_of(vehicle), state, inputs(vehicle, COAST)).right_voltage == 0.0


def test_a_warm_coasting_motor_shows_its_weaker_emf() -> None:
    vehicle = suv("thermal.enabled=1")
    state = with_drives(at_rest(vehicle, 40.0), speed=100.0, housing_temperature=120.0)
    shown = dynamics.outputs(plant_of(vehicle), state, inputs(vehicle, COAST)).left_voltage
    assert shown == pytest.approx(0.9 * 7.69)


# Sensors in the whole.


def sensed(vehicle: Vehicle, rows: np.ndarray, step: float) -> list[Sensed]:
    plant, given_inputs = plant_of(vehicle), inputs(vehicle, OPEN, road_slope=0.1)
    memory = sensors.initial_sensors(vehicle.sensors, state_of(rows[0]))
    readings = []
    for tick, row in enumerate(rows[1:], start=1):
        state = state_of(row)
        outputs, flow = dynamics.outputs(plant, state, given_inputs), integrate.resting(state)
        view = sensors.View(state, given_inputs, outputs, flow)
        when = sensors.tick_of(vehicle.sensors, 1, tick, step)
        memory, reading = sensors.sense(vehicle.sensors, SOUND, plant, view, memory, when)
        readings.append(reading)
    return readings


def test_the_sensed_hall_speed_is_the_whole_counts_per_sample_period() -> None:
    vehicle = suv("sensors.hall_sample_period=0.005")
    rows = fast_run(plant_of(vehicle), at_rest(vehicle, 30.0), inputs(vehicle, OPEN), STEP, 300)
    readings = sensed(vehicle, rows, STEP)
    counts = [0, *(round(reading.left_hall_count) - round(4.0 * rows[0][2]) for reading in readings)]
    for tick in range(5, 300):
        last = tick - tick % 5
        assert readings[tick - 1].left_hall_speed == counts[last] - counts[last - 5]
    # 5 ms at some 150 rev/s with 4 counts each.
    assert readings[-1].left_hall_speed == pytest.approx(0.005 * 4.0 * rows[-1][1], abs=1.0)


def test_the_gates_accelerometer_senses_motion_and_gravity() -> None:
    vehicle = suv("sensors.acceleration_distance=0.7", "sensors.angle_offset_deg=1.5")
    rows = fast_run(plant_of(vehicle), at_rest(vehicle, 30.0), inputs(vehicle, OPEN), STEP, 25)
    reading = sensed(vehicle, rows, STEP)[-1]
    plant, state = plant_of(vehicle), state_of(rows[-1])
    given_inputs = inputs(vehicle, OPEN, road_slope=0.1)
    rate = dynamics.outputs(plant, state, given_inputs).gate_acceleration
    assert abs(rate) > 0.1
    weight = 9.81 * math.cos(state.gate_angle + math.atan2(-0.45, 0.30) + 0.1)
    assert reading.gate_acceleration_mps2 == pytest.approx(0.7 * rate + weight, rel=ROUND_OFF)
    assert reading.gate_angle_deg == pytest.approx(math.degrees(state.gate_angle) + 1.5)
    assert reading.road_slope_deg == pytest.approx(math.degrees(0.1))
    assert reading.left_current_a == column(rows, "left_current")[-1]
