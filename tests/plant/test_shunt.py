"""The current ahead of the converter: ripple and low-pass give the same reading at any tick rate."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from liftgate_compiler import compilable, compiled
from liftgate_hil import Gate
from liftgate_plant import integrate, sensors
from liftgate_plant.bridge import DriveInput
from liftgate_plant.current import NO_SWITCHING, CurrentPath, charge_at, held, part_of
from liftgate_plant.dynamics import NOMINAL, Inputs, Load, Plant, State, outputs
from liftgate_plant.faults import SOUND
from liftgate_plant.initial import initial_state
from liftgate_plant.sensors import Sensors, SensorState
from liftgate_plant.shunt import (
    Commutation,
    MeanWindow,
    Ripple,
    Turning,
    commutations,
    emf_ripple,
    ideal_ripple,
    low_passed,
    rippled,
    windowed,
)
from liftgate_plant.vehicle import plant_of
from tests.plant.runs import load, suv

CALM = settings(deadline=None, derandomize=True, database=None, max_examples=100)


def behind(signal, filtered: float, constant: float, step: float) -> float:
    """Output of a low-pass, fed with `signal` of time, at the end of a step, by quadrature."""
    share, _ = quad(
        lambda t: signal(t) * math.exp(-(step - t) / constant) / constant,
        0.0, step, epsabs=1e-11, epsrel=1e-11, limit=500,
    )  # fmt: skip
    return filtered * math.exp(-step / constant) + share


@CALM
@given(
    first=st.floats(-20, 20), last=st.floats(-20, 20), amplitude=st.floats(-20, 20), rest=st.floats(-2, 2),
    decay=st.sampled_from([100.0, 1e3, 1.62e4, 2e5]),
    constant=st.sampled_from([6.2e-5, 1e-4, 1e-3, 0.01, 0.3]),
    step=st.sampled_from([1e-5, 1e-4, 1e-3, 5e-3]),
    filtered=st.floats(-20, 20),
)  # fmt: skip
def test_a_linear_and_exponential_current_is_filtered_as_by_quadrature(
    first, last, amplitude, rest, decay, constant, step, filtered
) -> None:
    def current(time: float) -> float:
        line = first + (last - first) * time / step
        return line + rest + amplitude * math.exp(-decay * time)

    fall = decay * step
    mean = 0.5 * (first + last) + rest - amplitude * math.expm1(-fall) / fall
    start, end = first + amplitude, last + amplitude * math.exp(-fall)
    path = CurrentPath(start, end, mean, amplitude, decay, NO_SWITCHING)
    expected = behind(current, filtered, constant, step)
    assert low_passed(filtered, path, constant, step) == pytest.approx(expected, rel=1e-7, abs=1e-7)


def test_filtering_is_finite_for_any_time_constant() -> None:
    path = CurrentPath(3.0, 1.0, 1.5, 2.0, 1.62e4, NO_SWITCHING)
    for constant in (1e-9, 1e-6, 1e-3, 1.0):
        for step in (1e-5, 5e-3):
            assert math.isfinite(low_passed(0.0, path, constant, step))
    assert low_passed(0.0, held(2.0), 1e-7, 1e-3) == pytest.approx(2.0)


@CALM
@given(
    start=st.floats(-1e3, 1e3), way=st.floats(-60, 60), amplitude=st.floats(-2, 2),
    constant=st.sampled_from([6.2e-5, 1e-3, 0.01]), step=st.sampled_from([1e-5, 1e-3, 5e-3]),
)  # fmt: skip
def test_a_ripple_is_filtered_as_by_quadrature(start, way, amplitude, constant, step) -> None:
    expected = behind(lambda t: amplitude * math.cos(start + way * t / step), 0.0, constant, step)
    given = Ripple(amplitude, start, start + way)
    assert rippled(given, constant, step) == pytest.approx(expected, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("way", [0.0, 1e-9, 1e-3, 0.5, 2.0 * math.pi, 40.0])
def test_without_a_filter_a_reading_is_the_mean_of_the_ripple_over_the_tick(way: float) -> None:
    expected, _ = quad(lambda s: math.cos(0.7 + way * s), 0.0, 1.0, limit=200)
    assert rippled(Ripple(1.0, 0.7, 0.7 + way), 0.0, 1e-3) == pytest.approx(expected, abs=1e-9)


@compilable
def readings(
    plant: Plant,
    table: Sensors,
    memory: SensorState,
    state: State,
    phases: np.ndarray,
    surroundings: Load,
    step: float,
    every: int,
    out: np.ndarray,
) -> None:
    """Write every `every`-th reading of the left motor's current; a phase is duty, coast and its last step."""
    written = done = 0
    for phase in range(len(phases)):
        drive = DriveInput(phases[phase, 0], 0.0, phases[phase, 1])
        inputs = Inputs(drive, drive, surroundings, NOMINAL)
        while done < phases[phase, 2]:
            state, flow = integrate.advance(plant, state, inputs, step)
            done += 1
            shown = outputs(plant, state, inputs)
            view = sensors.View(state, inputs, shown, flow)
            when = sensors.tick_of(table, 0, done, step)
            memory, sensed = sensors.sense(table, SOUND, plant, view, memory, when)
            if done % every == 0:
                out[written] = sensed.left_current_a
                written += 1


