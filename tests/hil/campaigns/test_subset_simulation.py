"""Estimation of rare failure probabilities from a few thousand margins, with intervals that hold the truth."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from liftgate_hil.campaigns.probability.subset_simulation import (
    LEAST_EVALUATIONS,
    SubsetEstimate,
    subset_simulation,
)

Floats = NDArray[np.float64]
Margin = Callable[[Floats], Floats]

RARE = 1e-4


def estimate(
    margin: Margin, dimension: int, seed: int = 0, pockets: Floats | None = None, evaluations: int = 5000
) -> SubsetEstimate:
    steps = subset_simulation(dimension, seed, pockets, evaluations)
    points = next(steps)
    while True:
        try:
            points = steps.send(margin(points))
        except StopIteration as end:
            return end.value


def half_space(probability: float) -> Margin:
    """Margin function of failures, of this probability, beyond a plane oblique to the axes."""
    distance = -norm.ppf(probability)
    return lambda points: distance - np.sum(points, axis=1) / math.sqrt(points.shape[1])


def opposite(first: float, second: float) -> Margin:
    """Margin function of failures in two pockets of given probabilities on opposite sides."""
    near, far = -norm.ppf(first), -norm.ppf(second)
    return lambda points: np.minimum(near - points[:, 0], far + points[:, 0])


def hidden(first: float, second: float) -> Margin:
    """Margin function of failures in two opposite pockets; outside the second one no margin indicates it."""
    near, far = -norm.ppf(first), -norm.ppf(second)
    return lambda points: np.where(points[:, 0] < -far, -1.0, near - points[:, 0])


def rough_places(first: float, second: float, dimension: int) -> Floats:
    """Return approximate positions of the two pockets, half a standard deviation off."""
    places = np.zeros((2, dimension))
    places[:, 0] = -norm.ppf(first), norm.ppf(second)
    places[:, 1] = 0.5, -0.5
    return places


def parabola(curvature: float) -> tuple[Margin, float]:
    """Return the margin function of failures beyond a parabola and their probability."""
    grid = np.linspace(-9.0, 9.0, 20_001)

    def probability(apex: float) -> float:
        return float(np.sum(norm.pdf(grid) * norm.sf(apex + curvature * grid**2)) * (grid[1] - grid[0]))

    apex = 3.5
    return (lambda points: apex + curvature * points[:, 0] ** 2 - points[:, 1]), probability(apex)


def holds(found: SubsetEstimate, truth: float) -> bool:
    return found.low <= truth <= found.high


def most_hold(found: list[SubsetEstimate], truth: float) -> bool:
    """Tell whether nine in ten intervals hold the truth; of 40 that do with 95 %, fewer do in one of 20 cases."""
    return sum(holds(each, truth) for each in found) >= 0.9 * len(found)


@pytest.mark.parametrize("dimension", [1, 2, 6, 10, 20])
def test_the_interval_holds_the_probability_of_a_half_space(dimension: int) -> None:
    found = [estimate(half_space(RARE), dimension, seed) for seed in range(40)]
    assert most_hold(found, RARE)
    assert {each.method for each in found} == {"importance sampling"}
    assert max(each.high / each.low for each in found) < 2.0


@pytest.mark.parametrize("probability", [0.5, 0.1, 1e-2, 1e-3, 1e-5, 1e-6])
def test_the_interval_holds_the_probability_of_frequent_and_rare_failures(probability: float) -> None:
    assert holds(estimate(half_space(probability), 6), probability)


@pytest.mark.parametrize("dimension", [2, 6])
@pytest.mark.parametrize("curvature", [0.2, -0.1, -0.2])
def test_the_interval_holds_the_probability_beyond_a_curved_limit(curvature: float, dimension: int) -> None:
    margin, truth = parabola(curvature)
    assert most_hold([estimate(margin, dimension, seed) for seed in range(40)], truth)


def test_nineteen_of_twenty_intervals_hold_the_truth_with_less_spread_than_plain_sampling() -> None:
    found = [estimate(half_space(RARE), 6, seed) for seed in range(200)]
    assert sum(holds(each, RARE) for each in found) >= 190
    variance = float(np.mean([(each.probability / RARE - 1.0) ** 2 for each in found]))
    assert (1.0 - RARE) / RARE / variance > 100.0 * max(each.evaluations for each in found)


def test_subset_simulation_replaces_importance_sampling_in_200_dimensions() -> None:
    found = [estimate(half_space(RARE), 200, seed) for seed in range(20)]
    assert {each.method for each in found} == {"subset simulation"}
    assert most_hold(found, RARE)


@pytest.mark.parametrize("share", [0.75, 0.5])
def test_pockets_on_opposite_sides_are_both_found(share: float) -> None:
    parts = share * RARE, (1.0 - share) * RARE
    found = [estimate(opposite(*parts), 6, seed, rough_places(*parts, 6)) for seed in range(40)]
    assert most_hold(found, RARE)
    assert all(each.probability == pytest.approx(RARE, rel=0.25) for each in found)


def test_a_pocket_that_no_margin_indicates_is_found_only_if_its_place_is_known() -> None:
    parts = 0.75 * RARE, 0.25 * RARE
    for seed in range(5):
        without = estimate(hidden(*parts), 6, seed)
        assert without.high < RARE
        assert without.probability == pytest.approx(parts[0], rel=0.2)
        seeded = estimate(hidden(*parts), 6, seed, rough_places(*parts, 6))
        assert holds(seeded, RARE)
        assert seeded.probability == pytest.approx(RARE, rel=0.2)


def test_four_separate_pockets_each_have_a_cell() -> None:
    distance = -norm.ppf(RARE / 4.0)
    truth = 1.0 - (1.0 - 2.0 * norm.sf(distance)) ** 2
    places = np.zeros((4, 6))
    places[[0, 1, 2, 3], [0, 0, 1, 1]] = [distance, -distance, distance, -distance]
    found = estimate(lambda points: distance - np.max(np.abs(points[:, :2]), axis=1), 6, 0, places + 0.2)
    assert holds(found, truth)
    assert {level.cell for level in found.levels} == {0, 1, 2, 3}


def test_connected_pockets_share_a_cell() -> None:
    places = np.array([[4.2, 1.0], [4.2, -1.0], [4.5, 0.0]])
    distance = -norm.ppf(RARE)
    found = [estimate(lambda points: distance - points[:, 0], 2, seed, places) for seed in range(40)]
    assert {level.cell for each in found for level in each.levels} == {0}
    assert most_hold(found, RARE)


def test_more_pockets_than_populations_are_merged_into_cells() -> None:
    places = np.random.default_rng(0).standard_normal((40, 6))
    found = estimate(half_space(RARE), 6, 0, places)
    assert len({level.cell for level in found.levels}) == 7
    assert holds(found, RARE)


@pytest.mark.parametrize("places", [np.zeros((0, 6)), np.zeros((1, 6)), np.full((1, 6), -1.5)])
def test_useless_pockets_given_in_advance_do_not_harm_the_estimate(places: Floats) -> None:
    assert holds(estimate(half_space(RARE), 6, 0, places), RARE)


def test_a_cell_without_a_failure_has_probability_0() -> None:
    # A margin that stays at 5 on the other side: no level leads anywhere there.
    distance = -norm.ppf(RARE)
    places = np.array([[4.0, 0.0, 0.0], [-4.0, 0.0, 0.0]])
    found = estimate(lambda points: np.where(points[:, 0] > 0.0, distance - points[:, 0], 5.0), 3, 0, places)
    assert [level.probability for level in found.levels if level.cell == 1] == [0.0, 0.0]
    assert holds(found, RARE)


def test_a_stepwise_margin_has_its_subset_levels_at_the_steps() -> None:
    whole = half_space(RARE)
    found = estimate(lambda points: np.floor(whole(points)), 6)
    assert holds(found, RARE)
    first = [level for level in found.levels if level.threshold == 2.0]
    # Level 2 holds all margins below 3, and not only a tenth of the points.
    expected = norm.sf(-norm.ppf(RARE) - 3.0)
    assert [level.probability for level in first] == pytest.approx([expected] * len(first), abs=0.06)
    assert all(level.threshold == round(level.threshold) for level in found.levels)


def test_a_plateau_over_most_of_the_space_does_not_hide_the_failures_below_it() -> None:
    # Two causes, each rare, must come together; nine in ten points have the one margin 2.5.
    def margin(points: Floats) -> Floats:
        one = 1.0 * (points[:, 0] > norm.isf(0.03)) + (points[:, 0] > norm.isf(0.005))
        other = 1.0 * (points[:, 1] > norm.isf(0.03)) + (points[:, 1] > norm.isf(0.01))
        return 3.5 - one - other

    found = [estimate(margin, 4, seed) for seed in range(10)]
    assert most_hold(found, 0.005 * 0.01)


def test_the_probability_of_a_pass_or_fail_margin_is_found_near_the_known_place_and_bounded_elsewhere() -> None:
    distance = -norm.ppf(RARE)

    def margin(points: Floats) -> Floats:
        return np.where(points[:, 0] > distance, -1.0, 1.0)

    found = estimate(margin, 6, 0, rough_places(RARE, RARE, 6)[:1])
    assert found.bounded
    assert found.probability == pytest.approx(RARE, rel=0.15)
    assert 0.8 * RARE < found.low < RARE < found.high < 0.01
    assert estimate(margin, 6).probability == 0.0


def test_margins_that_are_nan_are_counted_and_do_not_count_as_failures() -> None:
    whole = half_space(RARE)
    found = estimate(lambda points: np.where(points[:, 0] > points[:, 1], np.nan, whole(points)), 6)
    assert holds(found, RARE / 2.0)
    assert 0.1 < found.unknown / found.evaluations < 0.5
    nothing = estimate(lambda points: np.full(len(points), np.nan), 6)
    assert nothing.bounded
    assert nothing.unknown == nothing.evaluations
    assert estimate(whole, 6).unknown == 0


@pytest.mark.parametrize("seed", range(3))
def test_a_margin_that_never_fails_gives_an_upper_bound(seed: int) -> None:
    found = estimate(lambda points: 0.5 + np.exp(-points[:, 0]), 6, seed)
    assert (found.probability, found.low, found.bounded) == (0.0, 0.0, True)
    assert found.high < 1e-5
    assert math.isinf(found.variation)
    assert all(level.threshold >= 0.0 for level in found.levels)
    constant = estimate(lambda points: np.ones(len(points)), 6, seed)
    assert constant.bounded
    assert constant.high == pytest.approx(3.0 / constant.evaluations)


@pytest.mark.parametrize("probability", [0.999, 0.9, 0.3])
def test_frequent_failures_are_estimated_by_plain_monte_carlo(probability: float) -> None:
    found = estimate(half_space(probability), 6)
    assert found.method == "Monte Carlo"
    assert holds(found, probability)
    assert not found.bounded


def test_a_margin_that_always_fails_gives_probability_one() -> None:
    found = estimate(lambda points: np.full(len(points), -1.0), 3)
    assert (found.probability, found.high) == (1.0, 1.0)
    assert found.low > 0.99


def test_the_same_seed_gives_the_same_estimate_in_whatever_order_margins_are_evaluated() -> None:
    whole = half_space(RARE)
    places = rough_places(RARE, RARE, 6)

    def one_by_one(points: Floats) -> Floats:
        order = np.random.default_rng(len(points)).permutation(len(points))
        margins = np.empty(len(points))
        for each in order:
            margins[each] = float(rounded(points[each : each + 1])[0])
        return margins

    def rounded(points: Floats) -> Floats:
        return np.round(whole(points), 9)  # a sum of one row need not be that of many to the last bit

    assert estimate(rounded, 6, 7, places) == estimate(one_by_one, 6, 7, places)
    assert estimate(rounded, 6, 7, places).probability != estimate(rounded, 6, 8, places).probability


def test_whole_populations_are_evaluated_at_once() -> None:
    sizes = []

    def margin(points: Floats) -> Floats:
        sizes.append(len(points))
        return half_space(RARE)(points)

    found = estimate(margin, 6)
    assert sum(sizes) == found.evaluations
    assert len(sizes) < 50


@pytest.mark.parametrize("evaluations", [LEAST_EVALUATIONS, 2345, 5000])
@pytest.mark.parametrize("probability", [0.5, RARE, 1e-9])
def test_no_more_margins_are_evaluated_than_allowed(probability: float, evaluations: int) -> None:
    steps = lambda points: np.floor(3.0 * half_space(probability)(points))  # noqa: E731
    for margin in (half_space(probability), steps):
        assert estimate(margin, 6, 0, rough_places(RARE, RARE, 6), evaluations).evaluations <= evaluations


def test_an_estimate_lies_between_the_products_of_the_level_probabilities_of_its_runs() -> None:
    found = estimate(half_space(RARE), 100)
    runs = {level.run for level in found.levels}
    products = [math.prod(level.probability for level in found.levels if level.run == run) for run in runs]
    assert min(products) <= found.probability <= max(products)
    for run in runs:
        thresholds = [level.threshold for level in found.levels if level.run == run]
        assert thresholds == sorted(thresholds, reverse=True)
        assert thresholds[-1] == 0.0


def test_an_estimate_is_immutable() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        estimate(half_space(0.5), 2).probability = 0.0  # type: ignore[misc]


def test_too_few_evaluations_and_pockets_or_margins_of_a_wrong_shape_are_refused() -> None:
    with pytest.raises(ValueError, match="999 evaluations are fewer than 1000"):
        next(subset_simulation(2, 0, None, 999))
    with pytest.raises(ValueError, match=r"pockets are \(1, 3\), not \(k, 2\)"):
        next(subset_simulation(2, 0, np.zeros((1, 3))))
    steps = subset_simulation(2, 0)
    next(steps)
    with pytest.raises(ValueError, match=r"margins are \(3,\), not \(700,\)"):
        steps.send(np.zeros(3))
