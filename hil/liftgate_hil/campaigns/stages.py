"""Stages of a campaign: a trial; its design, worst-case search or probability; a second ECU for comparison."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.campaign import Campaign, batch_size, batches_of
from liftgate_hil.campaigns.evaluation import Evaluator
from liftgate_hil.campaigns.executors.executor import Batch, Executor
from liftgate_hil.campaigns.folder import AGAINST, DIFFERENCES, RESULTS, WORST_FILE, Folder, replay_line
from liftgate_hil.campaigns.prepared import Pace, Prepared, units_of
from liftgate_hil.campaigns.reporting import adaptive_sections
from liftgate_hil.campaigns.reporting.comparison import comparison_of, comparison_section
from liftgate_hil.campaigns.request import PROBABILITY, WORST
from liftgate_hil.campaigns.results import without_results
from liftgate_hil.campaigns.space import Space, shares_of
from liftgate_hil.config.scenario import ScenarioFile
from liftgate_hil.config.settings import settings_of
from liftgate_hil.config.variant import AS_FILED, settings_for
from liftgate_hil.config.vehicle import VehicleFile
from liftgate_hil.ecu.find import is_foreign
from liftgate_hil.errors import ConfigError, with_unit
from liftgate_hil.plan.setup import variant_of

if TYPE_CHECKING:
    import pyarrow as pa

WORST_EVALUATIONS, PROBABILITY_EVALUATIONS = 500, 5000  # by default
MOST_UNFINISHED = 1_000_000  # variants that are listed as errors after a stop
_UNFINISHED = "stopped before it was evaluated"
_FOREIGN_S = 0.05  # s that a variant with a user's ECU is assumed to take
_POINTS = 32  # of the space, of which one has to be a variant
_OTHERS = 3  # variants in which each value of a grid is tried
_VALUES = 64  # of a grid that are tried: its ends, and some between


class Analysis(NamedTuple):
    """Findings of a stage in addition to its result rows, for campaign.json and the report."""

    content: dict[str, Any]  # for campaign.json
    sections: Sequence[str]  # of the report


NOTHING = Analysis({}, ())


def evaluate(found: Prepared, campaign: Campaign, folder: Folder, pace: Pace) -> Analysis:
    """Run a request's search or estimate and return its findings; of a design, only list the batches.

    Raises CampaignStoppedError, StoreError, LiftgateError.
    """
    if found.request.kind == WORST:
        return _search(found, campaign, folder)
    if found.request.kind == PROBABILITY:
        return _estimate(found, campaign)
    design = found.design
    assert design is not None
    size = batch_size(design.count, pace.workers, pace.seconds_each)
    campaign.progress.count = design.count
    campaign.asked += batches_of(found.base, design, size)
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
        adaptive_sections.worst_result(worst, name, variant, names, unit).to_dict(),
        [adaptive_sections.worst_section(worst, name, units_of(found), line, unit)],
    )


def _estimate(found: Prepared, campaign: Campaign) -> Analysis:
    from liftgate_hil.campaigns import adaptive

    request = found.request
    name = request.expectation
    budget = request.evaluations or PROBABILITY_EVALUATIONS
    estimate = adaptive.estimate_probability(campaign, found.space, name, budget, request.sampling_seed)
    return Analysis(
        adaptive_sections.probability_result(estimate, name).to_dict(),
        [adaptive_sections.probability_section(estimate, name)],
    )


def tables(found: Prepared, campaign: Campaign) -> Iterator[pa.Table]:
    """Iterate over the result tables of all batches; a design's are only evaluated now. Raises as `evaluate`."""
    return campaign.tables(campaign.asked) if found.design is None else campaign.evaluated(campaign.asked)


