"""Campaign files: their content, what is refused, and what the flags of the command replace."""

from __future__ import annotations

from pathlib import Path

import pytest

from liftgate_hil.campaigns.file import CampaignFile, is_campaign_file, read_campaign_file
from liftgate_hil.campaigns.prepared import prepared
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.config.shipped import data_root, shipped_names
from liftgate_hil.errors import ConfigError

TWO = """
title = "Both"
description = "of two"

[[part]]
name = "first"
title = "The first"
scenario = "own.toml"
vary = ["rod=1,2", "angle~uniform(20,60)"]
samples = 30
method = "lhs"

[[part]]
name = "second"
scenario = "demo"
vary = ["angle=20:60:5", "seed=1,2"]
"""


def write(folder: Path, content: str = TWO) -> str:
    path = folder / "both.toml"
    path.write_text(content)
    (folder / "own.toml").write_text("duration = 1.0\n[parameters]\nrod = 1\nangle = 2\n")
    return str(path)


def read(folder: Path, content: str = TWO, **more: object) -> CampaignFile:
    name = write(folder, content)
    return read_campaign_file(name, CampaignRequest(name, **{"vary": (), **more}))  # type: ignore[arg-type]


def refusal(folder: Path, content: str, **more: object) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(folder, content, **more)
    return list(caught.value.issues)


def test_each_part_of_a_file_becomes_a_campaign_request(tmp_path: Path) -> None:
    found = read(tmp_path)
    assert (found.title, found.description) == ("Both", "of two")
    first, second = (each.request for each in found.parts)
    assert first == CampaignRequest(
        str(tmp_path / "own.toml"), ("rod=1,2", "angle~uniform(20,60)"), samples=30, method="lhs"
    )
    assert second == CampaignRequest("demo", ("angle=20:60:5", "seed=1,2"), method="sobol")


def test_a_part_or_a_file_without_a_title_is_titled_by_its_name(tmp_path: Path) -> None:
    parts = read(tmp_path).parts
    assert [(each.name, each.title) for each in parts] == [("first", "The first"), ("second", "second")]
    assert read(tmp_path, TWO.replace('title = "Both"\n', "", 1)).title == "both"


def test_flags_of_the_command_apply_to_all_parts(tmp_path: Path) -> None:
    more = {"ecu": "mutant:threshold_too_high", "vehicle": "compact", "seed": 7, "settings": ("gate.mass=31",)}
    for part in read(tmp_path, **more).parts:
        request = part.request
        assert (request.ecu, request.vehicle, request.seed) == ("mutant:threshold_too_high", "compact", 7)
        assert request.settings == ("gate.mass=31",)


@pytest.mark.parametrize(
    ("vary", "first", "second"),
    [
        (("angle = 30,40",), ("rod=1,2", "angle = 30,40"), ("angle = 30,40", "seed=1,2")),
        (("rod~loguniform(1,9)", "angle=5"), ("rod~loguniform(1,9)", "angle=5"), ("angle=5", "seed=1,2")),
    ],
)
def test_vary_replaces_the_grid_or_distribution_of_a_name_in_each_part_that_has_it(
    tmp_path: Path, vary: tuple[str, ...], first: tuple[str, ...], second: tuple[str, ...]
) -> None:
    assert [each.request.vary for each in read(tmp_path, vary=vary).parts] == [first, second]


def test_vary_does_not_replace_a_name_that_only_has_the_same_prefix(tmp_path: Path) -> None:
    content = TWO.replace('"seed=1,2"', '"draw=1,2"').replace("rod=1,2", "rod.x=1,2")
    assert refusal(tmp_path, content, vary=("rod=5",)) == [
        f"`vary` rod=5: allowed: names that a part of {tmp_path / 'both.toml'} varies"
    ]


def test_vary_of_a_name_that_no_part_varies_is_refused(tmp_path: Path) -> None:
    messages = refusal(tmp_path, TWO, vary=("rod=1", "gate.mass=30,31", "draw=1"))
    allowed = f"allowed: names that a part of {tmp_path / 'both.toml'} varies"
    assert messages == [f"`vary` gate.mass=30,31: {allowed}", f"`vary` draw=1: {allowed}"]


def test_samples_replaces_the_number_only_in_parts_that_have_one(tmp_path: Path) -> None:
    assert [each.request.samples for each in read(tmp_path, samples=5).parts] == [5, None]


