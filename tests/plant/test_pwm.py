"""Currents of a bridge that switches, against a simulation that follows every switch and diode."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from liftgate_compiler import compiled
from liftgate_hil import Gate, load_vehicle
from liftgate_plant import current, integrate
from liftgate_plant.bridge import DriveInput
from liftgate_plant.current import NO_SWITCHING, CurrentPath
from liftgate_plant.dynamics import Plant, State, outputs
from liftgate_plant.initial import initial_state
from liftgate_plant.pwm import Chopper, course
from liftgate_plant.vehicle import Vehicle, plant_of
from tests.plant.runs import inputs
from tests.reference.switched_bridges import Bridge, periodic
from tools.accuracy.bridges import Point, apart, compared, point, vehicle_at

U, DROP = 12.0, 0.7
R, L, C2 = 0.708, 4.37e-5, 0.0769


class Switched(NamedTuple):
    """Values of the simulation's last PWM period."""

    mean: float
    rms: float
    peak: float
    drawn: float


def switched(mode: str, duty: float, frequency: float, emf: float, supply: float = U) -> Switched:
    """Simulate L di/dt = u − R i − e in small steps, with ideal transistors and diodes that block."""
    period = 1.0 / frequency
    count = 4_000  # steps in a period
    h = period / count
    along, emf = math.copysign(1.0, duty), emf * math.copysign(1.0, duty)
    on = round(abs(duty) * count)
    decay = math.exp(-R / L * h)
    i, values, source = 0.0, np.empty(count), np.empty(count)
    for _ in range(max(3, math.ceil(10.0 * L / R / period))):
        for k in range(count):
            if k < on:
                u, share = supply, 1.0
            elif mode == "slow":
                u, share = 0.0, 0.0
            elif mode == "diode":
                u, share = (-DROP, 0.0) if i > 0.0 else (supply + DROP, 1.0)
            else:
                u = -(supply + 2 * DROP) if i > 0.0 else supply + 2 * DROP
                share = -1.0 if i > 0.0 else 1.0
            final = (u - emf) / R
            after = final + (i - final) * decay
            if k >= on and mode != "slow":
                if i == 0.0:
                    holds = emf if mode == "fast" else max(emf, 0.0)
                    low = -DROP if mode == "diode" else -(supply + 2 * DROP)
                    high = supply + (DROP if mode == "diode" else 2 * DROP)
                    if low <= holds <= high:
                        after = 0.0
                elif after * i < 0.0:
                    after = 0.0
            values[k] = 0.5 * (i + after)
            source[k] = share * values[k]
            i = after
    furthest = values[np.argmax(np.abs(values))]
    return Switched(along * values.mean(), math.sqrt(np.mean(values**2)), along * furthest, source.mean())


POINTS = [
    # freewheeling, duty, frequency [Hz], EMF [V]
    ("slow", 0.5, 20e3, 5.0),
    ("slow", 0.3, 10e3, 4.0),
    ("slow", -0.8, 20e3, -8.0),
    ("slow", 0.5, 5e3, 7.0),  # generates
    ("diode", 0.6, 20e3, 5.0),
    ("diode", 0.6, 5e3, 6.5),
    ("diode", 0.4, 10e3, 5.0),  # discontinuous
    ("diode", 0.2, 20e3, 4.0),  # discontinuous
    ("diode", -0.3, 20e3, -6.0),  # discontinuous
    ("diode", 0.5, 10e3, 12.3),  # driven beyond the supply
    ("fast", 0.8, 20e3, 4.0),
    ("fast", 0.6, 20e3, 5.0),  # discontinuous
    ("fast", 0.9, 5e3, 9.0),  # discontinuous
    ("fast", -0.3, 10e3, -6.0),  # discontinuous
    ("fast", 0.5, 10e3, 13.0),  # driven beyond the supply
    ("fast", 0.7, 20e3, -3.0),  # turned against the duty
]


@pytest.fixture(scope="module")
def heavy() -> Vehicle:
    """A vehicle whose rotors are so heavy that their speed is constant."""
    return load_vehicle("suv", ["motor.rotor_inertia=1.0", "bridge.diode_drop=0.7"], ideal=True)


