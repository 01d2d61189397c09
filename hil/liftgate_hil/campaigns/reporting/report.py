"""Report of a campaign as one HTML page: the findings on its first screen, the evidence below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from liftgate_hil.campaigns.distributions import Floats, clopper_pearson
from liftgate_hil.campaigns.folder import replay_line
from liftgate_hil.campaigns.reporting.heat_map import STYLE as HEAT_STYLE
from liftgate_hil.campaigns.reporting.heat_map import HeatMapCells, breakable, cells_of, heat_map, label_of
from liftgate_hil.campaigns.reporting.summary import FORCE, CampaignSummary, rest_of
from liftgate_hil.campaigns.results import MARGIN
from liftgate_hil.ecu.names import REFERENCE
from liftgate_hil.errors import with_unit
from liftgate_hil.plan.provenance import Provenance
from liftgate_hil.report.drawing import FINAL, INITIAL, INK, new_figure, style, svg
from liftgate_hil.report.numbers import axis_label, plain, significant
from liftgate_hil.report.page import Markup, alert, figure, page, pairs, section, table, text
from liftgate_hil.report.pinch import BORROWED

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FEW = 8  # values of a varied name that a sentence or a table lists
_TELLING = 0.1  # share of the variance from which a value is worth a sentence
Choice = Literal["sample", "grid", "search"]  # how the variants of a campaign were chosen
REFERENCE_LIMIT = 100.0  # N, with which forces are compared where none is judged: UN R21 5.8, borrowed
REFERENCE_ONLY = f"{REFERENCE_LIMIT:.0f} N, for reference only: UN R21 5.8, car windows"

STYLE = (
    HEAT_STYLE
    + """
