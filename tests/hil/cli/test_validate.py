"""`validate`: the fit of a model and of given parameters to a measurement."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
from fitting_files import KEPT, TRUTH, call, complaint, driven, noisy, read_columns, settings, simulated
from fitting_files import write_columns as write

OUTPUTS = (*KEPT, "gate_angle_deg")


@pytest.fixture(scope="module")
def opening(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Measurement of the reference SUV with the parameters TRUTH, opening at 8 V for 2.5 s."""
    folder = tmp_path_factory.mktemp("opening")
    out = simulated(folder, driven(2.5, 8.0), *settings(TRUTH))
    return write(folder / "opening.csv", noisy(out, OUTPUTS))


def fit(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    assert call("validate", *arguments, "--json", "--quiet") == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    result: dict[str, Any] = json.loads(captured.out)
    return result


def test_the_residuals_of_the_true_model_are_the_noise(capsys: pytest.CaptureFixture[str], opening: Path) -> None:
    result = fit(capsys, opening, *settings(TRUTH))
    assert result["rms"]["left_current_a"] == pytest.approx(0.05, rel=0.1)
    assert result["rms"]["gate_angle_deg"] == pytest.approx(0.1, rel=0.1)
    assert result["fit_percent"]["left_current_a"] > 90.0
    assert result["whiteness"]["left_current_a"]


def test_an_output_with_an_offset_is_reported_and_noise_is_not(
    capsys: pytest.CaptureFixture[str], opening: Path
) -> None:
    true = settings(TRUTH)
    assert not [each for each in fit(capsys, opening, *true)["warnings"] if "on average" in each]
    table = opening.with_name("offset.toml")
    table.write_text('[columns]\nleft_current_a = { name = "left_current_a", offset = 1.0 }\n')
    result = fit(capsys, opening, *true, "--map", table)
    (warning,) = [each for each in result["warnings"] if "on average" in each]
    assert warning.endswith("left_current_a is 1.0 A above the simulation on average: has its sensor an offset?")
    assert result["mean"]["left_current_a"] == pytest.approx(1.0, abs=0.01)
    assert result["experiments"][0]["mean_std"]["left_current_a"] == pytest.approx(0.05 / 1251**0.5, rel=0.3)
    assert call("validate", opening, *true, "--map", table) == 0
    assert "white about its mean" in capsys.readouterr().out


def test_a_motor_without_its_own_input_is_noted_as_driven_like_the_other(
    capsys: pytest.CaptureFixture[str], opening: Path, tmp_path: Path
) -> None:
    assert not [each for each in fit(capsys, opening)["notes"] if "is driven as" in each]
    kept = {name: column for name, column in read_columns(opening).items() if name != "right_voltage_v"}
    notes = fit(capsys, write(tmp_path / "left.csv", kept))["notes"]
    (note,) = [each for each in notes if "is driven as" in each]
    assert note.endswith("no right_voltage_v or right_duty: the right motor is driven as the left one")


def test_a_wrong_model_fits_worse_and_is_not_fitted(capsys: pytest.CaptureFixture[str], opening: Path) -> None:
    right = fit(capsys, opening, *settings(TRUTH))
    wrong = fit(capsys, opening)
    for name in ("left_current_a", "left_position_rev", "gate_angle_deg"):
        assert wrong["fit_percent"][name] < right["fit_percent"][name] - 1.0


def test_a_result_of_identify_fits_like_the_vehicle_it_saved(
    capsys: pytest.CaptureFixture[str], opening: Path, tmp_path: Path
) -> None:
    result, saved = tmp_path / "result.json", tmp_path / "saved.toml"
    names = ",".join([*TRUTH, "gate.gravity_point[0]"])
    flags = ("--result", result, "--save-vehicle", saved, "--quiet")
    assert call("identify", opening, "--estimate", names, *flags) == 0
    by_result = fit(capsys, opening, "--parameters", result)
    by_vehicle = fit(capsys, opening, "--vehicle", saved)
    assert by_result["fit_percent"] == pytest.approx(by_vehicle["fit_percent"])
    identified = json.loads(result.read_text(encoding="utf-8"))["fit_percent"]
    assert by_vehicle["fit_percent"] == pytest.approx(identified, rel=1e-6)


def test_unidentifiable_parameters_of_a_result_are_not_used(
    capsys: pytest.CaptureFixture[str], opening: Path, tmp_path: Path
) -> None:
    path = tmp_path / "result.json"
    content = {
        "parameters": {"motor.resistance": {"value": TRUTH["motor.resistance"]}, "gate.mass": {"value": 999.0}},
        "identifiable": {"motor.resistance": True, "gate.mass": False},
    }
    path.write_text(json.dumps(content), encoding="utf-8")
    mine = {"motor.resistance": TRUTH["motor.resistance"]}
    expected = fit(capsys, opening, *settings(mine))
    assert fit(capsys, opening, "--parameters", path)["rms"] == expected["rms"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "allowed: a result written by identify"),
        ("[1]", "allowed: a result written by identify"),
        ('{"parameters": {}}', "allowed: a result written by identify"),
        (
            '{"parameters": {"motor.resistance": {"value": null}}, "identifiable": {"motor.resistance": true}}',
            "allowed: a result written by identify",
        ),
        (
            '{"parameters": {"motor.power": {"value": 1}}, "identifiable": {"motor.power": true}}',
            "motor.power: no such parameter",
        ),
        (
            '{"parameters": {"gate.mass": {"value": -1}}, "identifiable": {"gate.mass": true}}',
            "gate.mass: -1; allowed:",
        ),
    ],
)
def test_a_file_that_is_no_result_of_identify_is_refused(
    capsys: pytest.CaptureFixture[str], opening: Path, tmp_path: Path, content: str, said: str
) -> None:
    path = tmp_path / "result.json"
    path.write_text(content, encoding="utf-8")
    (line,) = complaint(capsys, "validate", opening, "--parameters", path)
    assert str(path) in line
    assert said in line


