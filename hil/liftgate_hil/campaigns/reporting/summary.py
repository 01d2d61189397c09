"""Summary of a campaign's results: verdicts, expectations, the worst variants, what drives the result.

The latter by first-order Sobol indices from the variants that were evaluated: the share of the result's variance
that a varied value explains alone, Var(E[Y|Xi])/Var(Y), here by the mean of Y in classes of Xi, less what classes
of so few members show by chance (Strong, Oakley and Brennan 2012; of a grid the main effect of an analysis of
variance, ω²).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.campaigns.results import ERROR, JUDGED, MARGIN, VARIANT, VERDICT, numbers_in, reading
from liftgate_hil.judging.verdict import FAIL, PASS, VERDICTS

_CLASSES = 24  # of a continuous value, at most
_MEMBERS = 8  # of a class, at least, so that its mean says something
_ROUNDING = 1e-12  # scatter over size up to which results are equal but for rounding
_LEAST = 20  # results below which nothing is said
FORCE = "peak_pinch_force_n"
MOST_ROWS = 250_000  # variants of which sensitivity, heat maps and distributions are made, at most
_PART = 65_536  # rows that are read at a time
_WORST = 10  # variants that are listed
_ERRORS = 5  # kinds of errors that are listed


class Index(NamedTuple):
    """First-order Sobol index of a varied value, with the lowest and the highest class mean of the result."""

    name: str
    first_order: float  # 0 to 1
    low_mean: float  # mean of the result in the class with the lowest mean, in the result's unit
    high_mean: float
    at_high: float  # varied value in the middle of the class with the highest mean


def first_order(values: Mapping[str, Floats], results: Floats) -> list[Index]:
    """Return the Sobol indices of varied values (n,) on results (n,), largest first; none if few or equal.

    Variants without a result (NaN) are left out.
    """
    known = np.isfinite(results)
    own = results[known]
    total = float(own.var()) if len(own) else 0.0
    if len(own) < _LEAST or math.sqrt(total) <= _ROUNDING * float(np.abs(own).max()):
        return []
    found = []
    for name, each in values.items():
        classes = classes_of(each[known])
        if classes is None:
            continue
        found.append(_index(name, each[known], own, classes, total))
    return sorted(found, key=lambda index: -index.first_order)


def classes_of(values: Floats) -> Floats | None:
    """Return the class (bin) of each value (n,) as numbers from 0; None: all values are equal.

    Few distinct values are classes of their own, others are divided by their quantiles.
    """
    distinct = np.unique(values)
    if len(distinct) < 2:
        return None
    if len(distinct) <= _CLASSES:
        return np.searchsorted(distinct, values).astype(np.float64)
    count = max(2, min(_CLASSES, len(values) // _MEMBERS))
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, count + 1)[1:-1]))
    return np.searchsorted(edges, values, side="right").astype(np.float64)


def _index(name: str, values: Floats, results: Floats, classes: Floats, total: float) -> Index:
    numbers = classes.astype(np.int64)
    sizes = np.bincount(numbers).astype(np.float64)
    there = sizes > 0.0
    means = np.bincount(numbers, results)[there] / sizes[there]
    between = float((sizes[there] * (means - results.mean()) ** 2).sum())
    count, groups = len(results), int(there.sum())
    within = count * total - between
    # ω²: without the part of `between` that is due to chance.
    noise = within / (count - groups) if count > groups else 0.0
    share = (between - (groups - 1) * noise) / (count * total + noise)
    place = int(np.argmax(means))
    middle = float(np.median(values[numbers == np.flatnonzero(there)[place]]))
    return Index(name, min(max(share, 0.0), 1.0), float(means.min()), float(means.max()), middle)


def rest_of(indices: Sequence[Index]) -> float:
    """Return the share of the variance that no value explains alone: interactions, and chance."""
    return max(0.0, 1.0 - math.fsum(each.first_order for each in indices))


class ExpectationResults(NamedTuple):
    """Results of one expectation over all variants: numbers of verdicts, smallest margin."""

    name: str
    passed: int
    failed: int
    undecided: int  # inconclusive, or in error
    least: float  # smallest margin, in the unit of the expectation; NaN: none is known
    variant: str  # with it
    unit: str = ""  # of the margin; "": none, or several


class WorstVariant(NamedTuple):
    """Variant in the list of the worst ones, with its values and its result."""

    variant: str
    values: tuple[float, ...]
    verdict: str
    margin: float
    force: float  # N


@dataclass(frozen=True)
class CampaignSummary:
    """Summary of a campaign's results."""

    count: int
    counts: dict[str, int]  # by verdict
    expectations: Sequence[ExpectationResults]
    driver: str  # column of the result that cases and sensitivity are about
    worst: Sequence[WorstVariant]
    errors: Sequence[tuple[str, int]]  # most frequent ones, with their numbers
    every: int  # of so many variants one is in the following
    values: dict[str, Floats]  # (n,) by varied name
    result: Floats  # (n,) the column `driver`
    force: Floats  # (n,) N
    indices: Sequence[Index]  # of `driver`
    force_indices: Sequence[Index]
    force_limit: float | None = None  # N, at which an expectation fails; None: none is judged


