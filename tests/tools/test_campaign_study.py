"""The study of campaigns: a short run, and the properties of its functions."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from liftgate_hil.campaigns.probability.subset_simulation import SubsetEstimate
from tools.campaign_study.__main__ import main
from tools.campaign_study.algorithms import ALGORITHMS, driven, to_the_end, until_failure
from tools.campaign_study.estimates import FAILURES, P
from tools.campaign_study.minima import TESTS
from tools.campaign_study.pockets import POCKETS, pocket
from tools.campaign_study.study import SHORT, summary
from tools.campaign_study.tables import interval, search_table, worse


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("study")
    assert main(["--short", "--jobs", "1", "--output", str(folder)]) == 0
    return (folder / "campaign-study.md").read_text(encoding="utf-8")


def tables_of(text: str) -> dict[str, list[list[str]]]:
    """Rows of each table, by the first cell of its header."""
    found: dict[str, list[list[str]]] = {}
    for lines in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines.splitlines()]
        found.setdefault(rows[0][0], []).extend(rows[2:])
    return found


def test_a_short_study_writes_all_tables(page: str) -> None:
    """An estimate of a probability takes 1,000 runs at least."""
    assert re.findall(r"^## (.*)$", page, re.MULTILINE) == [
        "Three planted weaknesses",
        "Analytic pockets",
        "Test functions",
        "Probabilities that are known",
        "A probability of real runs",
    ]
    tables = tables_of(page)
    assert [row[0] for row in tables["weakness"][3:]] == ["frozen", "zone", "late"]
    assert len(tables["pocket"]) == SHORT.pockets
    assert len(tables["function"]) == SHORT.tests
    assert len(tables["failure, dimensions"]) == 2 * SHORT.failures
    assert [row[1] for row in tables[""]] == ["30", "1200"]
    for row in tables["weakness"][:3]:
        assert row[-1] == "0", "each variant has a margin"


def test_the_study_page_has_no_long_lines_nan_or_temporary_paths(page: str) -> None:
    assert max(map(len, page.splitlines())) <= 115
    assert "/tmp" not in page
    assert "nan" not in page
    assert "short run" in page


@pytest.mark.parametrize("name", POCKETS)
def test_a_pocket_of_failures_has_its_specified_volume(name: str) -> None:
    kind = POCKETS[name]
    points = np.random.default_rng(1).random((40_000, len(kind.levels)))
    shares = [np.mean(pocket(name, seed)(points) < 0.0) for seed in range(5)]
    assert np.mean(shares) == pytest.approx(kind.volume, rel=0.2)
    assert kind.volume < 0.01


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_search_algorithm_uses_its_budget_and_is_repeatable(name: str) -> None:
    test = TESTS["mixed 5"]
    asked: list[int] = []

    def noted(points: np.ndarray) -> np.ndarray:
        asked.append(len(points))
        assert np.all((points >= 0.0) & (points < 1.0))
        return test.function(points)

    ends = [driven(to_the_end(ALGORITHMS[name](test.levels, 90, 3)), noted) for _ in range(2)]
    assert ends[0] == ends[1]
    assert sum(asked) == 2 * 90


def test_the_first_failure_is_counted_by_its_position_in_the_batch() -> None:
    def steps():
        margins = yield np.zeros((4, 1))
        assert len(margins) == 4
        yield np.zeros((3, 1))

    answers = iter([np.array([1.0, math.nan, 2.0, 1.0]), np.array([1.0, -1.0, -2.0])])
    assert driven(until_failure(steps()), lambda points: next(answers)).found == 6


@pytest.mark.parametrize("name", ["linear, 2", "two, 3:1, 2", "curved away, 2", "curved about, 2"])
def test_the_known_failure_probability_agrees_with_a_grid_integral(name: str) -> None:
    z = np.linspace(-7.0, 7.0, 2001)
    x, y = np.meshgrid(z, z)
    failed = FAILURES[name].margin(np.column_stack([x.ravel(), y.ravel()])) < 0.0
    density = np.exp(-0.5 * (x**2 + y**2)).ravel() / (2.0 * np.pi) * (z[1] - z[0]) ** 2
    assert float(density[failed].sum()) == pytest.approx(P, rel=0.02)


def test_a_summary_counts_the_intervals_that_cover_the_truth() -> None:
    def found(probability: float, low: float, high: float) -> SubsetEstimate:
        return SubsetEstimate(probability, low, high, 0.1, 5000, 0, False, "importance sampling", ())

    told = summary([found(1.1 * P, 0.9 * P, 1.3 * P), found(0.7 * P, 0.6 * P, 0.9 * P)])
    assert told["covered"] == 1
    assert told["bias"] == pytest.approx(-0.1)
    assert told["spread"] == pytest.approx(math.sqrt(0.05))
    assert told["fewer"] == pytest.approx((1.0 - P) / P / 0.05 / 5000.0)


def test_a_search_table_names_the_tests_where_another_algorithm_is_better() -> None:
    found = {"a": {"search": [10, 0], "cma": [20, 30], "random": [0, 0]}}
    assert "| a | 1, 255 | 2, 25 | 0, 500 | 1 / 1 |" in search_table("pocket", found, 500)
    assert worse(found, 500) == "a (cma)"


def test_a_confidence_interval_is_that_of_clopper_and_pearson() -> None:
    """For 0 of n the interval ends at 1 - 0.025^(1/n)."""
    assert interval(0, 100) == (0.0, pytest.approx(1.0 - 0.025**0.01))
    low, high = interval(10, 1000)
    assert (low, high) == (pytest.approx(0.0048, abs=1e-4), pytest.approx(0.0183, abs=1e-4))
