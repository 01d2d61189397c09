"""First-order sensitivity indices, against functions whose indices are known."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from liftgate_hil.campaigns.reporting.summary import classes_of, first_order, rest_of
from liftgate_hil.campaigns.space import shares_of

A, B = 7.0, 0.1  # of Ishigami and Homma (1990), as in Saltelli et al. (2008)


def ishigami(x: np.ndarray) -> np.ndarray:
    return np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0])


def ishigami_indices() -> dict[str, float]:
    """Return the first-order indices of the Ishigami function by their formulas."""
    first = 0.5 * (1.0 + B * math.pi**4 / 5.0) ** 2
    second = A**2 / 8.0
    total = A**2 / 8.0 + B * math.pi**4 / 5.0 + B**2 * math.pi**8 / 18.0 + 0.5
    return {"x1": first / total, "x2": second / total, "x3": 0.0}


@pytest.mark.parametrize("method", ["sobol", "lhs", "random"])
def test_indices_of_the_ishigami_function_are_found(method: str) -> None:
    x = math.pi * (2.0 * shares_of(3, 8192, method, 1) - 1.0)
    found = {each.name: each.first_order for each in first_order(named(x), ishigami(x))}
    for name, expected in ishigami_indices().items():
        # Classes of 1/24 of the range lose some of x2, whose sine has four arches in it.
        assert found[name] == pytest.approx(expected, abs=0.025)


def named(x: np.ndarray) -> dict[str, np.ndarray]:
    return {f"x{k + 1}": each for k, each in enumerate(x.T)}


def grid(*counts: int) -> np.ndarray:
    return np.array(list(itertools.product(*(range(each) for each in counts))), dtype=float)


def test_indices_of_an_additive_function_on_a_grid_equal_its_analysis_of_variance() -> None:
    x = grid(4, 5, 3)
    noise = 0.2 * np.random.default_rng(2).standard_normal(len(x))
    y = 3.0 * x[:, 0] - x[:, 1] ** 2 + 0.5 * x[:, 2] + noise
    for each in first_order(named(x), y):
        column = x[:, int(each.name[1]) - 1]
        levels = np.unique(column)
        groups = [y[column == level] for level in levels]
        between = sum(len(group) * (group.mean() - y.mean()) ** 2 for group in groups)
        within = sum(((group - group.mean()) ** 2).sum() for group in groups)
        error = within / (len(y) - len(levels))
        omega = (between - (len(levels) - 1) * error) / (between + within + error)
        assert each.first_order == pytest.approx(max(omega, 0.0), abs=1e-12)


def test_a_function_of_one_value_is_explained_by_that_value_alone() -> None:
    x = grid(5, 6)
    first, second = first_order(named(x), x[:, 1] ** 3)
    assert (first.name, first.first_order) == ("x2", pytest.approx(1.0))
    assert (second.name, second.first_order) == ("x1", 0.0)
    assert rest_of([first, second]) == pytest.approx(0.0, abs=1e-12)


def test_a_pure_interaction_has_first_order_indices_of_0() -> None:
    x = grid(10, 10)
    indices = first_order(named(x), (x[:, 0] - 4.5) * (x[:, 1] - 4.5))
    assert [each.first_order for each in indices] == [0.0, 0.0]
    assert rest_of(indices) == 1.0


def test_values_without_an_effect_have_indices_near_0_on_average() -> None:
    generator = np.random.default_rng(3)
    shares = []
    for _ in range(50):
        x = generator.random((400, 2))
        shares += [each.first_order for each in first_order(named(x), generator.standard_normal(400))]
    assert np.mean(shares) < 0.02  # 24 classes without the correction for chance: 0.06


def test_indices_are_sorted_by_size_and_a_constant_value_has_none() -> None:
    x = grid(4, 4, 4)
    indices = first_order({"fixed": np.full(64, 7.0), **named(x)}, x @ [1.0, 5.0, 2.0])
    assert [each.name for each in indices] == ["x2", "x3", "x1"]


def test_unknown_and_infinite_results_are_left_out() -> None:
    x = grid(5, 6)
    y = x @ [1.0, 2.0]
    known = first_order(named(x), y)
    unknown = np.concatenate([y, np.full(30, math.nan)])
    assert first_order(named(np.vstack([x, x])), unknown) == known
    infinite = np.append(y, [math.inf, -math.inf])
    assert first_order(named(np.vstack([x, [[0.0, 0.0], [4.0, 5.0]]])), infinite) == known


@pytest.mark.parametrize("y", [*(np.full(60, each) for each in (0.0, 0.1, 2.0, 400.3, math.nan)), np.zeros(0)])
def test_constant_results_have_no_indices(y: np.ndarray) -> None:
    assert first_order({"x": np.arange(float(len(y))) % 5.0}, y) == []


def test_fewer_than_20_results_have_no_indices() -> None:
    x = np.arange(19.0) % 4.0
    assert first_order({"x": x}, x) == []
    assert first_order({"x": np.append(x, 0.0)}, np.append(x, 0.0)) != []


def test_an_index_has_the_lowest_and_highest_class_means_and_the_value_of_the_highest() -> None:
    x = grid(3, 10)
    y = np.array([5.0, 20.0, 10.0])[x[:, 0].astype(int)]
    index = first_order({"x": 100.0 * x[:, 0]}, y)[0]
    assert (index.low_mean, index.high_mean, index.at_high) == (5.0, 20.0, 100.0)


def test_few_distinct_values_are_a_class_each_and_many_are_divided_into_classes_of_equal_count() -> None:
    generator = np.random.default_rng(1)
    own, many, few = (
        classes_of(each)
        for each in (np.array([3.0, 1.0, 3.0, 2.0]), generator.lognormal(0.0, 3.0, 2400), generator.random(50))
    )
    assert own is not None
    assert own.tolist() == [2.0, 0.0, 2.0, 1.0]
    assert many is not None
    assert np.unique(many, return_counts=True)[1].tolist() == [100] * 24
    assert few is not None
    assert np.unique(few, return_counts=True)[1].min() >= 8  # enough members
