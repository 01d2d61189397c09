"""Descent by bounded steps: its result and its number of simulations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from liftgate_hil.identification.descent import descend, place_at
from liftgate_hil.identification.limits import within
from tests.hil.identification.simulated import TRUTH, measured, true_vehicle
from tests.hil.identification.test_search import problem


@pytest.mark.parametrize("seed", range(40))
def test_a_step_of_the_descent_is_the_bounded_least_squares_solution(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 7))
    root = rng.standard_normal((count + 3, count)) * 10.0 ** rng.uniform(-3, 3, count)
    target = rng.standard_normal(count + 3)
    size = 1.0 / np.sqrt(np.diag(root.T @ root))
    low, high = (-size * rng.choice([0.0, 0.3, 9.0], count), size * rng.choice([0.0, 0.3, 9.0], count))
    high = np.where(high == low, high + 0.1 * size, high)
    expected = lsq_linear(root, target, (low, high), method="bvls").x
    step = within(root.T @ root, root.T @ target, low, high)
    assert step / size == pytest.approx(expected / size, abs=1e-7)
    assert np.all((step >= low) & (step <= high))


def test_a_descent_takes_few_simulations_and_its_loss_never_rises() -> None:
    one = problem([*TRUTH], [measured(true_vehicle(), seed=1)])
    end = descend(one, place_at(one, one.initial, None), range(5), None, 100)
    assert end.stop_reason.startswith("converged")
    # Four sets of one-sided slopes and one of central ones, and a trial for each step.
    assert one.evaluations <= 45
    assert np.all(np.diff(end.history) < 0.0)
    assert place_at(one, end.point, None).deviance == end.deviance


def test_a_descent_that_runs_out_of_iterations_is_reported() -> None:
    one = problem([*TRUTH], [measured(true_vehicle(), seed=1)])
    end = descend(one, place_at(one, one.initial, None), range(5), None, 1)
    assert end.stop_reason == "not converged after 1 iterations"
    assert len(end.history) == 2
