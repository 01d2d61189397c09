"""Measurements of the study, each on several processes, as data for JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from liftgate_hil.campaigns.probability.subset_simulation import SubsetEstimate
from tools.campaign_study import estimates, product
from tools.campaign_study.algorithms import ALGORITHMS, driven, to_the_end, until_failure
from tools.campaign_study.minima import TESTS
from tools.campaign_study.pockets import POCKETS, pocket


@dataclass(frozen=True)
class Size:
    """How much is measured."""

    budget: int = 500  # evaluations of a search
    seeds: int = 30  # of a weakness
    volume: int = 6000  # random variants, for the volume of a pocket
    pocket_seeds: int = 20  # of a kind of analytic pocket
    pockets: int = len(POCKETS)  # of their kinds
    test_seeds: int = 12  # of a test function
    tests: int = len(TESTS)
    repeats: int = 100  # of an analytic probability
    searched_repeats: int = 100  # of those with the search
    failures: int = len(estimates.FAILURES)
    crude: int = 20_000  # random variants, for crude Monte Carlo
    checks: int = 3  # estimates of its probability
    evaluations: int = estimates.BUDGET  # of each


FULL = Size()
SHORT = Size(40, 1, 10, 2, 3, 1, 2, 3, 1, 2, 30, 1, 1200)
FIRST = 1000  # seed of the analytic functions: others were used to choose the constants of the search

Data = dict[str, Any]


def weaknesses(pool: Executor, size: Size) -> Data:
    """Return the evaluations to each planted weakness (0: not found), and the counts of random variants."""
    found: Data = {}
    tasks = [
        (name, algorithm, seed, size.budget)
        for name in product.WEAKNESSES
        for seed in range(size.seeds)
        for algorithm in ALGORITHMS
    ]
    evaluations = dict(zip(tasks, pool.map(product.evaluations_to, tasks), strict=True))
    for name, case in product.WEAKNESSES.items():
        counts = list(pool.map(product.counts_of, product.parts_of(case, size.volume)))
        found[name] = {
            "volume": product.added(counts)._asdict(),
            "evaluations": {
                algorithm: [evaluations[name, algorithm, seed, size.budget] for seed in range(size.seeds)]
                for algorithm in ALGORITHMS
            },
        }
    return found


def _to_a_pocket(task: tuple[str, str, int, int]) -> int:
    name, algorithm, seed, budget = task
    steps = ALGORITHMS[algorithm](POCKETS[name].levels, budget, seed)
    return driven(until_failure(steps), pocket(name, seed)).found


def analytic_pockets(pool: Executor, size: Size) -> Data:
    """Return the evaluations to each kind of analytic pocket; 0: not found."""
    names, seeds = list(POCKETS)[: size.pockets], range(FIRST, FIRST + size.pocket_seeds)
    return _by_algorithm(pool, _to_a_pocket, names, seeds, size.budget)


def _least(task: tuple[str, str, int, int]) -> float:
    name, algorithm, seed, budget = task
    test = TESTS[name]
    return driven(to_the_end(ALGORITHMS[algorithm](test.levels, budget, seed)), test.function).best


def tests(pool: Executor, size: Size) -> Data:
    """Return the smallest value of each test function that was found."""
    seeds = range(FIRST, FIRST + size.test_seeds)
    return _by_algorithm(pool, _least, list(TESTS)[: size.tests], seeds, size.budget)


def _by_algorithm(
    pool: Executor,
    function: Callable[[tuple[str, str, int, int]], float],
    names: Sequence[str],
    seeds: Iterable[int],
    budget: int,
) -> Data:
    tasks = [(name, algorithm, seed, budget) for name in names for algorithm in ALGORITHMS for seed in seeds]
    found: Data = {name: {algorithm: [] for algorithm in ALGORITHMS} for name in names}
    for task, value in zip(tasks, pool.map(function, tasks, chunksize=4), strict=True):
        found[task[0]][task[1]].append(value)
    return found


def probabilities(pool: Executor, size: Size) -> Data:
    """Return the summaries of many estimates of each analytic probability, without and with the search."""
    given = {
        name: summary(
            list(pool.map(estimates.estimate, [(name, seed) for seed in range(size.repeats)], chunksize=4))
        )
        for name in list(estimates.FAILURES)[: size.failures]
    }
    searched = {
        name: summary(
            list(
                pool.map(
                    estimates.searched_estimate, [(name, k) for k in range(size.searched_repeats)], chunksize=2
                )
            )
        )
        for name in estimates.SEARCHED[: size.failures]
    }
    return {"given": given, "searched": searched}


def summary(found: Sequence[SubsetEstimate]) -> Data:
    """Return how well the estimates of the known probability hold."""
    ratios = np.array([each.probability for each in found]) / estimates.P
    evaluations = float(np.mean([each.evaluations for each in found]))
    square = float(np.mean((ratios - 1.0) ** 2))
    monte_carlo = (1.0 - estimates.P) / estimates.P / square if square else math.inf
    widths = [each.high / each.low if each.low else math.inf for each in found]
    return {
        "repeats": len(found),
        "evaluations": evaluations,
        "bias": float(np.mean(ratios)) - 1.0,
        "spread": math.sqrt(square),
        "fewer": monte_carlo / evaluations,
        "covered": sum(each.low <= estimates.P <= each.high for each in found),
        "width": float(np.median(widths)),
        "methods": {
            name: sum(each.method == name for each in found) for name in sorted({e.method for e in found})
        },
    }


def check(pool: Executor, size: Size) -> Data:
    """Return the counts of crude Monte Carlo with the product, and its estimates of the same probability."""
    tasks = [(product.FAILURES, seed, size.evaluations) for seed in range(size.checks)]
    waiting = [pool.submit(product.probability_of, task) for task in tasks]
    counts = list(pool.map(product.counts_of, product.parts_of(product.FAILURES, size.crude)))
    found = [each.result() for each in waiting]
    return {
        "crude": product.added(counts)._asdict(),
        "estimates": [
            {
                "probability": each.estimate.probability,
                "low": each.estimate.low,
                "high": each.estimate.high,
                "method": each.estimate.method,
                "evaluations": each.searched + each.estimate.evaluations,
                "unknown": each.estimate.unknown,
                "pockets": len(each.pockets),
            }
            for each in found
        ],
    }


PARTS: Mapping[str, Callable[[Executor, Size], Data]] = {
    "weaknesses": weaknesses,
    "pockets": analytic_pockets,
    "tests": tests,
    "probabilities": probabilities,
    "check": check,
}