.tiles { display: flex; flex-wrap: wrap; gap: .7rem; margin: 1rem 0 .6rem; }
.tile { border: 1px solid var(--grid); border-radius: .5rem; padding: .5rem .9rem; min-width: 8rem; flex: 1; }
.tile b { display: block; font-size: 1.7rem; line-height: 1.25; font-variant-numeric: tabular-nums; }
.tile span { color: var(--soft); font-size: .85rem; } .bad b { color: #b3261e; } .fine b { color: #00704f; }
@media (prefers-color-scheme: dark) { .bad b { color: #ff8a80; } .fine b { color: #2fc79c; } }
.bar { display: inline-block; height: .7em; background: var(--final); border-radius: .2em; }
code { font: .85em ui-monospace, monospace; overflow-wrap: anywhere; } p.lead { font-size: 1.05rem; }
th { vertical-align: bottom; } th.r { white-space: normal; } td code { white-space: nowrap; }
"""
)


def tile(number: str, words: str, kind: str = "") -> str:
    """Return a key number and its caption as an HTML tile; `kind` is "bad", "fine" or "", its colour."""
    return f'<div class="tile {kind}"><b>{text(number)}</b><span>{text(words)}</span></div>'


def report(
    title: str,
    summary: CampaignSummary,
    units: Mapping[str, str],
    folder: str,
    provenance: Provenance,
    more: Sequence[str] = (),
    choice: Choice = "sample",
    ecu: str = REFERENCE,
) -> str:
    """Return a campaign's report as an HTML page; `units` are those of varied names, `more` are further sections.

    `choice` is how the variants were chosen: only of a random sample a share is a probability. `ecu` names the
    ECU.
    """
    made_by = f"liftgate-hil {provenance.versions['liftgate-hil']}, {provenance.date}"
    return page(
        title,
        f"{summary.count:,} variants, ECU {ecu}, {made_by}",
        [
            lead(summary, units) + tiles(summary, choice),
            section("Expectations", requirements(summary)),
            *more,
            section("Where it happens", heat_section(summary, units)),
            section("What drives it", *drivers(summary, units, choice)),
            section("Distributions", *distributions(summary)),
            section("Worst variants", worst(summary, units, folder)),
            section(
                "Errors", table(("error", "variants"), [(e, str(n)) for e, n in summary.errors], ("name", "r"))
            ),
            section("Provenance", pairs(provenance.rows())),
        ],
        STYLE,
    )


def has_forces(summary: CampaignSummary) -> bool:
    """Whether anything was pinched in any variant."""
    return bool(np.nanmax(summary.force, initial=0.0) > 0.0)


def tiles(summary: CampaignSummary, choice: Choice = "sample") -> str:
    """Return key numbers (variants, failures, forces, errors) as HTML tiles; `choice` as for `report`."""
    total, failed = summary.count, summary.counts.get("fail", 0)
    wrong = summary.counts.get("error", 0)
    decided = total - wrong - summary.counts.get("inconclusive", 0)
    share = f"{100.0 * failed / decided:.3g} %" if decided else "—"
    means = {
        "sample": f"95 % interval {interval(failed, decided)}",
        "grid": "full grid, not a probability",
        "search": "chosen by the search, not a probability",
    }
    parts = [
        tile(f"{total:,}", "variants evaluated"),
        tile(share, f"fail: {failed:,} of {decided:,} decided ({means[choice]})", "bad" if failed else "fine"),
    ]
    if has_forces(summary):
        parts += _force_tiles(summary)
    if wrong:
        parts.append(tile(f"{wrong:,}", "errors: no result", "bad"))
    return f'<div class="tiles">{"".join(parts)}</div>'


def _force_tiles(summary: CampaignSummary) -> list[str]:
    """Return the HTML tiles of the largest pinch force, coloured only where a force limit is judged."""
    force = summary.force[np.isfinite(summary.force)]
    largest, limit = float(force.max()), summary.force_limit
    if limit is not None:
        words = f"largest pinch force; judged: at most {limit:g} N"
        return [tile(f"{largest:.0f} N", words, "fine" if largest < limit else "bad")]
    over = int((force > REFERENCE_LIMIT).sum())
    return [
        tile(f"{largest:.0f} N", "largest pinch force; no single limit is judged"),
        tile(f"{over:,}", f"variants press with more than {REFERENCE_ONLY}"),
    ]


def interval(failed: int, count: int) -> str:
    """Return the 95 % confidence interval of failed/count as text, in percent; "unknown" where `count` is 0."""
    if not count:
        return "unknown"
    low, high = clopper_pearson(failed, count)
    return f"{significant(100.0 * low, 2)} to {significant(100.0 * high, 2)} %"


def lead(summary: CampaignSummary, units: Mapping[str, str]) -> str:
    """Return a campaign's result in a sentence or two, as HTML; `units` are those of varied names."""
    counts = summary.counts
    failed = counts.get("fail", 0)
    decided = summary.count - counts.get("error", 0) - counts.get("inconclusive", 0)
    parts = []
    if failed:
        most = max(summary.expectations, key=lambda each: each.failed)
        parts.append(f"{failed:,} of {decided:,} variants fail, {most.failed:,} of them “{most.name}”.")
    elif summary.expectations and decided:
        parts.append(f"None of {decided:,} variants fails.")
    parts.append(_forces(summary, units))
    return f'<p class="lead">{text(" ".join(part for part in parts if part))}</p>'


def _forces(summary: CampaignSummary, units: Mapping[str, str]) -> str:
    """Return a sentence on the largest pinch forces by the value that explains most; "": none explains enough."""
    top = next(iter(summary.force_indices), None)
    if top is None or not has_forces(summary) or top.first_order < _TELLING:
        return ""
    values = summary.values[top.name]
    distinct = np.unique(values).tolist()
    if len(distinct) > _FEW:
        return f"{top.name} alone explains {100.0 * top.first_order:.0f} % of the variance of the force."
    found = [(each, np.nanmax(summary.force[values == each], initial=0.0)) for each in distinct]
    unit = units.get(top.name, "")
    shown = ", ".join(f"{force:.0f} N at {with_unit(f'{value:g}', unit)}" for value, force in found)
    return f"Largest force by {top.name}: {shown}."


def heat_section(summary: CampaignSummary, units: Mapping[str, str], has_margin: bool = True) -> str:
    """Return the heat maps over the two most influential values as HTML; "": fewer than two vary."""
    indices = {each.name: each.first_order for each in (summary.force_indices or summary.indices)}
    varying = [name for name, each in summary.values.items() if len(np.unique(each)) > 1]
    names = sorted(varying, key=lambda name: -indices.get(name, 0.0))[:2]
    if len(names) < 2:
        return ""
    across, down = sorted(names, key=lambda name: -len(np.unique(summary.values[name])))
    over = summary.values[across], summary.values[down]
    labels = label_of(across, units), label_of(down, units)
    parts = []
    if has_forces(summary):
        pinched = np.where(summary.force > 0.0, summary.force, np.nan)
        cells, limit = cells_of(*over, pinched, is_low_worst=False), summary.force_limit
        high = float(np.nanmax(cells.worst)) if limit is None else limit
        drawn = heat_map(cells, *labels, 0.25 * high, high, is_judged=limit is not None)
        colours = "" if limit is None else f" Red and framed: over the limit of {limit:g} N."
        what = "The worst of all other varied values in each cell." if len(varying) > 2 else ""
        why = _empty(cells, "nothing was pinched or known")
        parts.append(f'<h3>Largest pinch force [N]</h3>{drawn}<p class="key">{what}{colours}{why}</p>')
    if summary.driver != FORCE and has_margin:
        cells = cells_of(*over, summary.result, is_low_worst=True)
        high = float(np.nanmax(cells.worst)) if np.isfinite(cells.worst).any() else 1.0
        largest = float(np.nanmax(np.abs(cells.worst), initial=0.0))
        digits = 0 if largest >= 100.0 else 1 if largest >= 10.0 else 2
        drawn = heat_map(cells, *labels, max(high, 1e-9), 0.0, digits)
        parts.append(
            f"<h3>Smallest {text(_margin_label(summary))}</h3>{drawn}"
            f'<p class="key">Red and framed: it fails there.{_empty(cells, "none that was decided")}</p>'
        )
    return "".join(parts)


def _empty(cells: HeatMapCells, why: str) -> str:
    return f" ·: no variant, or {why}." if np.isnan(cells.worst).any() else ""


def requirements(summary: CampaignSummary) -> str:
    """Return the HTML table of expectations: numbers of verdicts, and the smallest margin."""
    rows = [
        (
            each.name,
            f"{each.passed:,}",
            Markup(f"<b>{each.failed:,}</b>") if each.failed else "0",
            f"{each.undecided:,}",
            with_unit(significant(each.least, 4), each.unit) if each.unit or each.least else "—",  # of a state
            Markup(f"<code>{text(each.variant[:12])}</code>"),
        )
        for each in summary.expectations
    ]
    heads = ("expectation", "pass", "fail", "inconclusive or error", "smallest margin", "in variant")
    note = f'<p class="soft">{text(BORROWED)}</p>' if summary.force_limit is not None else ""
    return table(heads, rows, ("name", "r", "r", "r", "r", "")) + note


def drivers(summary: CampaignSummary, units: Mapping[str, str], choice: Choice = "sample") -> list[str]:
    """Return the HTML tables of first-order Sobol indices; `units` and `choice` as for `report`.

    Variants that a search has chosen have none: their values depend on each other.
    """
    parts: list[str] = []
    if choice == "search":
        return parts
    for column, indices in ((summary.driver, summary.indices), (FORCE, summary.force_indices)):
        if not indices or (column == FORCE and parts and summary.driver == FORCE):
            continue
        rows: list[tuple[str, str, str, str]] = []
        for each in indices:
            span = f"{significant(each.low_mean, 3)} … {significant(each.high_mean, 3)}"
            at = with_unit(plain(float(f"{each.at_high:.4g}")), units.get(each.name, ""))
            rows.append((breakable(each.name), _bar(each.first_order), span, at))
        rows.append(("several together, or chance", _bar(rest_of(indices)), "", ""))
        what = _margin_words(column) if column.startswith(MARGIN) else axis_label(column)
        parts.append(f"<h3>{text(what)}</h3>")
        mean = _with_unit("lowest … highest mean of a class", column, summary)
        parts.append(
            table(("varied", "share of the variance", mean, "highest mean at"), rows, ("name", "n", "r", "r"))
        )
    if parts:
        parts.append(
            '<p class="soft">First-order Sobol indices of these variants: the share of variance that a value '
            "explains alone.</p>"
        )
    return parts


def _margin_label(summary: CampaignSummary) -> str:
    """Return the label, with unit, of the margin that the summary is about."""
    return _with_unit(_margin_words(summary.driver), summary.driver, summary)


def _margin_words(column: str) -> str:
    """Return the label of a column of margins, without its unit."""
    return f"margin of “{column.removeprefix(MARGIN)}”"


def _with_unit(words: str, column: str, summary: CampaignSummary) -> str:
    """Return a label with the unit of a result column, if it has one."""
    units = {f"{MARGIN}{each.name}": each.unit for each in reversed(summary.expectations)} | {FORCE: "N"}
    return label_of(words, {words: units.get(column, "")})


def _bar(share: float) -> Markup:
    return Markup(f'<span class="bar" style="width:{12.0 * share:.2f}rem"></span> {100.0 * share:.0f} %')


def distributions(summary: CampaignSummary, prefix: str = "") -> list[str]:
    """Return HTML histograms of forces and margins; `prefix` keeps their identifiers unique on a page."""
    parts = []
    if summary.every > 1:
        parts.append(f'<p class="soft">Of each {summary.every}th variant, as are heat maps and indices.</p>')
    force = summary.force[np.isfinite(summary.force)]
    if len(force) > 1 and force.max() > 0.0:
        limit = summary.force_limit
        line = REFERENCE_LIMIT if limit is None else limit
        words = REFERENCE_ONLY if limit is None else f"{limit:g} N, the limit that is judged"
        drawn = svg(_histogram(force, "largest pinch force [N]", line), f"{prefix}force", "histogram of forces")
        parts.append(figure(drawn, f"Largest pinch force of each variant; line: {words}.", small=True))
    if summary.driver != FORCE:
        result = summary.result[np.isfinite(summary.result)]
        if len(result) > 1:
            drawn = svg(_histogram(result, _margin_label(summary), 0.0), f"{prefix}margin", "histogram of margins")
            parts.append(figure(drawn, "Margins of the variants; left of the line they fail.", small=True))
    return parts


def _histogram(values: Floats, label: str, line: float) -> Figure:
    low, high = (float(each) for each in np.quantile(values, (0.001, 0.999)))
    with style():
        drawn = new_figure(2.4, 5.0)
        axis = drawn.subplots()
        bins = np.linspace(min(low, line), max(high, line) + 1e-9, 61)
        counts, _ = np.histogram(np.clip(values, bins[0], bins[-1]), bins)
        axis.bar(bins[:-1], counts, width=np.diff(bins), align="edge", color=FINAL)
        axis.axvline(line, color=INITIAL, linewidth=1.4)
        axis.set_xlabel(label)
        axis.set_ylabel("variants", color=INK)
        axis.locator_params(axis="y", integer=True)
    return drawn


def worst(summary: CampaignSummary, units: Mapping[str, str], folder: str) -> str:
    """Return the HTML table of the worst variants, with the command that runs one again; "": there are none."""
    has_margin = summary.driver != FORCE
    margin = [_with_unit("margin", summary.driver, summary)] if has_margin else []
    names = [breakable(label_of(each, units)) for each in summary.values]
    heads = ("variant", *names, "verdict", *margin, "force [N]")
    rows = [
        (
            Markup(f"<code>{text(each.variant[:12])}</code>"),
            *(plain(value) for value in each.values),
            each.verdict,
            *([significant(each.margin, 4)] if has_margin else []),
            significant(each.force, 4),
        )
        for each in summary.worst
    ]
    if not rows:
        return ""
    line = f"{replay_line(folder, summary.worst[0].variant)} --record worst.mf4"
    classes = ["" if each in ("variant", "verdict") else "r" for each in heads]
    return table(heads, rows, classes) + (
        '<p class="soft">Any of them again, bit for bit, with all signals and the reason of each verdict:</p>'
        f"<p><code>{text(line)}</code></p>"
    )


def incomplete(is_complete: bool) -> str:
    """Return the HTML alert that a campaign was stopped early; "": it is complete."""
    if is_complete:
        return ""
    return alert(["Incomplete: variants that were not evaluated stand as errors. Go on with --resume."])