def turning_at(plant: Plant, emf: float) -> State:
    state = initial_state(plant, 0.5)
    turning = state.left._replace(speed=emf / C2)
    return state._replace(left=turning, right=turning)


@pytest.mark.parametrize(("mode", "duty", "frequency", "emf"), POINTS)
@pytest.mark.parametrize("step", [1e-4, 1e-3])
def test_mean_rms_and_peak_agree_with_the_switched_current(
    heavy: Vehicle, mode: str, duty: float, frequency: float, emf: float, step: float
):
    own = heavy.left._replace(bridge=heavy.left.bridge._replace(pwm_frequency=frequency, freewheeling=mode))
    vehicle = heavy._replace(left=own, right=own)
    plant = plant_of(vehicle)
    state = turning_at(plant, emf)
    given = inputs(vehicle, DriveInput(duty, 0.0, 0.0))
    advance = compiled(integrate.advance)
    for _ in range(math.ceil(2e-3 / step)):
        state, flow = advance(plant, state, given, step)
    expected = switched(mode, duty, frequency, C2 * state.left.speed)
    path = flow.left
    assert state.left.current == pytest.approx(expected.mean, rel=0.01, abs=2e-3)
    assert path.mean == pytest.approx(expected.mean, rel=0.01, abs=2e-3)
    assert current.effective(path, step) == pytest.approx(expected.rms, rel=0.01)
    assert current.peak(path, step) == pytest.approx(expected.peak, rel=0.01)
    drawn = path.switching.drawn * path.mean + path.switching.drawn_beside
    assert drawn == pytest.approx(expected.drawn, rel=0.01, abs=2e-3)
    shown = outputs(plant, state, given)
    assert shown.left_voltage == pytest.approx(R * expected.mean + C2 * state.left.speed, abs=0.02)


@pytest.mark.parametrize("number", [*range(24), 217])  # a diode that conducts while the other sags
def test_currents_and_terminal_voltage_behind_a_source_resistance_agree_with_switching(number: int):
    """A short version of `make accuracy`, which tries three hundred."""
    found = apart(number)
    assert found.is_met, (found, point(number))
    assert found.terminal < 0.01


def test_the_terminal_voltage_is_its_mean_over_a_period_with_slow_freewheeling_too():
    """Between two pulses the current turns back through the transistors, and the source sees nothing of it."""
    bridge = Bridge("slow", 0.5, 2e3, 5.4)
    exact = periodic([bridge, bridge], 12.0, 0.05)
    assert exact.terminal < 11.8  # where the duty's share of the mean current would give 11.96
    found = compared(0, Point([bridge, bridge], 12.0, 0.05), 1e-3)
    assert found.terminal < 1e-3


@pytest.mark.parametrize("mode", ["slow", "diode", "fast"])
def test_bridges_of_two_frequencies_affect_each_other_by_their_mean_currents(mode: str):
    left, right = Bridge(mode, 0.6, 19e3, 4.0), Bridge(mode, -0.8, 7e3, -5.0)
    exact = periodic([left, right], 12.0, 0.2, repeats=1e-3)
    found = compared(0, Point([left, right], 12.0, 0.2), 1e-3, repeats=1e-3)
    assert found.is_met, (found, exact)
    assert found.terminal < 0.02


def test_a_switched_bridge_lowers_the_terminal_voltage_of_an_averaged_one():
    """The equation of the averaged bridge: d (U − R_s drawn) = R i + e, with the current drawn by both."""
    vehicle = vehicle_at(Point([Bridge("diode", 0.4, 5e3, 5.0)] * 2, 12.0, 0.2))
    mean = vehicle.right._replace(bridge=vehicle.right.bridge._replace(pwm_frequency=0.0))
    vehicle = vehicle._replace(right=mean)
    plant, advance = plant_of(vehicle), compiled(integrate.advance)
    state = turning_at(plant, 5.0)
    given = inputs(vehicle, DriveInput(0.4, 0.0, 0.0), DriveInput(0.7, 0.0, 0.0))
    for _ in range(5):
        state, flow = advance(plant, state, given, 1e-3)
    drawn = flow.left.switching.drawn * flow.left.mean + flow.left.switching.drawn_beside
    terminal = 12.0 - 0.2 * (drawn + 0.7 * state.right.current)
    assert 0.7 * terminal == pytest.approx(R * state.right.current + C2 * state.right.speed)
    assert outputs(plant, state, given).terminal_voltage == pytest.approx(terminal, abs=1e-4)
    beside = periodic([Bridge("diode", 0.4, 5e3, 5.0)], 12.0 - 0.14 * state.right.current, 0.2)
    assert state.left.current == pytest.approx(beside.currents[0].mean, rel=1e-3)


