"""Friction over the spindle's travel, over a drive's life and between runs."""

import math

import numpy as np
import pytest

from liftgate_compiler import compiled
from liftgate_hil import load_vehicle
from liftgate_plant import integrate
from liftgate_plant.dynamics import NOMINAL, Frictions
from liftgate_plant.friction_profile import LEAST, FrictionProfile, factor_at, friction_profile, frictions_in
from liftgate_plant.initial import initial_state
from liftgate_plant.vehicle import Vehicle, plant_of
from tests.plant.runs import OPEN, inputs

STROKE = plant_of(load_vehicle("suv")).link.stroke


def ideal(*keys: str) -> Vehicle:
    return load_vehicle("suv", keys, ideal=True)


def profile_of(vehicle: Vehicle, seed: int = 0) -> FrictionProfile:
    return friction_profile(vehicle, plant_of(vehicle), seed)


def factors_at(profile: FrictionProfile, drive: int, places: np.ndarray) -> np.ndarray:
    look_up = compiled(factor_at)
    return np.array([look_up(profile, drive, float(each)) for each in places])


def test_without_profile_options_friction_is_nominal():
    profile = profile_of(ideal(), seed=5)
    assert profile.factor.tolist() == [[1.0], [1.0]]
    assert (factors_at(profile, 1, np.array([-1.0, 0.1, 1.0, math.nan])) == 1.0).all()


def test_a_friction_table_covers_the_travel_and_is_constant_beyond_its_ends():
    profile = profile_of(ideal("friction.position_table=[[0, 1.2], [0.5, 0.8], [1, 2]]"))
    shares = np.array([-0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 3.0])
    expected = [1.2, 1.2, 1.0, 0.8, 1.4, 2.0, 2.0]
    for drive in (0, 1):
        assert factors_at(profile, drive, shares * STROKE) == pytest.approx(expected, abs=2e-3)
    assert 1.19 < factors_at(profile, 0, np.array([math.nan]))[0] < 1.21


def test_the_random_part_of_friction_has_its_specified_deviation_and_correlation():
    length, deviation = 0.02, 0.1
    places = np.linspace(0.0, STROKE, 300)
    apart = length / (places[1] - places[0])
    first, second, third = [], [], []
    for number in range(250):
        keys = {"deviation": deviation, "length": length, "profile": number}
        own = profile_of(ideal(*(f"friction.position_{key}={value}" for key, value in keys.items())))
        values = (factors_at(own, 0, places) - 1.0) / deviation
        first.append(values)
        second.append(np.interp(np.arange(200) + apart, np.arange(300), values))
        third.append((factors_at(own, 1, places) - 1.0) / deviation)
    left, right = np.array(first), np.array(third)
    assert left.std() == pytest.approx(1.0, abs=0.04)
    assert abs(left.mean()) < 0.05
    assert np.mean(left[:, :200] * np.array(second)) == pytest.approx(math.exp(-1.0), abs=0.05)
    assert abs(np.mean(left * right)) < 0.05  # each drive has its own


def test_a_profile_number_gives_the_same_profile_on_any_gate():
    keys = ["friction.position_deviation=0.2", "friction.position_profile=3"]
    suv, compact = (profile_of(load_vehicle(name, keys, ideal=True)) for name in ("suv", "compact"))
    places = np.linspace(0.0, 0.15, 400)
    assert factors_at(suv, 0, places) == pytest.approx(factors_at(compact, 0, places), abs=1e-3)
    other = profile_of(ideal(keys[0], "friction.position_profile=4"))
    assert np.abs(factors_at(suv, 0, places) - factors_at(other, 0, places)).max() > 0.1


def test_an_eccentric_spindle_loads_the_drive_once_per_turn():
    vehicle = ideal("friction.eccentricity=0.3")
    places = np.linspace(0.0, STROKE, 5000)
    values = factors_at(profile_of(vehicle), 0, places) - 1.0
    lead = vehicle.left.spindle.lead
    wave = np.exp(-2j * math.pi * places / lead)
    turns = int(STROKE / lead) * lead
    whole = places < turns
    assert 2.0 * abs(np.mean(values[whole] * wave[whole])) == pytest.approx(0.3, rel=0.01)
    assert np.ptp(values) == pytest.approx(0.6, rel=0.01)


def test_friction_falls_by_running_in_and_rises_by_wear_over_the_cycles():
    def factor(cycles: float) -> float:
        keys = {"run_in": 0.4, "run_in_cycles": 100, "wear": 0.02, "cycles": cycles}
        vehicle = ideal(*(f"friction.{key}={value}" for key, value in keys.items()))
        return float(profile_of(vehicle).factor[0, 0])

    assert factor(0.0) == pytest.approx(1.4)
    assert factor(100.0) == pytest.approx(1.0 + 0.4 / math.e + 0.002)
    assert factor(10000.0) == pytest.approx(1.2)


def test_friction_factors_of_runs_scatter_by_the_stated_deviation_and_repeat_with_their_seed():
    vehicle = ideal("friction.run_deviation=0.05")
    factors = np.array([profile_of(vehicle, seed).factor[:, 0] for seed in range(2000)])
    assert factors.mean() == pytest.approx(1.0, abs=0.004)
    assert factors.std() == pytest.approx(0.05, rel=0.05)
    assert abs(np.corrcoef(factors.T)[0, 1]) < 0.07
    assert profile_of(vehicle, 3).factor.tolist() == profile_of(vehicle, 3).factor.tolist()


def test_friction_factors_stay_at_or_above_their_minimum():
    vehicle = ideal("friction.eccentricity=0.9", "friction.position_deviation=0.5")
    assert profile_of(vehicle).factor.min() >= LEAST


def test_a_friction_factor_of_two_equals_doubled_friction_torques():
    suv = ideal("friction.viscous=1e-5")
    doubled = plant_of(suv)
    laws = [d.friction._replace(coulomb=2 * d.friction.coulomb, viscous=2e-5) for d in doubled[:2]]
    doubled = doubled._replace(
        left=doubled.left._replace(friction=laws[0]), right=doubled.right._replace(friction=laws[1])
    )
    step = compiled(integrate.step)
    one = two = initial_state(doubled, 0.3)
    for _ in range(400):
        one = step(doubled, one, inputs(suv, OPEN), 1e-3)
        given = inputs(suv, OPEN)._replace(frictions=Frictions(2.0, 2.0))
        two = step(plant_of(suv), two, given, 1e-3)
    assert one == two
    assert Frictions(1.0, 1.0) == NOMINAL


def test_the_friction_factor_of_a_step_is_that_at_its_middle():
    """Second order: a fifth of the step, a twenty-fifth of the error."""
    vehicle = ideal("friction.eccentricity=0.8", "friction.position_deviation=0.1")
    plant = plant_of(vehicle)
    profile = friction_profile(vehicle, plant, 0)
    look_up, step = compiled(frictions_in), compiled(integrate.step)

    def end(count: int) -> float:
        h, state = 1.0 / count, initial_state(plant, 0.3)
        for _ in range(count):
            given = inputs(vehicle, OPEN)._replace(frictions=look_up(profile, plant, state, h))
            state = step(plant, state, given, h)
        return state.left.position

    exact = end(50_000)
    coarse, fine = abs(end(400) - exact), abs(end(2000) - exact)
    assert fine < coarse / 12.0
