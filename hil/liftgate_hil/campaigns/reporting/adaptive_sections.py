"""Sections of a campaign's report on a worst-case search and on a probability estimate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.errors import with_unit
from liftgate_hil.report.drawing import FINAL, INITIAL, INK, new_figure, style, svg
from liftgate_hil.report.numbers import significant
from liftgate_hil.report.page import alert, figure, pairs, section, table, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from liftgate_hil.campaigns.adaptive import Evaluated, Probability, Worst


def least_of(history: Sequence[Evaluated]) -> Evaluated | None:
    """Return the variant with the smallest margin; None: no variant has one."""
    known = [each for each in history if not math.isnan(each.margin)]
    return min(known, key=lambda each: each.margin, default=None)


def first_failure(history: Sequence[Evaluated]) -> int | None:
    """Return the number of evaluations up to the first failure, itself included; None: there is none."""
    return next((each.number for each in history if each.fails), None)


# fmt: off
@dataclass(frozen=True)
class DrawsResult(DescribedResult):
    """Result of the random draws that a worst-case search is compared with."""

    evaluations: Annotated[int, Shown("number of draws")]
    margin: Annotated[float | None, Shown("smallest margin, in the expectation's unit; null: no draw has one")]
    first_failure_after: Annotated[int | None, Shown("draws until the first failure; null: none fails")]
    failures: Annotated[int, Shown("number of failures")]


@dataclass(frozen=True)
class WorstResult(DescribedResult):
    """Result of a worst-case search; its smallest margin is that of all evaluations, random draws included."""

    expectation: Annotated[str, Shown("`--worst`, `--probability`: name of the expectation")]
    variant: Annotated[str, Shown("`--worst`: the variant with the smallest margin, as in `results.parquet`")]
    margin: Annotated[float | None, Shown("`--worst`: its margin, in `margin_unit`; null: no variant has one")]
    margin_unit: Annotated[str, Shown("`--worst`: unit of the margins; empty: none, or comparisons in several "
        "units")]
    values: Annotated[Mapping[str, float], Shown("`--worst`: its values", keys={"NAME": "value of what was "
        "varied"})]
    evaluations: Annotated[int, Shown("`--worst`, `--probability`: number of evaluations")]
    found_after: Annotated[int | None, Shown("`--worst`: evaluations until it was found, random ones included; "
        "null: none")]
    first_failure_after: Annotated[int | None, Shown("`--worst`: evaluations until the first failure; null: none "
        "fails")]
    failures: Annotated[int, Shown("`--worst`: number of failures")]
    stopped: Annotated[str, Shown("`--worst`: why the search ended, in words")]
    evidence: Annotated[str, Shown("`--worst`: how sure the result is, in words")]
    restarts: Annotated[int, Shown("`--worst`: descents that were begun")]
    random: Annotated[DrawsResult, Shown("`--worst`: as many random draws, for comparison")]


@dataclass(frozen=True)
class ProbabilityResult(DescribedResult):
    """Result of a probability estimate; NaN: unknown."""

    expectation: Annotated[str, Shown("`--worst`, `--probability`: name of the expectation")]
    probability: Annotated[float, Shown("`--probability`: probability of failure, 0 to 1; null: unknown")]
    low: Annotated[float, Shown("`--probability`: begin of its interval; null: unknown")]
    high: Annotated[float, Shown("`--probability`: end of its interval; null: unknown")]
    confidence: Annotated[float, Shown("`--probability`: confidence of the interval, 0 to 1")]
    variation: Annotated[float, Shown("`--probability`: coefficient of variation; null: unknown")]
    is_upper_bound: Annotated[bool, Shown("`--probability`: true: the probability is only known to be lower")]
    method: Annotated[str, Shown("`--probability`: method of the estimate")]
    evaluations: Annotated[int, Shown("`--worst`, `--probability`: number of evaluations")]
    of_these_searching: Annotated[int, Shown("`--probability`: evaluations that only searched for failures")]
    without_verdict: Annotated[int, Shown("`--probability`: evaluations without a margin")]
    pockets: Annotated[int, Shown("`--probability`: separate regions of failures that were found")]


# fmt: on
def worst_result(
    found: Worst, expectation: str, variant: str, names: Sequence[str], unit: str = ""
) -> WorstResult:
    """Return a search's result for campaign.json; `unit` is the margins': "" if they have none, or several."""
    best, drawn, random = least_of(found.everything), least_of(found.random), found.random
    return WorstResult(
        expectation,
        variant,
        None if best is None else best.margin,
        unit,
        {} if best is None else dict(zip(names, best.values, strict=True)),
        found.end.evaluations,
        None if best is None else best.number,
        first_failure(found.search),
        sum(each.fails for each in found.search),
        found.end.reason,
        found.end.evidence,
        found.end.restarts,
        DrawsResult(
            len(random),
            None if drawn is None else drawn.margin,
            first_failure(random),
            sum(each.fails for each in random),
        ),
    )


def worst_section(found: Worst, expectation: str, units: Mapping[str, str], line: str, unit: str = "") -> str:
    """Return the report's HTML section on a worst-case search.

    `units` are those of all varied names, in their order; `line` runs the found variant again, `unit` is the
    margins'.
    """
    best = least_of(found.everything)
    if best is None:
        return section("Search for the worst", "<p>No variant has a margin.</p>")
    story = (
        f"The smallest margin of “{expectation}” is {with_unit(significant(best.margin, 4), unit)}"
        f"{', a failure,' if best.fails else ','} found by evaluation {best.number}."
    )
    values = [
        (name, with_unit(significant(value, 6), units[name]))
        for name, value in zip(units, best.values, strict=True)
    ]
    rows = [_row("search", found.search), _row("random draws", found.random)]
    drawn = svg(_convergence(found), "search", "smallest margin over evaluations")
    return section(
        "Search for the worst",
        f'<p class="lead">{text(story)}</p>',
        pairs(values),
        f"<p><code>{text(line)}</code></p>",
        table(("", "evaluations", "smallest margin", "failures", "first after"), rows, ("", "r", "r", "r", "r")),
        figure(drawn, "Smallest margin so far, over the evaluations.", small=True),
        f'<p class="soft">{text(f"Stopped: {found.end.reason}. {found.end.evidence}")}</p>',
    )


def _row(name: str, history: Sequence[Evaluated]) -> tuple[str, ...]:
    best, first = least_of(history), first_failure(history)
    return (
        name,
        f"{len(history):,}",
        significant(math.nan if best is None else best.margin, 4),
        f"{sum(each.fails for each in history):,}",
        "—" if first is None else f"{first:,}",
    )


def _convergence(found: Worst) -> Figure:
    with style():
        drawn = new_figure(2.4, 5.0)
        axis = drawn.subplots()
        for history, colour, label in ((found.random, INITIAL, "random draws"), (found.search, FINAL, "search")):
            margins = np.array([each.margin for each in history])
            least = np.fmin.accumulate(margins)
            axis.step(np.arange(1, len(least) + 1), least, where="post", color=colour, label=label)
        axis.axhline(0.0, color=INK, linewidth=0.8)
        axis.set_xlabel("evaluations")
        axis.set_ylabel("smallest margin")
        axis.legend()
    return drawn


def probability_result(found: Probability, expectation: str) -> ProbabilityResult:
    """Return a probability estimate's result for campaign.json."""
    own = found.estimate
    is_known = own.unknown < own.evaluations
    return ProbabilityResult(
        expectation,
        *((own.probability, own.low, own.high) if is_known else (math.nan,) * 3),
        0.95,
        own.variation,
        own.bounded,
        own.method,
        own.evaluations + found.searched,
        found.searched,
        own.unknown,
        len(found.pockets),
    )


