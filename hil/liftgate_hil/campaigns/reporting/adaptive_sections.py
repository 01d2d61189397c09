"""Sections of a campaign's report on a search for the worst and on a probability."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

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
    """Return the number of evaluations up to the first failure; None: there is none."""
    return next((each.number for each in history if each.fails), None)


def worst_as_dict(
    found: Worst, expectation: str, variant: str, names: Sequence[str], unit: str = ""
) -> dict[str, Any]:
    """Return a search for JSON; the smallest margin is that of all evaluations, random draws included.

    `unit` is that of the margins; "": they have none, or several.
    """
    best = least_of(found.everything)
    return {
        "expectation": expectation,
        "variant": variant,
        "margin": None if best is None else best.margin,
        "margin_unit": unit,
        "values": {} if best is None else dict(zip(names, best.values, strict=True)),
        "evaluations": found.end.evaluations,
        "found_after": None if best is None else best.number,
        "first_failure_after": first_failure(found.search),
        "failures": sum(each.fails for each in found.search),
        "stopped": found.end.reason,
        "evidence": found.end.evidence,
        "restarts": found.end.restarts,
        "random": _random_as_dict(found.random),
    }


def _random_as_dict(history: Sequence[Evaluated]) -> dict[str, Any]:
    best = least_of(history)
    return {
        "evaluations": len(history),
        "margin": None if best is None else best.margin,
        "first_failure_after": first_failure(history),
        "failures": sum(each.fails for each in history),
    }


def worst_section(found: Worst, expectation: str, units: Mapping[str, str], line: str, unit: str = "") -> str:
    """Return the report's section on a search.

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


def probability_as_dict(found: Probability, expectation: str) -> dict[str, Any]:
    """Return a probability for JSON."""
    own = found.estimate
    is_known = own.unknown < own.evaluations
    return {
        "expectation": expectation,
        "probability": own.probability if is_known else None,
        "low": own.low if is_known else None,
        "high": own.high if is_known else None,
        "confidence": 0.95,
        "variation": own.variation if math.isfinite(own.variation) else None,
        "is_upper_bound": own.bounded,
        "method": own.method,
        "evaluations": own.evaluations + found.searched,
        "of_these_searching": found.searched,
        "without_verdict": own.unknown,
        "pockets": len(found.pockets),
    }


def probability_section(found: Probability, expectation: str) -> str:
    """Return the report's section on a probability."""
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