def unfinished(campaign: Campaign) -> Iterator[pa.Table]:
    """Yield a stopped campaign's tables, variants not evaluated as error rows; set `progress.done` to the others.

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
    """Evaluate the variants with the second ECU, write results, return the comparison. Raises as `evaluate`."""
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
    return Analysis({"against": comparison.to_dict()}, [comparison_section(comparison, units_of(found))])


def tried(found: Prepared) -> float:
    """Return how long a variant takes [s], measured in a trial; of a user's ECU, which is not loaded, a guess.

    Raises ConfigError where no variant can be made, or none with a value of a grid.
    """
    evaluator = Evaluator(found.base)
    try:
        middle = _check(evaluator, found.space)
        if is_foreign(found.base.job.request.ecu):
            return _FOREIGN_S
        evaluator.row(middle)  # loads the machine code
        return max(evaluator.row(middle).wall_s, 1e-4)
    finally:
        evaluator.close()


def _check(evaluator: Evaluator, space: Space) -> list[float]:
    """Return the values of a valid variant, the middle if possible; check some grid values. Raises ConfigError."""
    dimensions = len(space.targets)
    shares = np.vstack([np.full((1, dimensions), 0.5), shares_of(dimensions, _POINTS, "sobol", 0)])
    points: list[list[float]] = space.values(shares)[: _POINTS if dimensions else 1].tolist()
    issues = [_issue_of(evaluator, each) for each in points]
    sound = [point for point, issue in zip(points, issues, strict=True) if not issue]
    if not sound:
        raise ConfigError(f"`vary`: no variant can be made: {issues[0]}")
    wrong = []
    for axis in space.grids:
        column = space.names.index(axis.target.name)
        places = np.unique(np.linspace(0, len(axis.grid) - 1, _VALUES).round().astype(int))
        for value in (axis.grid[place] for place in places):
            others = [[*each[:column], value, *each[column + 1 :]] for each in sound[:_OTHERS]]
            if all(found := [_issue_of(evaluator, each) for each in others]):
                wrong.append(f"`vary` {axis.target.name}: {value:g}: {found[0]}")
    if wrong:
        raise ConfigError(wrong)
    return sound[0]


def _issue_of(evaluator: Evaluator, values: list[float]) -> str:
    """Return why a variant with these values is invalid; "": it is valid."""
    try:
        evaluator.plan(values)
    except ConfigError as error:
        issue = error.issues[0]
        # Of a parameter, the file's own words: nobody has given it by its name here.
        own = issue.partition(", as ")[2] if issue.startswith("`parameters`") else ""
        return own or issue.removeprefix("`parameters` ")
    return ""


def scenario_text(prepared: Prepared, values: Sequence[float], comment: str, folder: Path) -> str:
    """Return the text of a scenario file that runs as the variant with these values, at the campaign's rate.

    It names other files relative to the folder, so that both can be moved together.
    """
    base, request = prepared.base, prepared.base.job_of(values).request
    file, vehicle = request.scenario, request.vehicle
    assert isinstance(file, ScenarioFile)
    assert isinstance(vehicle, VehicleFile)
    lines = [f"# {line}" for line in comment.splitlines()]
    lines += [f"include = {json.dumps([_relative(file.path, folder)])}"]
    own, origin = prepared.request, base.job.request.vehicle
    assert isinstance(origin, VehicleFile)
    heads = {  # where they are not those of the included file
        "vehicle": None if own.vehicle is None else _name(origin.name, folder),
        "rig": None if own.rig is None else _name(str(own.rig), folder),
        "duration": own.duration,
        "seed": request.seed,
    }
    lines += [f"{name} = {_toml(value)}" for name, value in heads.items() if value is not None]
    parameters = request.parameter_values
    if parameters:
        lines += ["", "[parameters]", *(f"{name} = {value!r}" for name, value in parameters.items())]
    variant = variant_of(request.draw, request.ideal)
    settings = settings_of(request.settings)
    if variant != AS_FILED:
        settings = [*file.scenario(parameters).settings, *settings]
        settings = settings_for(vehicle.raw, variant, settings, str(vehicle.path))
    if settings:
        last = {each.key: each.value for each in settings}
        lines += ["", "[set]", *(f"{json.dumps(key)} = {_toml(value)}" for key, value in last.items())]
    return "\n".join(lines) + "\n"


def _name(name: str, folder: Path) -> str:
    return _relative(Path(name), folder) if Path(name).is_file() else name


def _relative(path: Path, folder: Path) -> str:
    return os.path.relpath(path.resolve(), folder.resolve())


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(value)
