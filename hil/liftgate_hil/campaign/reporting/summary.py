"""Summary of a campaign's results: verdicts, expectations, the worst variants, what drives the result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.campaign.distributions import Floats
from liftgate_hil.campaign.reporting.sensitivity import Index, first_order
from liftgate_hil.campaign.results import ERROR, MARGIN, VARIANT, VERDICT
from liftgate_hil.judging.verdict import VERDICTS

FORCE = "peak_pinch_force_n"
_WORST = 10  # variants that are listed
_ERRORS = 5  # kinds of errors that are listed


class Expected(NamedTuple):
    """Results of one expectation."""

    name: str
    passed: int
    failed: int
    undecided: int  # without a margin: inconclusive, in error, or a trouble code
    least: float  # smallest margin, in the unit of the expectation; NaN: none is known
    variant: str  # with it


class Case(NamedTuple):
    """One variant of the list of the worst."""

    variant: str
    values: tuple[float, ...]
    verdict: str
    margin: float
    force: float  # N


@dataclass(frozen=True)
class Summary:
    """Summary of results."""

    count: int
    counts: dict[str, int]  # by verdict
    expectations: Sequence[Expected]
    driver: str  # column of the result that cases and sensitivity are about
    worst: Sequence[Case]
    errors: Sequence[tuple[str, int]]  # most frequent ones, with their numbers
    values: dict[str, Floats]  # (n,) by varied name
    result: Floats  # (n,) the column `driver`
    force: Floats  # (n,) N
    indices: Sequence[Index]  # of `driver`
    force_indices: Sequence[Index]


def summary_of(path: Path, varied: Sequence[str], expectations: Sequence[str], preferred: str = "") -> Summary:
    """Return the summary of a file of results.

    `preferred` is the expectation that the campaign is about; "": the one that fails most, else the closest one.
    """
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    column = {
        name: _floats(table, name) for name in (*varied, *(f"{MARGIN}{each}" for each in expectations), FORCE)
    }
    variants = table[VARIANT]
    judged = [_expected(name, column[f"{MARGIN}{name}"], variants) for name in expectations]
    driver = f"{MARGIN}{preferred}" if preferred else _driver_of(judged)
    result = column[driver]
    verdicts = {each["values"]: each["counts"] for each in table[VERDICT].value_counts().to_pylist()}
    errors = table[ERROR].drop_null().value_counts().to_pylist()
    values = {name: column[name] for name in varied}
    return Summary(
        count=table.num_rows,
        counts={name: verdicts[name] for name in VERDICTS if name in verdicts},
        expectations=judged,
        driver=driver,
        worst=_worst(table, varied, driver, result, column[FORCE]),
        errors=sorted(((e["values"], e["counts"]) for e in errors), key=lambda pair: -pair[1])[:_ERRORS],
        values=values,
        result=result,
        force=column[FORCE],
        indices=first_order(values, result),
        force_indices=first_order(values, column[FORCE]),
    )


def _floats(table: Any, name: str) -> Floats:
    found: Floats = table[name].to_numpy(zero_copy_only=False).astype(np.float64)
    return found


def _expected(name: str, margins: Floats, variants: Any) -> Expected:
    known = np.isfinite(margins)
    place = int(np.nanargmin(margins)) if known.any() else -1
    return Expected(
        name,
        int((margins[known] >= 0.0).sum()),
        int((margins[known] < 0.0).sum()),
        int((~known).sum()),
        float(margins[place]) if place >= 0 else math.nan,
        variants[place].as_py() if place >= 0 else "",
    )


def _driver_of(judged: Sequence[Expected]) -> str:
    """Return the column that the report is about: of the expectation that fails most; without any, the force."""
    failing = [each for each in judged if each.failed]
    if not failing:
        return FORCE
    return f"{MARGIN}{max(failing, key=lambda each: each.failed).name}"


def _worst(table: Any, varied: Sequence[str], driver: str, result: Floats, force: Floats) -> list[Case]:
    badness = -result if driver.startswith(MARGIN) else result
    known = np.flatnonzero(np.isfinite(badness))
    order = known[np.argsort(-badness[known], kind="stable")][:_WORST]
    rows = table.take(order).to_pylist()
    return [
        Case(
            row[VARIANT],
            tuple(float(row[name]) for name in varied),
            row[VERDICT],
            float(result[place]),
            float(force[place]),
        )
        for row, place in zip(rows, order.tolist(), strict=True)
    ]