@pytest.mark.parametrize(
    ("vary", "samples", "expected"),
    [("supply.voltage~uniform(9,12)", 5, [5, 5]), ("gate.mass=30,31", 0, [None, None])],
)
def test_samples_follows_whether_vary_adds_or_removes_the_only_distribution_of_a_part(
    tmp_path: Path, vary: str, samples: int, expected: list[int | None]
) -> None:
    content = (
        '[[part]]\nname = "a"\nscenario = "demo"\nvary = ["supply.voltage=9,12"]\n'
        '[[part]]\nname = "b"\nscenario = "demo"\nvary = ["gate.mass~uniform(30,31)"]\nsamples = 9\n'
    )
    requests = [each.request for each in read(tmp_path, content, vary=(vary,), samples=samples).parts]
    assert [prepared(each).request.samples for each in requests] == expected


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("part = 5", "{path}: part: 5; allowed: [[part]] tables"),
        ("part = []", "{path}: part: []; allowed: [[part]] tables"),
        ('title = 5\n[[part]]\nname = "a"\nscenario = "demo"', "{path}: title: 5; allowed: a text"),
        ('colour = 5\n[[part]]\nname = "a"\nscenario = "demo"', "{path}: colour: "),
        ('[[part]]\nscenario = "demo"', "{path}: part[0].name: missing"),
        ('[[part]]\nname = "a"', "{path}: part[0].scenario: missing"),
        ('[[part]]\nname = "a"\nscenario = "demo"\nvarys = 1', "{path}: part[0].varys: "),
        ('[[part]]\nname = "a"\nscenario = "demo"\nvary = [1]', "{path}: part[0].vary: [1]; allowed: a list of "),
        ('[[part]]\nname = "a"\nscenario = "demo"\nsamples = -1', "{path}: part[0].samples: -1; allowed: "),
        ('[[part]]\nname = "a"\nscenario = "demo"\nmethod = "grid"', "{path}: part[0].method: 'grid'; allowed: "),
        *(
            (
                f'[[part]]\nname = "{name}"\nscenario = "demo"',
                f"{{path}}: part[0].name: '{name}'; allowed: a name of a folder",
            )
            for name in ("a/b", "../a", ".", "..", ".hidden", "/a")
        ),
        (
            '[[part]]\nname = "a"\nscenario = "demo"\n[[part]]\nname = "a"\nscenario = "demo"',
            "{path}: part: a: two parts with this name; allowed: each name once",
        ),
    ],
)  # fmt: skip
def test_an_invalid_campaign_file_is_refused_with_file_key_and_value(
    content: str, message: str, tmp_path: Path
) -> None:
    issues = refusal(tmp_path, content)
    assert len(issues) == 1
    assert issues[0].startswith(message.format(path=tmp_path / "both.toml"))


def test_all_issues_of_all_parts_are_reported_at_once(tmp_path: Path) -> None:
    content = '[[part]]\nname = "a/b"\nscenario = "demo"\n[[part]]\nsamples = "many"\nscenario = "demo"'
    assert len(refusal(tmp_path, content)) == 3
    assert refusal(tmp_path, 'part = ["a"]')[0].startswith(f"{tmp_path / 'both.toml'}: part[0]: ")


def test_a_missing_campaign_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "none.toml"
    with pytest.raises(ConfigError, match=str(path)):
        read_campaign_file(str(path), CampaignRequest(str(path), ()))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("pack:nothing", "`scenario` pack:nothing: allowed: .*pack:trap-matrix"),
        *(
            (name, "allowed: pack:")
            for name in ("pack:../campaigns/trap-matrix", "pack:", "pack:/etc/passwd", "pack/trap-matrix")
        ),
    ],
)
def test_an_unknown_shipped_campaign_is_refused_with_the_existing_ones(name: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        read_campaign_file(name, CampaignRequest(name, ()))


def test_only_toml_files_with_parts_are_campaign_files(tmp_path: Path) -> None:
    name = write(tmp_path)
    broken = tmp_path / "broken.toml"
    broken.write_text("= [")
    other = tmp_path / "both.txt"
    other.write_text(TWO)
    assert is_campaign_file(name)
    assert is_campaign_file("pack:trap-matrix")
    for each in (tmp_path / "own.toml", broken, other, tmp_path, tmp_path / "none.toml", "demo"):
        assert not is_campaign_file(str(each))


@pytest.mark.parametrize("name", shipped_names("configs/campaigns"))
def test_each_part_of_a_shipped_campaign_can_be_prepared(name: str) -> None:
    found = read_campaign_file(f"pack:{name}", CampaignRequest(f"pack:{name}", ()))
    assert found.description
    assert found.title != name
    for part in found.parts:
        made = prepared(part.request)
        assert made.base.expectations
        assert made.space.targets


def test_the_shipped_trap_matrix_has_its_rods_and_2000_undisturbed_samples() -> None:
    found = read_campaign_file("pack:trap-matrix", CampaignRequest("pack:trap-matrix", ()))
    rods, undisturbed = found.parts
    assert (rods.name, undisturbed.name) == ("rods", "undisturbed")
    assert rods.request.vary[0] == "rod=10000,20000,65000"
    assert Path(rods.request.scenario) == data_root() / "configs/campaigns/trap-matrix/rod.toml"
    assert undisturbed.request.samples == 2000


def test_flags_shorten_the_trap_matrix() -> None:
    given = ("angle=40", "seed=1,2", "environment.road_slope_deg=0,8")
    found = read_campaign_file("pack:trap-matrix", CampaignRequest("pack:trap-matrix", given, samples=8))
    rods, undisturbed = (each.request for each in found.parts)
    assert {"angle=40", "seed=1,2", "environment.road_slope_deg=0,8"} < set(rods.vary)
    assert undisturbed.samples == 8
    assert len(rods.vary) == 6


@pytest.mark.parametrize(
    "name", ["campaign.json", "results.parquet", "report.html", "batches", "DATA.md", "Report.HTML"]
)
def test_a_part_named_like_an_output_file_of_a_campaign_is_refused(tmp_path: Path, name: str) -> None:
    (line,) = refusal(tmp_path, TWO.replace('"second"', f'"{name}"'))
    assert line.endswith(f"part[1].name: '{name}': a campaign's own file; allowed: another name")