def sensed_over_a_cycle(rate: float, sample_rate: float, **table: float) -> np.ndarray:
    """Samples of the left current sensor over a cycle: open for 6 s, coast, close."""
    vehicle = suv()
    plant = plant_of(vehicle)
    state = initial_state(plant)
    given = Sensors(**table)
    phases = np.array([[1.0, 0.0, 6.0], [0.0, 1.0, 6.5], [-1.0, 0.0, 13.0]])
    phases[:, 2] *= rate
    out = np.zeros(round(13.0 * sample_rate))
    compiled(readings)(
        plant, given, sensors.initial_sensors(given, state), state, phases, load(vehicle),
        1.0 / rate, round(rate / sample_rate), out,
    )  # fmt: skip
    return out


@pytest.mark.parametrize("ripple", [0.0, 0.1])
def test_a_filtered_reading_is_the_same_at_1_and_at_20_khz(ripple: float) -> None:
    """Over a whole cycle; measured 4.8 mA as the coasting gate bounces off the open stop, elsewhere 1.3 mA."""
    table = {"current_filter": 0.01, "ripple": ripple}
    coarse = sensed_over_a_cycle(1e3, 1e3, **table)
    fine = sensed_over_a_cycle(2e4, 1e3, **table)
    assert np.abs(coarse).max() > 10.0
    assert np.abs(coarse - fine).max() < 5e-3


def test_an_ecu_sampling_at_10_khz_counts_turns_by_the_ripple() -> None:
    """A counter of an ECU: the reading without its slow part, counted where it passes zero with hysteresis."""
    shown = sensed_over_a_cycle(1e4, 1e4, ripple=0.1)
    part = shown[10_000:30_000]  # in motion
    quick = part - np.convolve(part, np.ones(51) / 51, mode="same")
    level = 0.3 * np.std(quick[100:-100])
    count, is_up = 0, False
    for value in quick[100:-100]:
        if value > level and not is_up:
            count, is_up = count + 1, True
        elif value < -level:
            is_up = False
    vehicle = suv()
    plant = plant_of(vehicle)
    state, way = initial_state(plant), []
    drive = Inputs(DriveInput(1.0, 0.0, 0.0), DriveInput(1.0, 0.0, 0.0), load(vehicle))
    for tick in range(3000):
        if tick in (1010, 2990):
            way.append(state.left.position)
        state = integrate.step(plant, state, drive, 1e-3)
    assert count == pytest.approx(14.0 * (way[1] - way[0]), rel=2e-3)


