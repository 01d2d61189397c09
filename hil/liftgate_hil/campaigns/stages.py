"""Stages of a campaign: its design, search or probability, and the same variants with another ECU."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.campaign import Campaign, batch_size, batches_in, batches_of
from liftgate_hil.campaigns.executors.executor import Batch, Executor
from liftgate_hil.campaigns.folder import AGAINST, DIFFERENCES, RESULTS, WORST_FILE, Folder, replay_line
from liftgate_hil.campaigns.prepared import Prepared, units_of
from liftgate_hil.campaigns.reporting import adaptive_sections
from liftgate_hil.campaigns.reporting.comparison import comparison_of, comparison_section
from liftgate_hil.campaigns.request import PROBABILITY, WORST
from liftgate_hil.campaigns.results import without_results
from liftgate_hil.campaigns.resumption import Pace
from liftgate_hil.campaigns.scenario_file import scenario_text
from liftgate_hil.errors import with_unit

if TYPE_CHECKING:
    import pyarrow as pa

WORST_EVALUATIONS, PROBABILITY_EVALUATIONS = 500, 5000  # by default
MOST_UNFINISHED = 1_000_000  # variants that are listed as errors after a stop
_UNFINISHED = "stopped before it was evaluated"


class Analysis(NamedTuple):
    """What a stage has found beside its rows."""

    content: dict[str, Any]  # for campaign.json
    sections: Sequence[str]  # of the report


NOTHING = Analysis({}, ())


def evaluate(found: Prepared, campaign: Campaign, folder: Folder, pace: Pace) -> Analysis:
    """Evaluate all variants of a request, but those of a design: `tables` does, as its results are written.

    Raises StoppedError, StoreError, LiftgateError.
    """
    if found.request.kind == WORST:
        return _search(found, campaign, folder)
    if found.request.kind == PROBABILITY:
        return _estimate(found, campaign)
    design = found.design
    assert design is not None
    size = batch_size(design.count, pace.workers, pace.seconds_each)
    campaign.progress.count = design.count
    campaign.asked += batches_in(found.base, design, size)
    return NOTHING


def _search(found: Prepared, campaign: Campaign, folder: Folder) -> Analysis:
    from liftgate_hil.campaigns import adaptive

    request, names = found.request, found.space.names
    name = request.expectation
    budget = request.evaluations or WORST_EVALUATIONS
    worst = adaptive.search_worst(campaign, found.space, name, budget, request.sampling_seed)
    least = adaptive_sections.least_of(worst.everything)
    variant, unit = "", found.base.margin_units[found.base.expectations.index(name)]
    if least is not None:
        variant = found.base.variant(least.values)
        margin = with_unit(f"{least.margin:.6g}", unit)
        comment = f"Smallest margin of {name!r} that was found: {margin}.\nvariant {variant}"
        folder.write(WORST_FILE, scenario_text(found, least.values, comment, folder.path).encode())
    line = replay_line(folder.path, variant)
    return Analysis(
        adaptive_sections.worst_as_dict(worst, name, variant, names, unit),
        [adaptive_sections.worst_section(worst, name, units_of(found), line, unit)],
    )


def _estimate(found: Prepared, campaign: Campaign) -> Analysis:
    from liftgate_hil.campaigns import adaptive

    request = found.request
    name = request.expectation
    budget = request.evaluations or PROBABILITY_EVALUATIONS
    estimate = adaptive.estimate_probability(campaign, found.space, name, budget, request.sampling_seed)
    return Analysis(
        adaptive_sections.probability_as_dict(estimate, name),
        [adaptive_sections.probability_section(estimate, name)],
    )


def tables(found: Prepared, campaign: Campaign) -> Iterator[pa.Table]:
    """Return the tables of all batches, those of a design as they are evaluated. Raises as `evaluate`."""
    return campaign.tables(campaign.asked) if found.design is None else campaign.evaluated(campaign.asked)


def unfinished(campaign: Campaign) -> Iterator[pa.Table]:
    """Yield the tables of all batches; variants that were not evaluated are errors.

    Of very many, those beyond MOST_UNFINISHED are left out: their number is in campaign.json.
    """
    left, kept = MOST_UNFINISHED, 0
    for batch in campaign.asked:
        table = campaign.stored(batch)
        if table is not None:
            kept += table.num_rows
            yield table
        elif left > 0:
            values = batch.values[:left]
            left -= len(values)
            yield without_results(campaign.base, values, _UNFINISHED)
    campaign.progress.done = kept  # of a batch that was not stored, nothing is kept


def evaluate_against(
    found: Prepared, campaign: Campaign, folder: Folder, executor_of: Callable[[Base], Executor]
) -> Analysis:
    """Evaluate the same variants with the other ECU, and compare. Raises as `evaluate`."""
    base = found.against
    assert base is not None
    executor = executor_of(base)
    campaign.progress.count *= 2
    batches: list[Batch] = []
    for own in campaign.asked:
        batches += batches_of(base, own.values, own.count)
    other = replace(campaign, base=base, executor=executor, asked=batches)
    try:
        folder.write_results(other.evaluated(batches), AGAINST)
    finally:
        executor.close()
    ecus, names = (str(found.request.ecu), str(found.request.against)), found.space.names
    comparison = comparison_of(folder.path / RESULTS, folder.path / AGAINST, names, base.expectations, ecus)
    folder.write_results([comparison.differing], DIFFERENCES)
    return Analysis({"against": comparison.as_dict()}, [comparison_section(comparison, units_of(found))])