def test_the_source_current_is_finite_where_a_motors_mean_current_is_zero():
    """A motor that idles under a PWM without freewheeling diodes draws and brakes in turn."""
    bridge = Bridge("slow", 0.5, 2e3, 6.0)
    assert periodic([bridge], 12.0, 0.0).currents[0].mean == pytest.approx(0.0, abs=1e-9)
    found = compared(0, Point([bridge], 12.0, 0.0), 1e-3)
    assert found.drawn < 1e-3
    assert periodic([bridge], 12.0, 0.0).currents[0].drawn > 2.0


@pytest.mark.parametrize(("mode", "duty", "frequency", "emf"), POINTS)
def test_the_slopes_of_the_mean_current_are_its_derivatives(mode: str, duty: float, frequency: float, emf: float):
    kind = float(("slow", "diode", "fast").index(mode))
    chopper = Chopper(kind, 1.0 / frequency, DROP, R, L)
    duty, emf, d = abs(duty), emf * math.copysign(1.0, duty), 1e-5
    now = course(chopper, duty, U, emf)
    by_emf = course(chopper, duty, U, emf + d).mean - course(chopper, duty, U, emf - d).mean
    by_supply = course(chopper, duty, U + d, emf).mean - course(chopper, duty, U - d, emf).mean
    assert now.by_emf == pytest.approx(by_emf / (2 * d), rel=1e-4, abs=1e-9)
    assert now.by_supply == pytest.approx(by_supply / (2 * d), rel=1e-4, abs=1e-9)


def test_energy_is_conserved_over_a_pwm_period():
    """The source's energy less the losses of diodes and winding drives the motor."""
    for mode in (1.0, 2.0):
        for emf in (1.0, 4.0, 7.0, 11.0):
            chopper = Chopper(mode, 1e-4, 0.0, R, L)
            now = course(chopper, 0.5, U, emf)
            losses = R * (now.ripple + now.mean**2)
            assert U * now.drawn == pytest.approx(emf * now.mean + losses, rel=1e-9, abs=1e-9)


def test_ripple_current_warms_the_winding():
    def warmed(frequency: float) -> float:
        keys = ["thermal.enabled=1", f"bridge.pwm_frequency={frequency}"]
        vehicle = load_vehicle("suv", keys, ideal=True)
        plant = plant_of(vehicle)
        state: State = initial_state(plant, 0.3)
        step = compiled(integrate.step)
        given = inputs(vehicle, DriveInput(0.5, 0.0, 0.0))
        for _ in range(1500):
            state = step(plant, state, given, 1e-3)
        return state.left.winding_temperature

    mean, slow, quick = warmed(0.0), warmed(2000.0), warmed(50_000.0)
    ripple = course(Chopper(0.0, 1 / 2000.0, DROP, R, L), 0.5, U, 5.8).ripple
    assert slow - mean == pytest.approx(R * ripple * 1.5 / 4.0, rel=0.2)
    assert 0.0 < quick - mean < 0.01 * (slow - mean)


def test_the_peak_current_is_never_below_the_rms_for_any_bridge_commands():
    """Duties that change their sign each tick leave current and ripple on both sides of zero."""
    for mode in ("slow", "diode", "fast"):
        keys = ["bridge.pwm_frequency=10000", f"bridge.freewheeling={mode}"]
        vehicle = load_vehicle("suv", keys, ideal=True)
        plant, advance = plant_of(vehicle), compiled(integrate.advance)
        for step in (1e-3, 1e-4):
            state = initial_state(plant, 0.5)
            for k in range(300):
                given = inputs(vehicle, DriveInput(0.6 * (-1.0) ** k, 0.0, 0.0))
                state, flow = advance(plant, state, given, step)
                rms = current.effective(flow.left, step)
                assert abs(current.peak(flow.left, step)) >= rms * (1.0 - 1e-9)