@pytest.mark.parametrize("length", [1e-4, 3e-4, 1e-3, 7e-3])
@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_an_averaging_window_gives_the_mean_of_the_last_completed_window(length: float, step: float) -> None:
    """A path of lines and transients, compared with the integral of its current."""
    rng = np.random.default_rng(3)
    path_at = [
        CurrentPath(*rng.normal(2.0, 1.0, 3), float(rng.normal(0.0, 2.0)), 1.6e4, NO_SWITCHING) for _ in range(60)
    ]
    fine = 2000
    whole = []
    for path in path_at:
        times = (np.arange(fine) + 0.5) * step / fine
        first = path.start - path.amplitude
        last = path.end - path.amplitude * math.exp(-path.decay * step)
        line = first + (last - first) * times / step
        values = line + path.amplitude * np.exp(-path.decay * times)
        whole.append(values + path.mean - values.mean())
    values = np.concatenate(whole)
    window, still = MeanWindow(0.0, 0.0), Turning(0.0, 0.0, 0.0, 0.0)
    for k, path in enumerate(path_at, start=1):
        window = windowed(Commutation(0.0, 0.0), path, still, length, window, k * step, step)
        ended = math.floor(k * step / length + 1e-9)
        if ended:
            begin, end = (round(edge * length / step * fine) for edge in (ended - 1, ended))
            assert window.mean == pytest.approx(values[begin:end].mean(), abs=3e-3)


def test_an_averaging_window_of_whole_commutation_periods_removes_the_ripple() -> None:
    """At 100 rev/s and 14 commutations a turn a period is 1/1400 s; two thirds of one leave some ripple."""
    path = CurrentPath(3.0, 3.0, 3.0, 0.0, 1.0, NO_SWITCHING)
    rate, step = 2.0 * math.pi * 1400.0, 5e-4

    def left_of(length: float) -> float:
        window, seen = MeanWindow(0.0, 0.0), []
        for k in range(1, 200):
            turning = Turning(rate * (k - 1) * step, rate * k * step, rate, rate)
            window = windowed(Commutation(0.1, 0.0), path, turning, length, window, k * step, step)
            seen.append(abs(window.mean - 3.0))
        return max(seen[5:])

    assert left_of(1 / 1400.0) < 1e-9
    assert left_of(1 / 700.0) < 1e-9
    # The mean of 0.3 A cos over two thirds of a turn is at most 0.3 sin(2π/3) / (2π/3).
    assert left_of(1 / 2100.0) == pytest.approx(0.3 * math.sin(2.0944) / 2.0944, rel=0.01)


@pytest.mark.parametrize("part", [(0.0, 1e-3), (2e-4, 7e-4), (9e-4, 1e-3)])
def test_a_part_of_a_current_path_has_the_same_values_there(part: tuple[float, float]) -> None:
    path = CurrentPath(5.0, -2.0, 1.2, 4.0, 3e3, NO_SWITCHING)
    begin, end = part
    own = part_of(path, begin, end, 1e-3)
    times = np.linspace(begin, end, 100_001)
    first = path.start - path.amplitude
    last = path.end - path.amplitude * math.exp(-3.0)
    values = first + (last - first) * times / 1e-3 + path.amplitude * np.exp(-3e3 * times)
    rest = path.mean - charge_at(path, 1e-3, 1e-3) / 1e-3
    assert own.start == pytest.approx(values[0])
    assert own.end == pytest.approx(values[-1])
    assert own.mean == pytest.approx(np.trapezoid(values, times) / (end - begin) + rest, rel=1e-6)


