"""Setup of a recording takes precedence over the scenario's, and arguments over both."""

from __future__ import annotations

from pathlib import Path

import pytest

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.dashboard.recorded import RecordingSource
from liftgate_hil.formats.mcap_layout import ABOUT_PARQUET
from liftgate_hil.plan.recorded_setup import RecordedSetup, recorded_setup
from liftgate_hil.plan.setup import vehicle_from
from liftgate_hil.testing.rejudge import as_recorded, expectations_of
from liftgate_hil.testing.request import JudgeRequest

SCENARIO = """description = "opens"
duration = 0.2
rig = "liftgate"
[parameters]
limit = 50.0
[[expect]]
name = "soft"
never = "pinch_force_n > $limit"
"""


@pytest.fixture(scope="module", params=["parquet", "mf4", "mcap"])
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a compact car with a changed motor, its own rig and another limit."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "s.toml").write_text(SCENARIO)
    rig = Path(__file__).parents[3] / "configs" / "rigs" / "liftgate.toml"
    (folder / "own.toml").write_text(rig.read_text() + "\n")
    path = folder / f"run.{request.param}"
    lh.run(
        folder / "s.toml", vehicle="compact", settings=["motor.resistance=0.9"], ecu="reference", record=[path],
        rig=folder / "own.toml", parameters={"limit": 70.0},
    )  # fmt: skip
    return path


def test_the_setup_of_a_recording_overrides_that_of_the_scenario(recording: Path) -> None:
    about, notes = as_recorded([recording], expectations_of(JudgeRequest(recording, recording.parent / "s.toml")))
    assert about.setup.vehicle == vehicle_from("compact", ["motor.resistance=0.9"])
    assert about.setup.scenario.parameters == {"limit": 70.0}
    assert Path(about.rig.source) == recording.parent / "own.toml"
    assert [note.removeprefix(f"{recording}: ") for note in notes] == [
        "limit 70.0 as recorded, not 50.0",
        "rig own as recorded, not liftgate",
        "vehicle compact as recorded, not suv",
    ]


def test_arguments_override_the_setup_of_a_recording(recording: Path) -> None:
    request = JudgeRequest(
        recording, recording.parent / "s.toml", vehicle="suv", rig="liftgate", parameters={"limit": 60.0}
    )
    given = expectations_of(request)
    about, notes = as_recorded([recording], given)
    assert about is given or about.setup.vehicle == given.setup.vehicle
    assert about.setup.scenario.parameters == {"limit": 60.0}
    assert [note.removeprefix(f"{recording}: ") for note in notes] == [
        "limit 60.0 as given, not 70.0 as recorded",
        "rig liftgate as given, not own as recorded",
        "vehicle suv as given, not compact as recorded",
    ]


def test_the_command_reports_the_setup_it_uses_from_the_recording(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["judge", str(recording), "--scenario", str(recording.parent / "s.toml")]) == 0
    assert "note: " in (said := capsys.readouterr().err)
    assert "vehicle compact as recorded, not suv" in said


def test_a_rig_file_changed_since_the_recording_is_not_used(recording: Path) -> None:
    own = recording.parent / "own.toml"
    before = own.read_text()
    own.write_text(before + "\n# changed\n")
    try:
        about, notes = as_recorded(
            [recording], expectations_of(JudgeRequest(recording, recording.parent / "s.toml"))
        )
    finally:
        own.write_text(before)
    assert Path(about.rig.source).name == "liftgate.toml"
    assert f"{recording}: its rig is missing or has changed; judged by liftgate" in notes


def test_a_page_of_a_recording_shows_the_limits_of_its_scenario_if_its_file_is_unchanged(recording: Path) -> None:
    about = RecordingSource(recording).about()
    assert about["expectations"] == {"soft": "never pinch_force_n > 70"}
    assert about["force_limits"] == [{"force_n": 70.0, "longest_s": 0.0, "expectation": "soft"}]
    scenario = recording.parent / "s.toml"
    scenario.write_text(SCENARIO + "\n# changed\n")
    try:
        about = RecordingSource(recording).about()
    finally:
        scenario.write_text(SCENARIO)
    assert (about["expectations"], about["force_limits"]) == ({}, [])


@pytest.mark.parametrize("vehicle", [{}, {"drives": 2}, None, 5, {"drives": 2, "left": 1}])
def test_an_incomplete_or_invalid_recorded_vehicle_is_ignored(vehicle: object) -> None:
    assert RecordedSetup(Path("x"), {"vehicle": vehicle}).vehicle is None


def test_files_without_provenance_give_no_setup(tmp_path: Path) -> None:
    (tmp_path / "x.mf4").write_text("no MF4")
    (tmp_path / "x.csv").write_text("time_s,a\n0,1\n")
    assert recorded_setup([tmp_path / "x.mf4", tmp_path / "x.csv"]).content == {}


@pytest.mark.parametrize(
    "about", ["{damaged", "[1]", '"x"', '{"rate_hz": "fast", "faults": 3, "vehicle": 7}', "1"]
)
def test_a_damaged_provenance_gives_no_setup_and_no_error(tmp_path: Path, about: str) -> None:
    from pyarrow import parquet

    lh.run("demo", duration=0.1, record=[tmp_path / "run.parquet"])
    table = parquet.read_table(tmp_path / "run.parquet")
    path = tmp_path / "damaged.parquet"
    kept = {**table.schema.metadata, ABOUT_PARQUET.encode(): about.encode()}
    parquet.write_table(table.replace_schema_metadata(kept), path)
    (tmp_path / "s.toml").write_text('[[expect]]\nname = "a"\nalways = "gate_angle_deg < 90"\n')
    assert lh.judge([path], tmp_path / "s.toml").verdicts["a"].verdict == "pass"
    assert RecordingSource(path).state(0.05)["acting"]["spring_health"] == {}