def summary_of(
    path: Path,
    varied: Sequence[str],
    expectations: Sequence[str],
    preferred: str = "",
    margin_units: Sequence[str] = (),
    force_limit: float | None = None,
) -> CampaignSummary:
    """Return the summary of a result file (Parquet), which is read in parts.

    `preferred` is the expectation that the campaign is about; "": the one that fails most, else the largest force.
    `margin_units` are those of the expectations' margins; (): not told. `force_limit` [N] is the least force at
    which an expectation fails; None: none is judged.
    Of a large file, sensitivity, heat maps and distributions are those of each n-th variant (`every`). Raises
    StoreError.
    """
    import pyarrow.parquet as pq

    with reading(path) as stream, pq.ParquetFile(stream) as file:
        judged = [_Judged(*each) for each in zip_longest(expectations, margin_units, fillvalue="")]
        own = [f"{prefix}{name}" for prefix in (JUDGED, MARGIN) for name in expectations]
        verdicts, errors = Counter[str](), Counter[str]()
        for part in file.iter_batches(_PART, columns=[VARIANT, VERDICT, ERROR, *own]):
            verdicts.update(part[VERDICT].to_pylist())
            errors.update(each for each in part[ERROR].to_pylist() if each is not None)
            for each in judged:
                each.take(part)
        results = [each.result() for each in judged]
        failing = [each for each in results if each.failed and math.isfinite(each.least)]
        if failing and not preferred:
            preferred = max(failing, key=lambda each: each.failed).name
        driver = f"{MARGIN}{preferred}" if preferred else FORCE
        every = -(-file.metadata.num_rows // MOST_ROWS)
        columns = list(dict.fromkeys((*varied, driver, FORCE)))
        kept = _kept(file, columns, every)
        values = {name: kept[name] for name in varied}
        return CampaignSummary(
            count=file.metadata.num_rows,
            counts={name: verdicts[name] for name in VERDICTS if name in verdicts},
            expectations=results,
            driver=driver,
            worst=_worst(file, varied, driver),
            errors=errors.most_common(_ERRORS),
            every=every,
            values=values,
            result=kept[driver],
            force=kept[FORCE],
            indices=first_order(values, kept[driver]),
            force_indices=first_order(values, kept[FORCE]),
            force_limit=force_limit,
        )


def _kept(file: Any, columns: Sequence[str], every: int) -> dict[str, Floats]:
    """Return columns (n,) of each `every`-th row of a result file."""
    found: dict[str, list[Floats]] = {name: [] for name in columns}
    first = 0
    for part in file.iter_batches(_PART, columns=list(columns)):
        for name in columns:
            found[name].append(numbers_in(part, name)[-first % every :: every])
        first += part.num_rows
    return {name: np.concatenate(parts) for name, parts in found.items()}


class _Judged:
    """Accumulator of an expectation's results over the parts of a result file."""

    def __init__(self, name: str, unit: str) -> None:
        self._name, self._unit = name, unit
        self._counts = Counter[str]()
        self._least, self._variant = math.nan, ""

    def take(self, part: Any) -> None:
        """Add the rows of a part of the result file to the counts and the smallest margin."""
        self._counts.update(part[f"{JUDGED}{self._name}"].to_pylist())
        margins = numbers_in(part, f"{MARGIN}{self._name}")
        known = np.isfinite(margins)
        if known.any():
            place = int(np.nanargmin(np.where(known, margins, np.nan)))
            if not margins[place] >= self._least:
                self._least, self._variant = float(margins[place]), part[VARIANT][place].as_py()

    def result(self) -> ExpectationResults:
        """Return the expectation's results over all parts added."""
        passed, failed = self._counts[PASS], self._counts[FAIL]
        undecided = self._counts.total() - passed - failed
        return ExpectationResults(self._name, passed, failed, undecided, self._least, self._variant, self._unit)


def _worst(file: Any, varied: Sequence[str], driver: str) -> list[WorstVariant]:
    """Return up to _WORST variants, worst first: smallest margins, or largest forces if `driver` is the force."""
    is_margin = driver.startswith(MARGIN)
    columns = list(dict.fromkeys((VARIANT, *varied, VERDICT, driver, FORCE)))
    found: list[tuple[float, int, WorstVariant]] = []
    first = 0
    for part in file.iter_batches(_PART, columns=columns):
        result = numbers_in(part, driver)
        badness = -result if is_margin else result
        known = np.flatnonzero(np.isfinite(badness))
        order = known[np.argsort(-badness[known], kind="stable")][:_WORST]
        for place, row in zip(order.tolist(), part.take(order).to_pylist(), strict=True):
            force = math.nan if row[FORCE] is None else float(row[FORCE])
            case = WorstVariant(
                row[VARIANT], tuple(float(row[name]) for name in varied), row[VERDICT], float(result[place]), force
            )
            found.append((-float(badness[place]), first + place, case))
        found = sorted(found, key=lambda each: each[:2])[:_WORST]
        first += part.num_rows
    return [case for _, _, case in found]
