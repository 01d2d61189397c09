"""Campaign from its request, or the parts of a campaign file: `liftgate_hil.campaign`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from liftgate_hil.campaigns.file import is_campaign_file, read_campaign_file
from liftgate_hil.campaigns.parts import is_complete, run_parts
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.results import arrow
from liftgate_hil.campaigns.run import (
    NOBODY,
    CampaignFigures,
    CampaignOutcome,
    CampaignPlaces,
    CampaignWatcher,
    run_campaign,
)
from liftgate_hil.config.described import command
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.report.provenance import Provenance, provenance_of


# fmt: off
@dataclass(frozen=True)
class CampaignResult(DescribedResult):
    """Result of a campaign, or of the parts of a campaign file."""

    outcomes: tuple[CampaignOutcome, ...]
    is_of_parts: bool
    folder: Annotated[Path, Shown("folder with report.html; of a campaign also results.parquet and campaign.json, "
        "which each part has in a folder of its own")]
    is_complete: Annotated[bool, Shown("false: it was stopped; `resume` continues it")]

    @property
    def campaigns(self) -> Annotated[tuple[CampaignFigures, ...], Shown("figures of the campaign, or of each "
        "part")]:
        """Figures of the campaign, or of each part."""
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
    """Return the result of a campaign, or of the parts of a campaign file, whose files are written.

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
    outcomes = tuple(each.outcome for each in found)
    return CampaignResult(outcomes, True, places.output, is_complete(found, file))
