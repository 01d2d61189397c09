"""The function `liftgate_hil.campaign`: runs the campaign of a request, or all parts of a campaign file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from liftgate_hil.campaigns.file import CampaignFile, is_campaign_file, read_campaign_file
from liftgate_hil.campaigns.folder import REPORT, Folder
from liftgate_hil.campaigns.prepared import inputs_of, prepared, units_of
from liftgate_hil.campaigns.reporting.combined import PartResult, combined_report
from liftgate_hil.campaigns.reporting.summary import CampaignSummary
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.results import arrow
from liftgate_hil.campaigns.run import (
    NOBODY,
    CampaignFigures,
    CampaignOutcome,
    CampaignPlaces,
    CampaignWatcher,
    choice_of,
    run_campaign,
)
from liftgate_hil.config.described import command
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.provenance import Provenance, provenance_of


def run_parts(
    file: CampaignFile, places: CampaignPlaces, provenance: Provenance, watcher: CampaignWatcher = NOBODY
) -> list[CampaignOutcome]:
    """Run the campaigns of a file one after the other, write one combined report, and return their outcomes.

    After a stop the last outcome is not complete, and there are no later ones. Raises as `run_campaign`.
    """
    folder = Folder(places.output)
    if folder.has_campaign:
        raise ConfigError(f"`output` {folder.path}: has a campaign; allowed: another folder")
    inputs = [file.path]
    for part in file.parts:  # all, before the first has run for hours
        inputs += inputs_of(prepared(part.request))
    folder.create()
    found: list[CampaignOutcome] = []
    with folder.claimed():
        folder.make_way([REPORT], inputs, watcher.say)
        for part in file.parts:
            own = Folder(places.output / part.name)
            # A part that has not begun yet begins; the others go on.
            is_resumed = places.is_resumed and own.has_campaign
            there = replace(places, output=own.path, is_resumed=is_resumed)
            if places.store:
                there = replace(there, store=f"{places.store.rstrip('/')}/{part.name}")
            found.append(run_campaign(part.request, there, provenance, watcher))
            if not found[-1].is_complete:
                break
        results = [
            _result_of(part.title, each, each.summary)
            for part, each in zip(file.parts, found, strict=False)
            if each.summary is not None
        ]
        if results:
            is_whole = len(found) == len(file.parts)
            ecu = str(file.parts[0].request.ecu)  # the flag applies to all parts
            html = combined_report(file.title, file.description, results, provenance, is_whole, ecu)
            folder.write(REPORT, html.encode())
        folder.tidy()
    return found


def _result_of(title: str, outcome: CampaignOutcome, summary: CampaignSummary) -> PartResult:
    return PartResult(
        title,
        summary,
        units_of(outcome.prepared),
        str(outcome.folder.path),
        outcome.prepared.plan.setup.scenario.description,
        outcome.is_complete,
        choice_of(outcome.prepared),
    )


# fmt: off
@dataclass(frozen=True)
class CampaignResult(DescribedResult):
    """Result of a campaign, or of the parts of a campaign file."""

    _asks = "result.is_complete, or the verdicts of result.campaigns"

    outcomes: tuple[CampaignOutcome, ...]
    is_of_parts: bool
    folder: Annotated[Path, Shown("folder with report.html; of a campaign also results.parquet and campaign.json, "
        "which each part has in a folder of its own")]
    is_complete: Annotated[bool, Shown("false: it was stopped; `resume` continues it")]

    @property
    def campaigns(self) -> Annotated[tuple[CampaignFigures, ...], Shown("figures of the campaign, or of each "
        "part")]:
        """Statistics of each campaign: of the only one, or of each part of a campaign file."""
        return tuple(each.figures for each in self.outcomes)


# fmt: on
@command(CampaignRequest)
def campaign(request: CampaignRequest) -> CampaignResult:
    """Run many variants of a scenario: all combinations, samples, a search for the worst, a probability.

        campaign("trap.toml", ["rod=5000,10000", "angle=20:60:5"], output="rods").campaigns[0].verdicts

    The rows are in results.parquet of its folder, one for each variant. Raises ConfigError, and StoreError where
    the folder fails.
    """
    return campaigned(request, provenance_of(repr(request), {}))


def campaigned(
    request: CampaignRequest, provenance: Provenance, watcher: CampaignWatcher = NOBODY
) -> CampaignResult:
    """Run the campaign of a request, or all parts of a campaign file; write the files, return the result.

    Raises as `run_campaign`.
    """
    arrow()  # before hours of evaluations whose results could not be written
    places = CampaignPlaces(
        Path(request.output), str(request.store or ""), request.scheduler or "", request.jobs or 0, request.resume
    )
    if not is_campaign_file(str(request.scenario)):
        outcome = run_campaign(request, places, provenance, watcher)
        return CampaignResult((outcome,), False, places.output, outcome.is_complete)
    file = read_campaign_file(str(request.scenario), request)
    found = run_parts(file, places, provenance, watcher)
    is_complete = len(found) == len(file.parts) and all(each.is_complete for each in found)
    return CampaignResult(tuple(found), True, places.output, is_complete)
