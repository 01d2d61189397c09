"""Worst-case search and failure probability of a campaign, with margins computed by formulas in place of runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import norm

from liftgate_hil.campaigns.adaptive import (
    MOST_POCKETS,
    SEARCH_SHARE,
    Evaluations,
    drive,
    estimate_probability,
    pockets_of,
    search_worst,
    share_below,
)
from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.campaign import Campaign, CampaignProgress, CampaignStoppedError
from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.campaigns.evaluation import Row
from liftgate_hil.campaigns.executors.executor import Batch, Done
from liftgate_hil.campaigns.figures import NO_FIGURES
from liftgate_hil.campaigns.prepared import prepared
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.results import table_of
from liftgate_hil.campaigns.space import Space, shares_of
from liftgate_hil.campaigns.store import Store

SHORT = """
duration = 1.0

[parameters]
x = 1.0
y = 2.0
z = 3.0

[[expect]]
name = "other"
always = "gate_angle_deg > -90"

[[expect]]
name = "soft"
always = "gate_angle_deg > -90"
"""
Margin = Callable[[Floats], Floats]


@dataclass
class Formula:
    """An executor whose margins of the expectation `soft` are a formula of the varied values."""

    base: Base
    margin: Margin
    workers: int = 1
    fails: Callable[[float], bool] = lambda margin: False  # besides those with a negative margin
    evaluated: list[tuple[float, ...]] = field(default_factory=list)

    def run(
        self, batches: Iterable[Batch], store: Store, stopped: Callable[[], bool], told: Callable[[int], None]
    ) -> Iterator[Done]:
        """Yield the result batches in the order in which they are evaluated."""
        for batch in batches:
            if stopped():
                return
            margins = self.margin(batch.values)
            own = [("pass", "fail" if each < 0.0 or self.fails(each) else "pass") for each in margins]
            rows = [
                Row("pass", (9.0, float(each)), NO_FIGURES, 0.0, "", verdicts)
                for each, verdicts in zip(margins, own, strict=True)
            ]
            self.evaluated += map(tuple, batch.values.tolist())
            store.put(batch.name, table_of(self.base, batch.values, rows))
            told(len(rows))
            yield Done(batch, 0)

    def close(self) -> None:
        """Do nothing: the executor holds no resources."""


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., tuple[Campaign, Formula, Space]]:
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    store = Store(str(tmp_path / "batches"))
    store.create()

    def campaign(margin: Margin, *vary: str, workers: int = 1) -> tuple[Campaign, Formula, Space]:
        found = prepared(CampaignRequest(str(path), vary, worst="soft"))
        executor = Formula(found.base, margin, workers)
        own = Campaign(found.base, executor, store, lambda: False, CampaignProgress(0), lambda progress: None)
        return own, executor, found.space

    return campaign


def total(values: Floats) -> Floats:
    return values.sum(axis=1)


PLANE = ("x~uniform(0,1)", "y~uniform(0,1)")
NORMAL = ("x~normal(0,1)", "y~normal(0,1)")


def test_margins_are_those_of_the_chosen_expectation_in_the_order_of_the_points(made: Callable) -> None:
    campaign, _, _ = made(total, *PLANE)
    found = Evaluations(campaign, "soft").margins(np.array([[0.5, 0.25], [1.0, 0.0], [0.0, 0.125]]))
    assert found.tolist() == [0.75, 1.0, 0.125]
    assert Evaluations(campaign, "other").margins(np.array([[0.5, 0.25]])).tolist() == [9.0]


def test_repeated_points_are_evaluated_once_and_their_margins_keep_the_order(made: Callable) -> None:
    campaign, executor, _ = made(total, *PLANE)
    evaluations = Evaluations(campaign, "soft")
    points = np.array([[0.5, 0.25], [1.0, 0.0], [0.5, 0.25], [0.5, 0.25]])
    assert evaluations.margins(points).tolist() == [0.75, 1.0, 0.75, 0.75]
    assert evaluations.margins(points[::-1]).tolist() == [0.75, 0.75, 1.0, 0.75]
    assert evaluations.margins(np.array([[0.0, 0.25], [0.5, 0.25], [0.0, 0.5]])).tolist() == [0.25, 0.75, 0.5]
    assert executor.evaluated == [(0.5, 0.25), (1.0, 0.0), (0.0, 0.25), (0.0, 0.5)]
    assert [each.number for each in evaluations.history] == [1, 2, 3, 4]


def test_an_unknown_margin_is_nan_and_its_point_is_not_evaluated_again(made: Callable) -> None:
    campaign, executor, _ = made(lambda values: np.full(len(values), math.nan), *PLANE)
    evaluations = Evaluations(campaign, "soft")
    for _ in range(2):
        assert np.isnan(evaluations.margins(np.array([[0.0, 0.25]]))).all()
    assert len(executor.evaluated) == 1


def test_new_points_are_divided_among_the_workers(made: Callable) -> None:
    campaign, _, _ = made(total, *PLANE, workers=4)
    Evaluations(campaign, "soft").margins(np.random.default_rng(1).random((10, 2)))
    assert [len(each.values) for each in campaign.asked] == [3, 3, 3, 1]


def test_a_resumed_search_takes_its_evaluated_variants_from_the_store(made: Callable) -> None:
    ends = []
    for _ in range(2):
        campaign, executor, space = made(total, *PLANE)
        worst = search_worst(campaign, space, "soft", 30, 5)
        ends.append((worst.end, worst.search, worst.random))
    assert executor.evaluated == []
    assert ends[0] == ends[1]
    assert campaign.progress.found == campaign.progress.done == 60


def test_a_stop_request_ends_a_search(made: Callable) -> None:
    campaign, executor, space = made(total, *PLANE)
    campaign.stopped = lambda: len(executor.evaluated) >= 20
    with pytest.raises(CampaignStoppedError):
        search_worst(campaign, space, "soft", 100, 5)
    assert 20 <= len(executor.evaluated) < 100


def bowl(values: Floats) -> Floats:
    return ((values - [20.0, 3000.0]) ** 2 / [100.0, 1e6]).sum(axis=1) - 0.01


SEARCHED = ("x~uniform(0,100)", "y~loguniform(1e2,1e5)")


def test_a_search_keeps_to_its_budget_and_finds_a_smaller_margin_than_as_many_random_draws(made: Callable) -> None:
    campaign, executor, space = made(bowl, *SEARCHED)
    worst = search_worst(campaign, space, "soft", 80, 1)
    assert worst.end.evaluations == len(worst.search) == len(worst.random) == 80
    assert len(executor.evaluated) == 160
    assert campaign.progress.count == campaign.progress.done == 160
    assert sum(len(each.values) for each in campaign.asked) == 160
    expected = space.values(shares_of(2, 80, "random", 1))
    np.testing.assert_array_equal([each.values for each in worst.random], expected)
    np.testing.assert_array_equal([each.margin for each in worst.random], bowl(expected))
    least, drawn = (min(each.margin for each in history) for history in (worst.search, worst.random))
    assert least < -0.008 < drawn  # the smallest is -0.01
    assert worst.end.worst_margin == least


def test_a_search_of_a_grid_ends_when_all_grid_points_are_evaluated(made: Callable) -> None:
    campaign, executor, space = made(total, "x=1,2,3", "y=10:40:4")
    worst = search_worst(campaign, space, "soft", 100, 1)
    assert worst.end.evaluations == len(worst.search) == 12
    assert min(each.margin for each in worst.search) == 11.0
    assert len(set(executor.evaluated)) == 12


def test_an_algorithm_that_requests_no_evaluation_ends_at_once(made: Callable) -> None:
    campaign, executor, space = made(total, *PLANE)

    def steps() -> Iterator[Floats]:
        return "the end"
        yield

    assert drive(steps(), space.values, Evaluations(campaign, "soft")) == "the end"  # type: ignore[arg-type]
    assert executor.evaluated == []


def test_the_normal_distribution_function_turns_points_into_shares() -> None:
    points = np.array([[-3.0, 0.0], [1.5, 4.0]])
    np.testing.assert_allclose(share_below(points), norm.cdf(points), rtol=1e-12)


def test_a_pocket_is_the_most_probable_failing_point_of_its_direction() -> None:
    failing = np.array([[4.0, 0.1], [3.0, 0.0], [3.5, -0.2], [0.1, -4.2], [0.0, -4.0]])
    assert pockets_of(failing).tolist() == [[3.0, 0.0], [0.0, -4.0]]


@pytest.mark.parametrize(("degrees", "count"), [(35.0, 1), (45.0, 2), (180.0, 2)])
def test_failing_points_count_as_two_pockets_only_in_different_directions(degrees: float, count: int) -> None:
    angle = math.radians(degrees)
    failing = np.array([[2.0, 0.0], [3.0 * math.cos(angle), 3.0 * math.sin(angle)]])
    assert len(pockets_of(failing)) == count


def test_the_number_of_pockets_is_limited_and_the_origin_is_none_of_them() -> None:
    angles = np.radians(np.arange(0.0, 360.0, 45.0))
    assert len(pockets_of(np.column_stack([np.cos(angles), np.sin(angles)]))) == MOST_POCKETS
    assert pockets_of(np.array([[0.0, 0.0], [1.0, 0.0]])).tolist() == [[1.0, 0.0]]
    assert pockets_of(np.zeros((0, 3))).shape == (0, 3)  # without failures


def two_pockets(values: Floats) -> Floats:
    """Return the margin of two failure regions, x above 3.2 or y below -3.4: the distance from the nearer one."""
    return np.minimum(3.2 - values[:, 0], 3.4 + values[:, 1])


def chance(first: float, second: float) -> float:
    """Return the probability of either of two independent events."""
    return first + second - first * second


BUDGET = 1200


def test_the_interval_of_the_probability_holds_the_truth_for_two_pockets(made: Callable) -> None:
    campaign, executor, space = made(two_pockets, *NORMAL)
    found = estimate_probability(campaign, space, "soft", BUDGET, 1)
    truth = chance(float(ndtr(-3.2)), float(ndtr(-3.4)))
    assert found.estimate.low <= truth <= found.estimate.high
    assert found.estimate.high < 10.0 * truth
    assert (two_pockets(found.pockets) < 0.0).all()
    assert (found.pockets[:, 0] > 3.2).any()
    assert (found.pockets[:, 1] < -3.4).any()
    assert len(executor.evaluated) <= BUDGET
    assert found.searched == int(SEARCH_SHARE * BUDGET)
    assert campaign.progress.count == BUDGET


def test_pockets_are_found_where_the_margin_of_a_failure_is_0(made: Callable) -> None:
    campaign, executor, space = made(lambda values: np.maximum(two_pockets(values), 0.0), *NORMAL)
    executor.fails = lambda margin: margin == 0.0
    found = estimate_probability(campaign, space, "soft", BUDGET, 1)
    assert (found.pockets[:, 0] > 3.2).any()
    assert (found.pockets[:, 1] < -3.4).any()
    assert found.estimate.low <= chance(float(ndtr(-3.2)), float(ndtr(-3.4))) <= found.estimate.high


def test_the_probability_follows_the_distributions_of_the_varied_values(made: Callable) -> None:
    # x and y fail in their own units: beyond the 99.9 % quantile of x, below the 0.05 % quantile of y.
    campaign, _, space = made(
        lambda values: np.minimum(99.9 - values[:, 0], np.log(values[:, 1] / 100.0) + 0.3 * 3.2905),
        "x~uniform(0,100)", "y~lognormal(100,0.3)",
    )  # fmt: skip
    found = estimate_probability(campaign, space, "soft", BUDGET, 1)
    truth = chance(1e-3, 5e-4)
    assert found.estimate.low <= truth <= found.estimate.high
    assert found.estimate.high < 10.0 * truth


def test_values_of_a_grid_count_as_equally_probable(made: Callable) -> None:
    campaign, _, space = made(lambda values: 2.5 - values[:, 0], "x=0,1,2,3", "y~normal(0,1)")
    found = estimate_probability(campaign, space, "soft", BUDGET, 1).estimate
    assert found.low <= 0.25 <= found.high
    assert found.high < 0.4


def test_a_failure_probability_of_zero_has_an_upper_bound(made: Callable) -> None:
    campaign, _, space = made(lambda values: np.full(len(values), 5.0), *NORMAL)
    found = estimate_probability(campaign, space, "soft", BUDGET, 1)
    assert found.estimate.probability == 0.0
    assert 0.0 < found.estimate.high < 0.05
    assert found.pockets.shape == (0, 2)