@pytest.mark.parametrize(("mode", "duty"), [("fast", 0.4), ("diode", 0.4), ("fast", 0.8)])
def test_low_side_shunts_measure_the_current_of_the_source(mode: str, duty: float):
    keys = ["bridge.pwm_frequency=20000", f"bridge.freewheeling={mode}"]
    keys += ["supply.internal_resistance=0.1", "sensors.shunt_low_side=1"]
    with Gate(vehicle="suv", settings=keys, ideal=True, initial=20.0) as gate:
        gate.command(left_duty=100 * duty, right_duty=100 * duty, direction="open")
        gate.step(1.0)
        seen = gate.sensed["left_current_a"] + gate.sensed["right_current_a"]
        assert seen > 0.0
        fall = 12.0 - gate.truth["terminal_voltage_v"]
        assert fall == pytest.approx(0.1 * seen, rel=0.02, abs=1e-4)


def test_a_shunt_sampled_in_the_on_time_shows_the_on_time_current():
    keys = ["bridge.pwm_frequency=20000", "bridge.freewheeling=diode"]
    keys += ["sensors.shunt_low_side=1", "sensors.shunt_sampled_on=1"]
    with Gate(vehicle="suv", settings=keys, ideal=True, initial=20.0) as gate:
        gate.command(left_duty=30, right_duty=30, direction="open")
        gate.step(1.5)
        emf = C2 * gate.truth["left_speed_rps"]
        now = course(Chopper(1.0, 5e-5, DROP, R, L), 0.3, 12.0, emf)
        assert now.low == 0.0  # discontinuous
        assert gate.sensed["left_current_a"] == pytest.approx(now.on, rel=0.01)
        assert now.on * 0.3 == pytest.approx(now.drawn)


def test_a_shunt_carries_the_whole_current_of_a_voltage_driven_motor():
    vehicle = load_vehicle("suv", ideal=True)
    plant = plant_of(vehicle)
    state = initial_state(plant, 0.5)
    _, flow = compiled(integrate.advance)(plant, state, inputs(vehicle, DriveInput(0.0, -6.0, 0.0)), 1e-3)
    assert flow.left.switching.drawn == flow.left.switching.while_on == -1.0


@pytest.mark.parametrize("emf", [0.0, 12.0, -0.7])
def test_a_pwm_current_without_a_driving_voltage_is_finite(emf: float):
    for supply in (0.0, 12.0):
        for drop in (0.0, 0.7):
            for period in (1e-6, 1e-3, 0.077):
                for mode in (0.0, 1.0, 2.0):
                    for duty in (1e-6, 0.4, 1.0 - 1e-6):
                        now = course(Chopper(mode, period, drop, R, L), duty, supply, emf)
                        assert all(math.isfinite(each) for each in now)


@pytest.mark.parametrize(
    "path",
    [
        CurrentPath(0.0, 14.0, 0.0, -16.0, 1.62e4, NO_SWITCHING),
        CurrentPath(3.0, 1.0, 2.0, 0.0, 1.62e4, NO_SWITCHING),
        CurrentPath(5.0, -2.0, 0.0, 4.0, 3e3, NO_SWITCHING),
        CurrentPath(-5.0, 2.0, 0.0, -7.0, 900.0, NO_SWITCHING),
    ],
)
def test_rms_and_peak_of_a_current_path_agree_with_the_current_over_time(path: CurrentPath):
    step = 1e-3
    times = np.linspace(0.0, step, 200_001)
    first = path.start - path.amplitude
    last = path.end - path.amplitude * math.exp(-path.decay * step)
    course_of = first + (last - first) * times / step + path.amplitude * np.exp(-path.decay * times)
    path = path._replace(mean=float(np.trapezoid(course_of, times) / step))
    rms = math.sqrt(np.trapezoid(course_of**2, times) / step)
    assert current.effective(path, step) == pytest.approx(rms, rel=1e-6)
    furthest = course_of[np.argmax(np.abs(course_of))]
    assert current.peak(path, step) == pytest.approx(furthest, rel=1e-6)
