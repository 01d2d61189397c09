"""Report of several campaigns on one page: what each has found on the first screen, the evidence below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from liftgate_hil.campaign.reporting import report as single
from liftgate_hil.campaign.reporting.report import Choice
from liftgate_hil.campaign.reporting.summary import Summary
from liftgate_hil.report.page import page, pairs, section, table, text
from liftgate_hil.report.provenance import Provenance

_FEW = 8  # values of a varied name that are a table's rows


class PartResult(NamedTuple):
    """Results of one campaign of the report."""

    title: str
    summary: Summary
    units: Mapping[str, str]
    folder: str
    description: str
    is_complete: bool
    choice: Choice = "sample"


def combined_report(
    title: str, description: str, parts: Sequence[PartResult], provenance: Provenance, has_all: bool
) -> str:
    """Return the page; `has_all`: no part is missing."""
    number = sum(each.summary.count for each in parts)
    is_complete = has_all and all(each.is_complete for each in parts)
    return page(
        title,
        f"{description}: {number:,} variants, {provenance.date}",
        [
            single.incomplete(is_complete),
            *(_first(each) for each in parts),
            *(_evidence(each, number) for number, each in enumerate(parts)),
            section("Provenance", pairs(provenance.rows())),
        ],
        single.STYLE,
    )


def _first(part: PartResult) -> str:
    """Return what a part has found: a sentence, its numbers, a heat map or a table by its most important value."""
    summary = part.summary
    return section(
        part.title,
        single.lead(summary),
        single.tiles(summary, part.choice),
        by_value(summary, part.units) if single.has_forces(summary) else "",
        single.heat_section(summary, part.units, has_margin=False) if single.has_forces(summary) else "",
    )


def _evidence(part: PartResult, number: int) -> str:
    summary = part.summary
    name = part.title
    return "\n".join(
        [
            section(f"{name}: expectations", single.requirements(summary)),
            section(f"{name}: what drives it", *single.drivers(summary, part.choice)),
            section(f"{name}: distributions", *single.distributions(summary, f"part{number}-")),
            section(f"{name}: worst variants", single.worst(summary, part.units, part.folder)),
        ]
    )


def by_value(summary: Summary, units: Mapping[str, str]) -> str:
    """Return the forces by the values of the name that explains most of them; "": it has too many values."""
    top = next(iter(summary.force_indices), None)
    if top is None:
        return ""
    values = summary.values[top.name]
    distinct = np.unique(values)
    if len(distinct) > _FEW:
        return ""
    rows = []
    for value in distinct.tolist():
        force = summary.force[(values == value) & np.isfinite(summary.force)]
        if not len(force):
            continue
        over = 100.0 * float((force > single.LIMIT).mean())
        middle, high = (float(each) for each in np.quantile(force, (0.5, 0.95)))
        rows.append(
            (
                f"{value:g}",
                f"{len(force):,}",
                f"{middle:.0f} N",
                f"{high:.0f} N",
                f"{force.max():.0f} N",
                f"{over:.3g} %",
            )
        )
    label = f"{top.name} [{units[top.name]}]" if units.get(top.name) else top.name
    heads = (label, "closings", "median", "95 %", "largest", f"over {single.LIMIT:.0f} N")
    return f"<h3>Largest pinch force by {text(top.name)}</h3>" + table(heads, rows, ("r",) * 6)