def probability_section(found: Probability, expectation: str) -> str:
    """Return the report's HTML section on a probability estimate."""
    own = found.estimate
    if own.unknown == own.evaluations:
        return section("Probability of failure", f"<p>No variant has a margin of “{text(expectation)}”.</p>")
    if own.bounded and own.probability == 0.0:
        story = f"“{expectation}” did not fail: its probability of failure is below {own.high:.2g} (95 %)."
    else:
        story = (
            f"“{expectation}” fails with a probability of {own.probability:.2g} "
            f"(95 %: {own.low:.2g} to {own.high:.2g})."
        )
    spread = own.variation
    direct = ""
    if own.probability > 0.0 and math.isfinite(spread) and spread > 0.0:
        need = (1.0 - own.probability) / own.probability / spread**2
        direct = f"{need:,.0f} plain random draws would be needed for the same spread"
    rows = [
        ("method", own.method),
        ("evaluations", f"{own.evaluations + found.searched:,}, {found.searched:,} of them searching for pockets"),
        ("separate pockets found before", str(len(found.pockets))),
        ("coefficient of variation", significant(spread, 3)),
        ("without a verdict", f"{own.unknown:,}, taken as not failed"),
        *([("compared", direct)] if direct else []),
    ]
    note = "The interval does not account for failures that the search has not found."
    missing = f"{own.unknown:,} of {own.evaluations:,} evaluations have no verdict and count as passed."
    return section(
        "Probability of failure",
        alert([missing] if own.unknown else []),
        f'<p class="lead">{text(story)}</p>',
        pairs(rows),
        f'<p class="soft">{text(note)}</p>',
    )
