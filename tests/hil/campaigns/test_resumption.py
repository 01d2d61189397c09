"""A campaign is resumed only where its inputs are the same."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from liftgate_hil.campaigns.folder import MANIFEST, Folder
from liftgate_hil.campaigns.prepared import Pace, Prepared, pace_before, prepared
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.errors import ConfigError

SHORT = """
duration = 1.0
initial = "open"

[parameters]
rod = 10_000
other = 1
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    part, path = tmp_path / "part.toml", tmp_path / "short.toml"
    part.write_text(SHORT)
    path.write_text('include = ["part.toml"]\n')
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    made = Folder(tmp_path / "out")
    made.create()
    return made


def campaign_of(scenario: Path, *vary: str, **more: Any) -> Prepared:
    return prepared(CampaignRequest(str(scenario), vary or ("rod=1,2",), **more))


def begun(folder: Folder, found: Prepared, **changed: Any) -> None:
    """Write campaign.json as a campaign does when it begins."""
    content = {
        "identity": found.base.identity,
        "request": found.request.kept(),
        "seconds_each": 0.01,
        "workers": 4,
        "files": {name: each._asdict() for name, each in found.plan.sources.items()},
        "versions": dict(found.base.versions),
    }
    (folder.path / MANIFEST).write_text(json.dumps({"format": 2, **content, **changed}))


def refusal(folder: Folder, found: Prepared) -> str:
    with pytest.raises(ConfigError) as caught:
        pace_before(folder, found, is_resumed=True)
    (message,) = caught.value.issues
    return message


def assert_differs(folder: Folder, found: Prepared, *names: str) -> None:
    assert refusal(folder, found) == (
        f"`resume` {folder.path}: {', '.join(names)}: not as the campaign began; "
        "allowed: the same files, versions and arguments"
    )


@pytest.mark.parametrize("is_resumed", [False, True])
def test_a_folder_without_a_campaign_begins_a_new_one(is_resumed: bool, folder: Folder, scenario: Path) -> None:
    assert pace_before(folder, campaign_of(scenario), is_resumed) is None


def test_a_folder_with_a_campaign_is_not_overwritten_without_resume(folder: Folder, scenario: Path) -> None:
    found = campaign_of(scenario)
    begun(folder, found)
    message = f"`output` {folder.path}: has a campaign; allowed: another folder, or `resume`"
    with pytest.raises(ConfigError, match=message):
        pace_before(folder, found, is_resumed=False)


def test_the_same_campaign_resumes_with_its_time_per_variant(folder: Folder, scenario: Path) -> None:
    more = {"parameters": {"rod": 5.0}, "settings": ("gate.mass=31",), "seed": 3}
    begun(folder, campaign_of(scenario, "supply.voltage=9,12", **more))
    again = campaign_of(scenario, "supply.voltage=9,12", **more)
    assert pace_before(folder, again, is_resumed=True) == Pace(0.01, 4)


@pytest.mark.parametrize(
    ("more", "names"),
    [
        ({"vary": ("rod=1,3",)}, ("vary",)),
        ({"vary": ("rod~uniform(1,2)",), "samples": 8}, ("vary", "samples")),
        ({"seed": 5}, ("seed",)),
        ({"draw": 5}, ("draw",)),
        ({"ideal": True}, ("ideal",)),
        ({"rate": 2000.0, "duration": 0.5}, ("rate", "duration")),
        ({"settings": ("gate.mass=31",)}, ("settings",)),
        ({"parameters": {"other": 2.0}}, ("parameters",)),
        ({"ecu": "mutant:threshold_too_high"}, ("ecu",)),
        ({"against": "mutant:threshold_too_high"}, ("against",)),
        ({"sampling_seed": 2}, ("sampling_seed",)),
    ],
)
def test_changed_arguments_are_reported_by_name(
    more: dict[str, Any], names: tuple[str, ...], folder: Folder, scenario: Path
) -> None:
    found = campaign_of(scenario)
    begun(folder, found)
    assert_differs(folder, prepared(found.request.replaced(**more)), *names)


def test_another_vehicle_is_reported(folder: Folder, scenario: Path) -> None:
    begun(folder, campaign_of(scenario))
    assert ": vehicle" in refusal(folder, campaign_of(scenario, vehicle="compact"))


def test_a_changed_file_is_reported_by_its_role_and_included_files_count_too(
    folder: Folder, scenario: Path
) -> None:
    begun(folder, campaign_of(scenario))
    content = scenario.read_text()
    scenario.write_text(content + "# another content\n")
    assert_differs(folder, campaign_of(scenario), "scenario")
    scenario.write_text(content)
    (scenario.parent / "part.toml").write_text(SHORT.replace("duration = 1.0", "duration = 1.5"))
    assert "not as the campaign began" in refusal(folder, campaign_of(scenario))


def test_another_version_is_reported_with_its_package(folder: Folder, scenario: Path) -> None:
    found = campaign_of(scenario)
    begun(folder, found, versions={**found.base.versions, "liftgate-hil": "0.0"})
    assert_differs(folder, found, "liftgate-hil")


@pytest.mark.parametrize(
    "pace",
    [
        *({"workers": each} for each in (None, "many", {}, 0, -3)),
        *({"seconds_each": each} for each in (None, [], math.nan)),
    ],
)
def test_a_manifest_with_invalid_timing_is_refused(pace: dict[str, Any], folder: Folder, scenario: Path) -> None:
    found = campaign_of(scenario)
    begun(folder, found, **pace)
    told = f"{folder.path / MANIFEST}: seconds_each, workers: allowed: as the campaign has written them"
    assert refusal(folder, found) == told


@pytest.mark.parametrize(
    "changed",
    [
        {"files": None},
        {"files": []},
        {"files": {"vehicle": 5}},
        {"versions": None},
        {"request": None},
        {"request": []},
    ],
)
def test_a_manifest_with_invalid_fields_counts_as_another_campaign(
    changed: dict[str, Any], folder: Folder, scenario: Path
) -> None:
    found = campaign_of(scenario)
    begun(folder, found, **changed)
    assert "not as the campaign began" in refusal(folder, found)


@pytest.mark.parametrize("content", ["", "{", "[]", "null", '{"format": 0}', "\x00"])
def test_a_resume_reports_an_invalid_manifest_in_one_message(content: str, folder: Folder, scenario: Path) -> None:
    (folder.path / MANIFEST).write_text(content)
    assert refusal(folder, campaign_of(scenario)).startswith(f"{folder.path / MANIFEST}: ")


def test_an_empty_manifest_counts_as_another_campaign(folder: Folder, scenario: Path) -> None:
    (folder.path / MANIFEST).write_text(json.dumps({"format": 2}))
    message = refusal(folder, campaign_of(scenario))
    assert "scenario" in message
    assert "liftgate-hil" in message


def test_a_request_is_the_same_after_a_round_trip_through_json(scenario: Path) -> None:
    request = CampaignRequest(
        str(scenario), ("rod=1,2",), settings=("gate.mass=31",), parameters={"rod": 1.0}, duration=2.0
    )
    assert json.loads(json.dumps(request.kept())) == request.kept()
    assert CampaignRequest.of_kept(request.kept()) == request
