"""Report of several campaigns on one page: the findings of each on the first screen, the evidence below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from liftgate_hil.campaigns.reporting import report as single
from liftgate_hil.campaigns.reporting.heat_map import label_of
from liftgate_hil.campaigns.reporting.report import Choice
from liftgate_hil.campaigns.reporting.summary import CampaignSummary
from liftgate_hil.plan.provenance import Provenance
from liftgate_hil.report.page import page, pairs, section, table, text

_FEW = 8  # values of a varied name that are a table's rows


class PartResult(NamedTuple):
    """Results of one campaign in a combined report."""

    title: str
    summary: CampaignSummary
    units: Mapping[str, str]
    folder: str
    description: str
    is_complete: bool
    choice: Choice = "sample"


def combined_report(
    title: str, description: str, parts: Sequence[PartResult], provenance: Provenance, has_all: bool, ecu: str
) -> str:
    """Return a report of several campaigns as HTML; `has_all`: none is missing. `ecu` names the ECU."""
    number = sum(each.summary.count for each in parts)
    is_complete = has_all and all(each.is_complete for each in parts)
    return page(
        title,
        f"{description}: {number:,} variants, ECU {ecu}, {provenance.date}",
        [
            single.incomplete(is_complete),
            *(_main_section(each) for each in parts),
            *(_evidence(each, number) for number, each in enumerate(parts)),
            section("Provenance", pairs(provenance.rows())),
        ],
        single.STYLE,
    )


def _main_section(part: PartResult) -> str:
    """Return a campaign's main section as HTML: a sentence, key numbers, expectations, pinch forces."""
    summary = part.summary
    return section(
        part.title,
        single.lead(summary, part.units),
        single.tiles(summary, part.choice),
        single.requirements(summary),
        by_value(summary, part.units) if single.has_forces(summary) else "",
        single.heat_section(summary, part.units, has_margin=False) if single.has_forces(summary) else "",
    )


def _evidence(part: PartResult, number: int) -> str:
    summary = part.summary
    name = part.title
    return "\n".join(
        [
            section(f"{name}: what drives it", *single.drivers(summary, part.units, part.choice)),
            section(f"{name}: distributions", *single.distributions(summary, f"part{number}-")),
            section(f"{name}: worst variants", single.worst(summary, part.units, part.folder)),
        ]
    )


def by_value(summary: CampaignSummary, units: Mapping[str, str]) -> str:
    """Return an HTML table of pinch forces by the value that explains most; "": none, or too many values."""
    top = next(iter(summary.force_indices), None)
    if top is None:
        return ""
    values = summary.values[top.name]
    distinct = np.unique(values)
    if len(distinct) > _FEW:
        return ""
    judged = {} if summary.force_limit is None else {f"over {summary.force_limit:g} N": summary.force_limit}
    limits = {**judged, f"over {single.REFERENCE_LIMIT:g} N": single.REFERENCE_LIMIT}
    rows = []
    for value in distinct.tolist():
        force = summary.force[(values == value) & np.isfinite(summary.force)]
        if not len(force):
            continue
        middle, high = (float(each) for each in np.quantile(force, (0.5, 0.95)))
        forces = [f"{each:.0f} N" for each in (middle, high, force.max())]
        over = [f"{100.0 * float((force > limit).mean()):.3g} %" for limit in limits.values()]
        rows.append((f"{value:g}", f"{len(force):,}", *forces, *over))
    heads = (label_of(top.name, units), "variants", "median", "95 %", "largest", *limits)
    is_reference = single.REFERENCE_LIMIT not in judged.values()
    note = f'<p class="key">{text(single.REFERENCE_ONLY)}.</p>' if is_reference else ""
    return f"<h3>Largest pinch force by {text(top.name)}</h3>" + table(heads, rows, ["r"] * len(heads)) + note