@pytest.mark.parametrize(("sampled", "duty", "share"), [(0, 0.5, 0.5), (0, -0.5, -0.5), (1, -0.5, -1.0)])
def test_low_side_shunts_without_pwm_show_mean_or_on_time_current(sampled: int, duty: float, share: float) -> None:
    keys = ["sensors.shunt_low_side=1", f"sensors.shunt_sampled_on={sampled}"]
    with Gate(vehicle="suv", settings=keys, ideal=True, initial=40.0) as gate:
        way = "open" if duty > 0.0 else "close"
        gate.command(left_duty=50, right_duty=50, direction=way)
        gate.step(0.5)
        assert gate.sensed["left_current_a"] == pytest.approx(share * gate.truth["left_current_a"])
        gate.command(left_duty=0, right_duty=0, direction="brake")
        gate.step(0.03)
        assert abs(gate.truth["left_current_a"]) > 0.5
        assert gate.sensed["left_current_a"] == 0.0


@pytest.mark.parametrize(
    ("segments", "brushes", "expected"),
    [(7, 2, 14), (8, 2, 8), (12, 4, 12), (10, 4, 20), (5, 2, 10), (9, 6, 18), (2, 2, 2)],
)
def test_brushes_that_pass_segments_at_once_commutate_once(segments, brushes, expected) -> None:
    """Counted at the angles at which a brush reaches a segment."""
    passed = {
        round(turn % 1.0, 9) % 1.0
        for k in range(segments)
        for j in range(brushes)
        for turn in [j / brushes - k / segments]
    }
    assert commutations(segments, brushes) == len(passed) == expected
    assert compiled(commutations)(float(segments), float(brushes)) == expected


def rippling(settings: list[str]) -> tuple[list[float], float]:
    """Reading of the ideal SUV less the current [A], 0.2 s at 10 kHz, and its motor's speed [rev/s]."""
    with Gate(vehicle="suv", settings=settings, ideal=True, initial=30.0, rate=10e3) as gate:
        gate.command(left_duty=70, right_duty=70, direction="open")
        gate.step(0.6)
        seen = []
        for _ in range(2000):
            gate.step(1e-4)
            seen.append(gate.sensed["left_current_a"] - gate.truth["left_current_a"])
        return seen, gate.truth["left_speed_rps"]


def test_the_ripple_frequency_follows_from_segments_and_brushes() -> None:
    """12 segments and 4 brushes: 12 commutations a turn, in the spectrum of what is read at 10 kHz."""
    keys = ["sensors.commutator_ripple=1", "sensors.commutator_segments=12", "sensors.commutator_brushes=4"]
    seen, turning = rippling(keys)
    spectrum = np.abs(np.fft.rfft(np.array(seen) * np.hanning(len(seen))))
    strongest = np.fft.rfftfreq(len(seen), 1e-4)[np.argmax(spectrum)]
    assert strongest == pytest.approx(12.0 * turning, rel=0.01)


def test_ideal_commutator_ripple_agrees_with_the_emfs_fourier_series_through_r_and_l() -> None:
    """14 commutations a turn, rectified sines: the fundamental by its own Fourier integral, through R and L."""
    order, speed = 14, 120.0
    angles = np.linspace(0.0, 2.0 * math.pi / order, 200_001)
    rectified = np.cos(angles - math.pi / order)
    share = 2.0 * abs(np.trapezoid(rectified * np.exp(1j * order * angles), angles))
    share /= np.trapezoid(rectified, angles)
    assert share == pytest.approx(ideal_ripple(order), rel=1e-6)
    motor = suv().left.motor
    frequency = order * speed
    emf = share * motor.speed_constant * speed
    expected = emf / abs(motor.resistance + 2j * math.pi * frequency * motor.inductance)
    assert emf_ripple(share, motor, order, speed) == pytest.approx(expected)
    assert emf_ripple(share, motor, order, -speed) == pytest.approx(-expected)
    # In the reading: what is read at 10 kHz swings by it.
    keys = ["sensors.commutator_ripple=1"]
    seen, turning = rippling(keys)
    level = emf_ripple(share, motor, order, turning)
    # The mean over a tick of 100 µs leaves sin(π f T)/(π f T) of it.
    left = np.sinc(order * turning * 1e-4)
    assert math.sqrt(2.0) * np.std(seen) == pytest.approx(level * left, rel=0.03)
