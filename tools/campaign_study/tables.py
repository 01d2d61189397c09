"""Numbers of the study as text, and its tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tools.campaign_study.algorithms import ALGORITHMS
from tools.campaign_study.study import Data
from tools.docs.markdown import table

OURS, OTHERS = "search", ("cma", "random")


def interval(failing: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a probability, of Clopper and Pearson (1934)."""
    from scipy.stats import beta

    low = float(beta.ppf(0.025, failing, count - failing + 1)) if failing else 0.0
    high = float(beta.ppf(0.975, failing + 1, count - failing)) if failing < count else 1.0
    return low, high


def censored(evaluations: Sequence[int], budget: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return evaluations with the budget in place of 0, which is not found."""
    return np.array([each or budget for each in evaluations], dtype=np.float64)


def found_of(evaluations: Sequence[int]) -> int:
    """Return how many seeds have found it."""
    return sum(each > 0 for each in evaluations)


def search_rows(found: Mapping[str, Mapping[str, Sequence[int]]], budget: int) -> list[list[str]]:
    """Return rows of a table: a name, each algorithm's seeds that found it and their mean, and who was sooner."""
    rows = []
    for name, by_algorithm in found.items():
        cells = [name]
        means = {key: censored(each, budget) for key, each in by_algorithm.items()}
        for key in ALGORITHMS:
            cells.append(f"{found_of(by_algorithm[key])}, {means[key].mean():.0f}")
        sooner = [int(np.sum(means[OURS] < means[other])) for other in OTHERS]
        rows.append([*cells, f"{sooner[0]} / {sooner[1]}"])
    return rows


def search_table(first: str, found: Mapping[str, Mapping[str, Sequence[int]]], budget: int) -> str:
    """Return the table of `search_rows`."""
    heads = (first, *ALGORITHMS, "search sooner than cma / random")
    return table(heads, search_rows(found, budget))


def total(found: Mapping[str, Mapping[str, Sequence[int]]], budget: int) -> str:
    """Return a sentence on all of the kinds together."""
    parts = []
    for key in ALGORITHMS:
        values = [each for by_algorithm in found.values() for each in by_algorithm[key]]
        share = 100.0 * found_of(values) / len(values)
        parts.append(f"{key} finds {share:.1f} % of {len(values)}, after {censored(values, budget).mean():.0f}")
    return "; ".join(parts)


def worse(found: Mapping[str, Mapping[str, Sequence[int]]], budget: int) -> str:
    """Return where another algorithm finds it with more seeds, or after fewer evaluations in the mean."""
    cells = []
    for name, by_algorithm in found.items():
        better = [other for other in OTHERS if _is_better(by_algorithm[other], by_algorithm[OURS], budget)]
        if better:
            cells.append(f"{name} ({' and '.join(better)})")
    return "; ".join(cells) or "nowhere"


def _is_better(one: Sequence[int], other: Sequence[int], budget: int) -> bool:
    means = censored(one, budget).mean(), censored(other, budget).mean()
    return found_of(one) > found_of(other) or bool(means[0] < means[1])


def minima_table(found: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
    """Return the table of the smallest values that were found."""
    rows = [
        [name, *(f"{np.median(by[key]):.3g}, {np.mean(by[key]):.3g}" for key in ALGORITHMS)]
        for name, by in found.items()
    ]
    return table(("function", *ALGORITHMS), rows)


def not_least(found: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
    """Return the functions of which another algorithm has found a smaller median."""
    cells = []
    for name, by in found.items():
        better = [other for other in OTHERS if np.median(by[other]) < np.median(by[OURS])]
        if better:
            cells.append(f"{name} ({' and '.join(better)})")
    return "; ".join(cells) or "nowhere"


def probability_table(found: Mapping[str, Data]) -> str:
    """Return the table of analytic probabilities."""
    heads = ("failure, dimensions", "covered", "bias", "spread", "high / low", "fewer than Monte Carlo", "method")
    rows = [
        [
            name,
            f"{each['covered']} of {each['repeats']}",
            f"{100.0 * each['bias']:+.1f} %",
            f"{100.0 * each['spread']:.1f} %",
            f"{each['width']:.2f}" if math.isfinite(each["width"]) else "∞",
            f"{each['fewer']:.3g}×",
            ", ".join(f"{_SHORT[method]} {count}" for method, count in each["methods"].items()),
        ]
        for name, each in found.items()
    ]
    return table(heads, rows)


_SHORT = {"importance sampling": "IS", "subset simulation": "SuS", "Monte Carlo": "MC"}


def check_table(found: Data) -> str:
    """Return the table of crude Monte Carlo and of the product's estimates, all with 95 % intervals."""
    crude = found["crude"]
    low, high = interval(crude["failing"], crude["count"])
    rows = [_check_row("random variants", crude["count"], crude["failing"] / crude["count"], low, high, "")]
    for seed, each in enumerate(found["estimates"]):
        overlaps = "yes" if each["low"] <= high and low <= each["high"] else "**no**"
        method = f"{each['method']}, seed {seed}"
        rows.append(
            _check_row(method, each["evaluations"], each["probability"], each["low"], each["high"], overlaps)
        )
    return table(("", "evaluations", "probability", "95 % interval", "high / low", "overlaps"), rows)


def _check_row(name: str, count: int, probability: float, low: float, high: float, overlaps: str) -> list[str]:
    ratio = f"{high / low:.2f}" if low else "∞"
    return [name, str(count), f"{probability:.5f}", f"{low:.5f} to {high:.5f}", ratio, overlaps]
