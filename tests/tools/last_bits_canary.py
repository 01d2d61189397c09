"""Tests that depend on the last bits, for `test_last_bits.py`: they pass without LAST_BITS and fail with it."""

from __future__ import annotations

import numpy as np
from scipy.integrate import RK45, solve_ivp

from liftgate_hil.identification import descent
from tests.hil.identification.simulated import measured
from tests.hil.identification.test_problem import of
from tests.plant.runs import OPEN, inputs, plant_of, suv, tables
from tests.reference.event_solution import DriveInput, Phase, solve


def test_the_exact_value_of_a_plant_constant() -> None:
    assert plant_of(suv("gate.inertia=20")).gate_inertia == 20.0


def test_the_exact_value_of_a_load() -> None:
    assert inputs(suv(), OPEN).load.supply_voltage == 12.0


def test_the_exact_value_of_an_input() -> None:
    assert inputs(suv(), OPEN, external_torque=0.3).load.external_torque == 0.3


def test_the_exact_value_of_a_measured_sample() -> None:
    data = measured(suv(), seed=1)
    assert np.array_equal(of([data], []).measured[:, 0], data.outputs["left_current_a"])


def test_the_exact_value_of_an_event_solution() -> None:
    still = DriveInput("voltage", 0.0)
    at = solve(tables(), [Phase(1e-3, still, still)], np.zeros(1), initial_angle=0.7).angle[0]
    assert at == 0.7


def test_the_exact_end_of_a_search() -> None:
    assert descent.STILL == 5e-3


def test_the_exact_number_of_steps_of_a_solver() -> None:
    """The number of steps depends on the solver's tolerance."""
    seen = solve_ivp(lambda t, y: -y, (0.0, 9.0), [1.0], rtol=1e-10, atol=1e-13).t
    usual, steps = RK45(lambda t, y: -y, 0.0, np.ones(1), 9.0, rtol=1e-10, atol=1e-13), 0
    while usual.status == "running":
        usual.step()
        steps += 1
    assert len(seen) == steps + 1