def test_reports_are_written_and_quiet_prints_nothing(
    capsys: pytest.CaptureFixture[str], opening: Path, tmp_path: Path
) -> None:
    result, page = tmp_path / "fit.json", tmp_path / "fit.html"
    assert call("validate", opening, "--result", result, "--html", page, "--quiet") == 0
    assert capsys.readouterr() == ("", "")
    assert "left_current_a" in json.loads(result.read_text(encoding="utf-8"))["fit_percent"]
    assert page.read_text(encoding="utf-8").rstrip().endswith("</html>")


def test_result_and_page_name_their_source_files(
    opening: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    result, page = tmp_path / "result.json", tmp_path / "page.html"
    assert call("validate", opening, "--result", result, "--html", page, "--quiet") == 0
    origin = json.loads(result.read_text())["provenance"]
    assert origin["command_line"].startswith(f"liftgate-hil validate {opening} --result")
    assert origin["date"] == "2023-11-14T22:13:20+00:00"
    assert origin["sources"]["measurement 1"] == {
        "path": str(opening),
        "sha256": hashlib.sha256(opening.read_bytes()).hexdigest(),
    }
    assert Path(origin["sources"]["vehicle"]["path"]).name == "suv.toml"
    assert "rig" not in origin["sources"]  # no bus log
    shown = page.read_text(encoding="utf-8")
    for each in (origin["sources"]["measurement 1"]["sha256"], origin["date"], "numba"):
        assert each in shown


def test_the_printed_text_has_only_the_chosen_outputs(capsys: pytest.CaptureFixture[str], opening: Path) -> None:
    assert call("validate", opening, "--outputs", "current", *settings(TRUTH)) == 0
    text = capsys.readouterr().out
    assert opening.name in text
    assert "left_current_a" in text
    assert "gate_angle_deg" not in text


def test_estimated_initial_states_are_shown(
    capsys: pytest.CaptureFixture[str], opening: Path, tmp_path: Path
) -> None:
    lines = opening.read_text(encoding="utf-8").splitlines(keepends=True)
    cut, page = tmp_path / "cut.csv", tmp_path / "cut.html"
    cut.write_text("".join([lines[0], *lines[800:]]), encoding="utf-8")  # begins in motion
    states = fit(capsys, cut, *settings(TRUTH), "--html", page)["initial_states"]
    speed = next(state for name, state in states.items() if name.endswith(": speed"))
    assert speed["value"] > 50.0
    assert 0.0 < speed["std"] < 1.0
    assert "Initial states" in page.read_text(encoding="utf-8")
    assert call("validate", cut, *settings(TRUTH)) == 0
    text = capsys.readouterr().out
    assert "Initial states" in text
    assert "cut.csv: speed" in text


def test_an_output_given_twice_counts_once(capsys: pytest.CaptureFixture[str], opening: Path) -> None:
    once = fit(capsys, opening, "--outputs", "current")
    twice = fit(capsys, opening, "--outputs", "current,current")
    assert twice.pop("provenance") != once.pop("provenance")  # another command line
    assert twice == once


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["none.csv"], "none.csv"),
        (["--outputs", "speed"], "not measured"),
        (["--result", "no/where.json"], "no folder"),
        (["--parameters", "none.json"], "cannot be read"),
        (["--to", "0.001"], "allowed: 20 or more"),
        (["--step", "1"], "1e-05 to 0.005"),
        (["--model", "fourth-order"], "invalid choice"),
    ],
)
def test_a_wrong_flag_is_one_line(
    capsys: pytest.CaptureFixture[str], opening: Path, flags: list[str], said: str
) -> None:
    (line,) = complaint(capsys, "validate", opening, *flags)
    assert said in line


def test_a_call_without_a_file_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    (line,) = complaint(capsys, "validate")
    assert "FILE" in line


@pytest.mark.parametrize("inertia", [4e-6, 6e-6, 1.1e-5])
def test_no_initial_state_is_estimated_for_a_light_motor_that_starts_at_the_first_sample(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, inertia: float
) -> None:
    file = Path(__file__).parents[3] / "docs/examples/car.toml"
    car = ("--vehicle", file, "--set", f"motor.rotor_inertia={inertia}")
    path = tmp_path / "step.csv"
    assert call("simulate", *car, "--voltage", 12, "--duration", 2, "--output", path) == 0
    capsys.readouterr()
    result = fit(capsys, path, *car)
    assert min(result["fit_percent"].values()) > 99.9
    assert result["initial_states"] == {}
