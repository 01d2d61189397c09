from __future__ import annotations

import numpy as np
import pytest

from liftgate_hil.campaigns.search.worst_search import SearchEnd, worst_search


def run(levels, budget, seed, margin):
    """Return all points (n, d), their margins (n,) and the outcome of a search of the function margin(points)."""
    search, points, margins, sent = worst_search(levels, budget, seed), [], [], None
    while True:
        try:
            batch = search.send(sent)
        except StopIteration as stop:
            return np.array(points).reshape(-1, len(levels)), np.array(margins), stop.value
        sent = np.asarray(margin(batch), dtype=float)
        points.extend(batch)
        margins.extend(sent)


def bowl(points):
    return ((points - 0.3) ** 2).sum(1) - 0.01


def pocket(points, low, side):
    """Margin of a cube by low corner and side: the distance from it in each of the first dimensions; 0 inside."""
    p = points[:, : len(low)]
    return np.maximum(np.maximum(low - p, p - low - side), 0.0)


def sloped_pocket(low):
    # 0.3 % of the volume in three of five dimensions, a gentle slope around it
    def margin(points):
        distance = np.linalg.norm(pocket(points, low, 0.144), axis=1)
        return np.where(distance == 0.0, -0.1, 0.2 + 0.8 * distance)

    return margin


def pocket_beside_a_harmless_minimum(low):
    # 0.3 % of the volume in four dimensions, in a shoulder; the broad minimum of 0.15 is elsewhere
    centre = np.where(low > 0.4, 0.2, 0.8)

    def margin(points):
        distance = np.linalg.norm(pocket(points, low, 0.234), axis=1)
        broad = 0.15 + 1.2 * ((points - centre) ** 2).sum(1)
        return np.where(distance == 0.0, -0.1, broad * (0.35 + 0.65 * np.minimum(distance / 0.15, 1.0)))

    return margin


@pytest.mark.parametrize(
    ("levels", "function", "dimensions"),
    [([0] * 5, sloped_pocket, 3), ([0] * 4, pocket_beside_a_harmless_minimum, 4)],
)
def test_nine_of_ten_narrow_pockets_are_found_within_500_evaluations(levels, function, dimensions):
    # Over three sets of ten pockets: 30 of 30 and 28 of 30.
    lows = np.random.default_rng(6).uniform(0.0, 0.75, (10, dimensions))
    found = [(run(levels, 500, seed, function(low))[1] < 0).any() for seed, low in enumerate(lows)]
    assert sum(found) >= 9


def test_the_minimum_of_a_smooth_margin_is_approached_closely():
    points, margins, end = run([0, 0, 0], 200, 1, bowl)
    assert margins.min() < -0.0099
    assert end.worst_margin == margins.min()
    assert end.worst_point == tuple(points[np.argmin(margins)])


@pytest.mark.parametrize("budget", [0, 1, 7, 16, 17, 61])
def test_the_budget_is_used_to_the_last_evaluation(budget):
    points, _, end = run([0, 4, 0], budget, 3, bowl)
    assert len(points) == end.evaluations == budget
    assert end.reason == "budget used"


@pytest.mark.parametrize("levels", [[0], [0, 0], [7, 0, 2], [0] * 12, [1, 0, 3], [50, 40, 30]])
def test_points_are_in_the_unit_cube_and_centred_in_the_cells_of_discrete_dimensions(levels):
    points, _, _ = run(levels, 100, 2, bowl)
    assert points.shape == (100, len(levels))
    assert ((points >= 0.0) & (points <= 1.0)).all()
    for values, k in zip(points.T, levels, strict=True):
        if k:
            assert np.allclose(values * k - 0.5, np.round(values * k - 0.5))
    assert len(np.unique(points, axis=0)) == len(points)


def test_the_same_seed_gives_the_same_points_whatever_the_caller_draws():
    first, _, end = run([0, 3, 0], 150, 4, bowl)

    def draws(points):
        np.random.standard_normal(3)
        return bowl(points)

    np.random.seed(9)
    again, _, same_end = run([0, 3, 0], 150, 4, draws)
    assert first.tobytes() == again.tobytes()
    assert end == same_end
    assert run([0, 3, 0], 150, 5, bowl)[0].tobytes() != first.tobytes()


def test_numpys_global_generator_is_left_unchanged():
    np.random.seed(1)
    expected = np.random.standard_normal()
    np.random.seed(1)
    _, _, end = run([0, 0], 80, 0, bowl)
    assert end.restarts > 0
    assert np.random.standard_normal() == expected


def test_a_search_without_any_known_margin_uses_its_budget_and_has_no_worst_point():
    points, _, end = run([0, 5], 90, 1, lambda p: np.full(len(p), np.nan))
    assert len(points) == end.no_verdict == 90
    assert np.isnan(end.worst_margin)
    assert end.worst_point is None


@pytest.mark.parametrize("value", [0.0, 1.0, np.inf, -np.inf])
def test_the_whole_space_is_explored_where_all_margins_are_equal(value):
    points, _, end = run([0, 0, 0], 128, 1, lambda p: np.full(len(p), value))
    assert end.worst_margin == value
    assert end.restarts == 0
    assert (np.histogramdd(points, bins=4, range=[(0, 1)] * 3)[0] > 0).mean() > 0.95


def test_a_search_descends_between_unknown_and_infinite_margins():
    def margin(points):
        f = bowl(points)
        f = np.where(points[:, 0] > 0.8, np.inf, f)
        f = np.where(points[:, 1] > 0.9, np.nan, f)
        return np.where(np.floor(points[:, 2] * 50) % 7 == 0, np.nan, f)

    _, margins, end = run([0, 0, 0], 200, 2, margin)
    assert np.nanmin(margins) < -0.009
    assert end.no_verdict == np.isnan(margins).sum() > 0


def test_a_margin_of_minus_infinity_is_the_worst_one_and_does_not_end_the_search():
    def margin(points):
        return np.where((points < 0.4).all(1), -np.inf, bowl(points))

    points, _, end = run([0, 0], 80, 2, margin)
    assert len(points) == 80
    assert end.worst_margin == -np.inf


@pytest.mark.parametrize(
    ("budget", "count", "reason"),
    [(100, 24, "all points of the discrete space evaluated"), (23, 23, "budget used")],
)
def test_a_discrete_space_is_exhausted_without_repetition_within_the_budget(budget, count, reason):
    points, _, end = run([4, 3, 2], budget, 6, bowl)
    assert len(points) == len(np.unique(points, axis=0)) == count
    assert end.reason == reason


@pytest.mark.parametrize("levels", [[0], [400]])
def test_a_space_of_one_dimension_is_searched(levels):
    _, margins, end = run(levels, 60, 1, bowl)
    assert margins.min() < -0.0099
    assert isinstance(end, SearchEnd)


@pytest.mark.parametrize(("levels", "budget"), [([], 5), ([0, -1], 5), ([0], -1)])
def test_invalid_dimensions_or_budgets_are_refused(levels, budget):
    with pytest.raises(ValueError, match="at least one dimension"):
        next(worst_search(levels, budget, 0))


def test_a_wrong_number_of_margins_is_refused():
    search = worst_search([0], 50, 0)
    batch = next(search)
    with pytest.raises(ValueError, match=f"{len(batch)} points"):
        search.send(np.zeros(len(batch) + 1))
