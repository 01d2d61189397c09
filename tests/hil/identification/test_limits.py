"""Estimates stay within what the checks of a vehicle file allow."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, minimize

from liftgate_hil.config.parameters import find_parameter, with_value
from liftgate_hil.config.vehicle import issues_with
from liftgate_hil.identification.data import Data
from liftgate_hil.identification.descent import place_at
from liftgate_hil.identification.fit import NothingToTellError, fitted
from liftgate_hil.identification.limits import step_within_limits
from liftgate_hil.identification.problem import Problem
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.vehicle import Vehicle
from tests.hil.identification.simulated import measured, sought
from tests.plant.runs import suv

ENERGY = 2.0 * math.pi / 1.01  # speed constant over torque constant, at least


def strong(factor: float = 1.03):
    """A vehicle whose motor constants make energy, as a current or speed of wrong scale would suggest."""
    vehicle = suv()
    constant = factor * vehicle.left.motor.speed_constant / (2.0 * math.pi)
    return with_value(vehicle, find_parameter(vehicle, "motor.torque_constant"), constant)


def checked(vehicle: Vehicle, names: list[str], data: Data) -> Problem:
    """A problem whose search is limited to vehicles that a vehicle file may hold."""
    known = sought(names, vehicle)
    return Problem(vehicle, "third-order", known, [data], [*data.outputs], 20.0, refused_by=issues_with)


@pytest.mark.parametrize("seed", range(30))
def test_a_step_minimizes_within_bounds_and_half_spaces(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, limits = int(rng.integers(2, 6)), int(rng.integers(1, 3))
    root = rng.standard_normal((count + 3, count))
    matrix, gradient = root.T @ root, root.T @ (3.0 * rng.standard_normal(count + 3))
    normals, room = rng.standard_normal((limits, count)), rng.uniform(0.0, 0.3, limits)
    low, high = -np.ones(count), np.ones(count)
    step = step_within_limits(
        matrix, gradient, low, high, np.ones(count), lambda x: bool(np.all(normals @ x <= room))
    )
    expected = minimize(
        lambda x: 0.5 * x @ matrix @ x - gradient @ x,
        np.zeros(count),
        jac=lambda x: matrix @ x - gradient,
        method="SLSQP",
        bounds=list(zip(low, high, strict=True)),
        constraints=LinearConstraint(normals, -np.inf, room),
        options={"ftol": 1e-14, "maxiter": 500},
    ).x
    assert np.all(normals @ step <= room)
    assert np.all((step >= low) & (step <= high))
    assert step == pytest.approx(expected, abs=1e-5)


def test_steps_end_at_the_nearest_point_of_a_curved_limit() -> None:
    """From inside a circle to its point nearest to the unconstrained step."""
    goal, radius = np.array([3.0, 1.0]), 0.8
    x, far = np.zeros(2), np.full(2, 9.0)
    for _ in range(8):
        is_inside = lambda step, x=x: bool(np.linalg.norm(x + step) <= radius)  # noqa: E731
        x = x + step_within_limits(np.eye(2), goal - x, -far, far, np.ones(2), is_inside)
    assert x == pytest.approx(radius * goal / np.linalg.norm(goal), abs=1e-3)
    assert np.linalg.norm(x) <= radius


def test_a_step_is_shortened_to_what_is_allowed_where_the_limit_has_no_gradient() -> None:
    """Only a step of zero is allowed, so that the check shows no direction."""
    step = step_within_limits(np.eye(2), np.ones(2), -np.ones(2), np.ones(2), np.ones(2), lambda x: not np.any(x))
    assert step.tolist() == [0.0, 0.0]


def test_the_estimated_motor_constants_do_not_create_energy() -> None:
    vehicle, names = suv(), ["motor.torque_constant", "motor.speed_constant", "motor.resistance"]
    data = measured(strong(), seed=1)
    problem = checked(vehicle, names, data)
    result = fitted(problem)
    torque, speed, resistance = result.parameters
    assert speed.value / torque.value >= ENERGY
    assert speed.value / torque.value == pytest.approx(ENERGY, rel=1e-5)
    for each in (torque, speed):
        assert each.identifiable
        assert "held with others at a limit for valid vehicles" in each.remark
        assert "makes energy" in each.remark
    assert not resistance.remark
    found = vehicle
    for each in result.parameters:
        found = with_value(found, find_parameter(found, each.name), each.value)
    assert issues_with(found) == []
    # It is the best of those along the limit: a search in that one direction ends there too.
    along = [(speed.value * by / ENERGY, speed.value * by, resistance.value) for by in (1.0, 0.99, 1.01)]
    least, *others = (place_at(problem, np.array(point), None).deviance for point in along)
    assert least < min(others)


def test_an_identification_of_a_single_motor_constant_at_its_limit_is_refused() -> None:
    vehicle = suv()
    data = measured(strong(), seed=1)
    with pytest.raises(NothingToTellError, match=r"at a limit for valid vehicles: .* energy"):
        fitted(checked(vehicle, ["motor.torque_constant"], data))


def test_the_check_of_the_gates_inertia_limits_the_search_too() -> None:
    """Any check of a vehicle counts: here that of its inertia, which must fit its mass and its length."""
    vehicle = vehicle_from("suv")
    parameter = find_parameter(vehicle, "gate.inertia")
    low = 0.1 * vehicle.gate.mass * 0.540833**2  # kg m², below which it is refused
    start = with_value(vehicle, parameter, 1.2 * low)
    light = with_value(vehicle, parameter, 0.5 * low)
    data = measured(light, noise={"gate_angle_deg": 0.01, "left_current_a": 0.05}, seed=1)
    names = ["gate.inertia", "motor.resistance"]
    result = fitted(checked(start, names, data))
    inertia, resistance = result.parameters
    assert inertia.value == pytest.approx(low, rel=1e-3)
    assert inertia.value >= low * (1.0 - 1e-5)
    assert "gate.inertia" in inertia.remark
    assert not inertia.identifiable
    assert resistance.identifiable


def test_a_search_from_a_vehicle_that_the_checks_refuse_is_an_error() -> None:
    with pytest.raises(ValueError, match="makes energy"):
        fitted(checked(strong(), ["motor.resistance"], measured(suv(), seed=1)))


def test_limits_that_are_not_reached_change_neither_steps_nor_number_of_simulations() -> None:
    """The unlimited search has equal estimates and as many simulations."""
    problem = checked(suv(), ["motor.resistance"], measured(suv("motor.resistance=0.8"), seed=2))
    free = dataclasses.replace(problem, refused_by=lambda vehicle: ())
    one, other = fitted(problem), fitted(free)
    assert one.parameters == other.parameters
    assert one.evaluations == other.evaluations
