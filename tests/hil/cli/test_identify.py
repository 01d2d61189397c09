"""`identify`: true parameters are found within their stated uncertainty, and bad data give no number."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fitting_files import (
    KEPT,
    NAMES,
    TRUTH,
    Floats,
    call,
    complaint,
    driven,
    noisy,
    read_columns,
    settings,
    simulated,
    write_columns,
)

from liftgate_hil.config.shipped import find_config
from liftgate_hil.errors import ConfigError
from liftgate_hil.identification.assembly import _check_beginnings
from liftgate_hil.identification.data import Data
from liftgate_hil.plan.setup import vehicle_from

SIGMAS = 4.0  # six seeds out of ten thousand are further off


@pytest.fixture(scope="module")
def opening(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Measurement of the reference SUV with the parameters TRUTH, opening at 8 V for 2.5 s."""
    folder = tmp_path_factory.mktemp("opening")
    out = simulated(folder, driven(2.5, 8.0), *settings(TRUTH))
    return write_columns(folder / "opening.csv", noisy(out, (*KEPT, "gate_angle_deg")))


@pytest.fixture
def columns(opening: Path) -> dict[str, Floats]:
    return read_columns(opening)


def found(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    # Quiet: the first one on a machine says that it compiles.
    assert call("identify", *arguments, "--json", "--quiet") == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    result: dict[str, Any] = json.loads(captured.out)
    return result


def assert_true(result: dict[str, Any], truth: dict[str, float], largest: float = 0.05) -> None:
    """Assert that every value is within SIGMAS of the truth, and its uncertainty small enough to be meaningful."""
    assert list(result["parameters"]) == list(truth)
    for name, value in truth.items():
        each = result["parameters"][name]
        assert result["identifiable"][name], (name, each)
        assert 0.0 < each["std"] < largest * value, (name, each)
        assert abs(each["value"] - value) < SIGMAS * each["std"], (name, each, value)


def test_true_parameters_are_found_from_currents_and_hall_counts(
    capsys: pytest.CaptureFixture[str], opening: Path
) -> None:
    result = found(capsys, opening, "--estimate", NAMES)
    assert_true(result, TRUTH)
    assert result["parameters"]["motor.resistance"]["initial"] == 0.708
    assert result["fit_percent"]["left_current_a"] > 90.0
    assert result["noise_outputs"] == ["left_current_a", "left_position_rev", "gate_angle_deg"]
    variances = np.diag(result["noise_variance"])
    assert variances[0] == pytest.approx(0.05**2, rel=0.15)
    assert variances[2] == pytest.approx(0.1**2, rel=0.15)
    deviations = np.sqrt(np.diag(result["covariance"]))
    assert deviations == pytest.approx([each["std"] for each in result["parameters"].values()])
    assert np.diag(result["correlation"]) == pytest.approx(np.ones(3))
    for key in ("loss", "fpe", "aic", "bic", "condition_number", "stop_reason"):
        assert key in result


@pytest.mark.parametrize("output", ["current", "position", "angle"])
def test_one_kind_of_output_is_enough_for_one_parameter(
    capsys: pytest.CaptureFixture[str], opening: Path, output: str
) -> None:
    truth = {"motor.resistance": TRUTH["motor.resistance"]}
    others = settings({name: value for name, value in TRUTH.items() if name not in truth})
    result = found(capsys, opening, "--estimate", "motor.resistance", "--outputs", output, *others)
    assert_true(result, truth, largest=0.2)
    assert len(result["noise_outputs"]) == 1


def test_opening_and_closing_on_a_slope_are_identified_together(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    truth = {"motor.resistance": 0.6, "gate.mass": 45.0}
    files = []
    for name, duty, initial, slope in (("up", 0.7, "closed", 8.0), ("down", -0.7, "open", -6.0)):
        times = driven(2.5, 1.0)
        inputs = {
            "time_s": times["time_s"],
            "left_duty": duty * np.clip(times["voltage_v"], 0.0, 1.0),
            "supply_voltage_v": 13.0 + 0.5 * np.sin(3.0 * times["time_s"]),
            "road_slope_deg": np.full(len(times["time_s"]), slope),
        }
        inputs["right_duty"] = inputs["left_duty"]
        flags = ("--vehicle", "heavy-suv", "--initial", initial, *settings(truth))
        out = simulated(tmp_path, inputs, *flags)
        kept = noisy(out, ("left_current_a", "left_hall_count", "gate_angle_deg"))
        files.append(write_columns(tmp_path / f"{name}.csv", {**inputs, **kept}))
    result = found(capsys, *files, "--vehicle", "heavy-suv", "--estimate", ",".join(truth))
    assert_true(result, truth)
    assert [each["name"] for each in result["experiments"]] == [str(each) for each in files]


def test_each_file_may_have_its_own_initial_angle(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    # A current alone does not say where the gate is.
    files = []
    for initial, volts in (("closed", 9.0), ("open", -9.0)):
        out = simulated(tmp_path, driven(2.5, volts), "--initial", initial, *settings(TRUTH))
        kept = ("time_s", "left_voltage_v", "right_voltage_v", "left_current_a")
        files.append(write_columns(tmp_path / f"{initial}.csv", noisy(out, kept)))
    result = found(capsys, *files, "--estimate", NAMES, "--initial", "closed,open")
    assert_true(result, TRUTH)
    assert result["initial_states"] == {}
    for text, said in (
        ("closed,open,open", "--initial closed,open,open: 3 values for 2 files; allowed: one for all"),
        ("closed,ajar", "--initial ajar: allowed: auto, pause, closed, open"),
    ):
        lines = complaint(capsys, "identify", *files, "--estimate", NAMES, "--initial", text)
        assert len(lines) == 1
        assert said in lines[0]


def test_a_file_given_twice_is_refused(capsys: pytest.CaptureFixture[str], opening: Path) -> None:
    again = opening.parent / "." / opening.name
    lines = complaint(capsys, "identify", opening, again, "--estimate", NAMES)
    assert len(lines) == 1
    assert "given twice" in lines[0]


def test_the_result_records_the_settings(capsys: pytest.CaptureFixture[str], opening: Path) -> None:
    given = ("--set", "motor.torque_constant=0.0113")
    result = found(capsys, opening, "--estimate", "motor.resistance", *given)
    assert "suv: with motor.torque_constant=0.0113" in result["notes"]


def test_parameters_of_two_different_drives_are_identified_from_their_columns(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    truth = {"left.motor.resistance": 0.9, "right.motor.resistance": 1.1}
    out = simulated(tmp_path, driven(2.5, 9.0), *settings(truth))
    kept = (*KEPT, "right_current_a", "right_hall_count")
    path = write_columns(tmp_path / "unlike.csv", noisy(out, kept))
    assert_true(found(capsys, path, "--estimate", ",".join(truth)), truth)
    lines = complaint(capsys, "identify", path, "--estimate", "motor.resistance", *settings(truth))
    assert lines == [
        "liftgate-hil: --estimate motor.resistance: differs between the drives; allowed: "
        "left.motor.resistance, right.motor.resistance"
    ]


def test_an_unmeasured_drive_is_not_identifiable(capsys: pytest.CaptureFixture[str], opening: Path) -> None:
    result = found(capsys, opening, "--estimate", "left.motor.resistance,right.motor.inductance")
    assert result["identifiable"] == {"left.motor.resistance": True, "right.motor.inductance": False}
    assert result["parameters"]["right.motor.inductance"]["remark"]


def test_data_that_begin_in_motion_are_identified(capsys: pytest.CaptureFixture[str], opening: Path) -> None:
    result = found(capsys, opening, "--estimate", NAMES, "--from", 0.8)
    assert_true(result, TRUTH, largest=0.2)
    assert result["initial_states"]


def test_true_parameters_are_found_from_decimated_and_resampled_data(
    capsys: pytest.CaptureFixture[str], opening: Path, columns: dict[str, Floats]
) -> None:
    slow = opening.with_name("slow.csv")
    write_columns(slow, {name: values[::2] for name, values in columns.items()})
    flags = ("--estimate", NAMES, "--decimate", 3)
    for more, counts in (((), (417, 209)), (("--resample", 200), (167, 167))):
        result = found(capsys, opening, slow, *flags, *more)
        assert_true(result, TRUTH)
        samples = [each["samples"]["gate_angle_deg"] for each in result["experiments"]]
        assert samples == [count - 2 for count in counts]
        notes = [note for note in result["notes"] if "decimated by 3 after a low-pass filter" in note]
        assert all(f": {count} samples of" in note for count, note in zip(counts, notes, strict=True))
        assert all(("resampled to 200 Hz" in note) == bool(more) for note in notes)
    lines = complaint(capsys, "identify", opening, slow, "--estimate", NAMES, "--decimate", 150)
    assert lines == [
        f"liftgate-hil: {opening}: 9 rows; allowed: 20 or more",
        f"liftgate-hil: {slow}: 5 rows; allowed: 20 or more",
    ]


def test_rest_after_a_motion_is_inferred_from_timestamps_or_stated_by_the_initial_flag(
    capsys: pytest.CaptureFixture[str], opening: Path, columns: dict[str, Floats]
) -> None:
    late = write_columns(opening.with_name("late.csv"), columns | {"time_s": columns["time_s"] + 5})
    flags = ("--vehicle", "heavy-suv", "--estimate", "motor.resistance")
    for file, initial, expected in (
        (opening, "auto", False),
        (opening, "pause", True),
        (late, "auto", True),
        (late, "closed", False),
    ):
        result = found(capsys, file, *flags, "--initial", initial)
        states = {name.rpartition(" ")[2] for name in result["initial_states"]}
        expects = {"left_position", "right_ahead", "angle", "warmth", "housing_warmth"}
        assert states == {"left_offset", *(expects if expected else ())}
        assert any("begins at rest after a motion" in note for note in result["notes"]) == expected


def test_one_drive_has_no_left_or_right_names(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    truth = {"motor.resistance": 1.2}
    out = simulated(tmp_path, driven(2.0, 9.0), "--vehicle", "compact", *settings(truth))
    kept = tuple(name for name in KEPT if not name.startswith("right"))
    path = write_columns(tmp_path / "compact.csv", noisy(out, kept))
    compact = ("--vehicle", "compact")
    assert_true(found(capsys, path, *compact, "--estimate", "motor.resistance"), truth)
    lines = complaint(capsys, "identify", path, *compact, "--estimate", "right.motor.resistance")
    assert "no such parameter" in lines[0]


def test_the_saved_vehicle_keeps_comments_and_settings_and_can_be_loaded(
    capsys: pytest.CaptureFixture[str], opening: Path, tmp_path: Path
) -> None:
    saved, again = tmp_path / "saved.toml", tmp_path / "again.toml"
    point = "gate.gravity_point[0]"
    result = found(
        capsys, opening, "--estimate", f"{NAMES},{point}", "--set", "supply.voltage=12.5",
        "--save-vehicle", saved,
    )  # fmt: skip
    text = saved.read_text(encoding="utf-8")
    assert "# The reference SUV." in text
    assert "# ohm" in text
    vehicle = vehicle_from(str(saved))
    value = {name: each["value"] for name, each in result["parameters"].items()}
    assert vehicle.supply.voltage == 12.5
    assert vehicle.left.motor.resistance == value["motor.resistance"]
    assert vehicle.right.motor.resistance == value["motor.resistance"]
    assert vehicle.gate.gravity_point == (value[point], -0.45)
    origin = tomllib.loads(text)["identification"]
    assert origin["files"] == [str(opening)]
    assert origin["parameters"] == [*TRUTH, point]
    assert np.array(origin["covariance"]) == pytest.approx(np.array(result["covariance"]))
    second = found(
        capsys, opening, "--vehicle", saved, "--estimate", "motor.resistance",
        "--save-vehicle", again,
    )  # fmt: skip
    assert second["parameters"]["motor.resistance"]["initial"] == value["motor.resistance"]
    assert again.read_text(encoding="utf-8").count("[identification]") == 1
    assert call("simulate", "--vehicle", again, "--voltage", 9, "--duration", 0.1) == 0


def test_unidentifiable_parameters_keep_their_value_in_the_saved_vehicle(opening: Path, tmp_path: Path) -> None:
    saved = tmp_path / "saved.toml"
    names = "left.motor.resistance,right.motor.inductance"
    assert call("identify", opening, "--estimate", names, "--quiet", "--save-vehicle", saved) == 0
    vehicle = vehicle_from(str(saved))
    assert vehicle.right.motor.inductance == 4.37e-5
    origin = tomllib.loads(saved.read_text(encoding="utf-8"))["identification"]
    assert origin["not_identifiable"] == ["right.motor.inductance"]


def test_all_reports_are_written_and_quiet_prints_nothing(
    capsys: pytest.CaptureFixture[str], opening: Path, tmp_path: Path
) -> None:
    result, page = tmp_path / "result.json", tmp_path / "page.html"
    flags = ("--result", result, "--html", page, "--profile", "motor.resistance", "--quiet")
    assert call("identify", opening, "--estimate", "motor.resistance", *flags) == 0
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")
    written = json.loads(result.read_text(encoding="utf-8"))
    limits = written["profiles"]["motor.resistance"]
    assert limits["low"] < written["parameters"]["motor.resistance"]["value"] < limits["high"]
    assert page.read_text(encoding="utf-8").rstrip().endswith("</html>")


def test_a_far_too_large_initial_resistance_is_corrected(
    capsys: pytest.CaptureFixture[str], opening: Path
) -> None:
    others = settings({name: value for name, value in TRUTH.items() if name != "motor.resistance"})
    flags = ("--estimate", "motor.resistance", "--set", "motor.resistance=40", *others)
    assert_true(found(capsys, opening, *flags), {"motor.resistance": TRUTH["motor.resistance"]})


def test_a_bound_limits_the_estimate_and_is_reported(capsys: pytest.CaptureFixture[str], opening: Path) -> None:
    lines = complaint(
        capsys, "identify", opening, "--estimate", "motor.resistance",
        "--bounds", "motor.resistance=0.7:0.72",
    )  # fmt: skip
    assert "motor.resistance: at its bound 0.72" in lines[0]


def test_a_prior_of_tiny_deviation_overrides_the_data(capsys: pytest.CaptureFixture[str], opening: Path) -> None:
    result = found(capsys, opening, "--estimate", "motor.resistance", "--prior", "motor.resistance=0.8:1e-9")
    assert result["parameters"]["motor.resistance"]["value"] == pytest.approx(0.8, abs=1e-6)


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ([], ["--estimate: missing"]),
        (["--estimate", " , "], ["--estimate  , : allowed: names"]),
        (["--estimate", "motor.resistence,gear.foo"], ["motor.resistence: no such", "gear.foo: no such"]),
        (["--estimate", "motor.resistance,motor.resistance"], ["motor.resistance: given twice"]),
        (
            ["--estimate", "motor.resistance,left.motor.resistance"],
            ["left.motor.resistance: is part of motor.resistance; allowed: one of them"],
        ),
        (["--bounds", "motor.resistance=5:1"], ["LOW below HIGH"]),
        (["--bounds", "motor.resistance=nan:1"], ["LOW below HIGH"]),
        (["--bounds", "motor.resistance=1:5"], ["the initial value 0.708 is outside"]),
        (["--bounds", "motor.resistance=5"], ["allowed: KEY=LOW:HIGH"]),
        (
            ["--bounds", "motor.resistance=0.1:5", "--bounds", "motor.resistance=0.2:5"],
            ["--bounds motor.resistance: given twice"],
        ),
        (
            ["--bounds", "gear.ratio=1:5", "--prior", "gear.inertia=1:1"],
            ["--bounds gear.ratio: not among", "--prior gear.inertia: not among"],
        ),
        (["--prior", "motor.resistance=1:-1"], ["allowed: a finite mean"]),
        (["--prior", "motor.resistance=nan:1"], ["allowed: a finite mean"]),
        (["--noise", "foo=1"], ["OUTPUT one of current, speed, position, angle"]),
        (["--noise", "current=1"], ["--noise: not given for left_position_rev, gate_angle_deg"]),
        (["--outputs", "foo,bar"], ["--outputs foo", "--outputs bar"]),
        (["--outputs", ""], ["--outputs : allowed: names"]),
        (["--outputs", "speed"], ["not measured; allowed: current, position, angle"]),
        (["--profile", "gear.ratio"], ["--profile gear.ratio: allowed: motor.resistance"]),
        (["--initial", "ajar"], ["allowed: auto, pause, closed, open"]),
        (["--input-delay", "5"], ["allowed: -0.5 to 0.5 s"]),
        (["--from", "100"], ["no row"]),
        (["--cut-angle", "85:90"], ["the gate is never there"]),
        (["--vehicle", "truck"], ["--vehicle truck"]),
        (["--rig", "theirs"], ["--rig theirs"]),
        (["--set", "motor.power=1"], ["motor.power"]),
        (["--map", "left_current_a=Iq[mA]"], ["left_current_a: no column 'Iq'"]),
        (
            ["--result", "no/where.json", "--html", "no/where.html"],
            ["--result no/where.json: no folder", "--html no/where.html: no folder"],
        ),
        (["--plan"], ["--plan: takes no FILE"]),
    ],
)
def test_wrong_flags_are_reported_one_per_line(
    capsys: pytest.CaptureFixture[str], opening: Path, flags: list[str], said: list[str]
) -> None:
    estimate = ["--estimate", "motor.resistance"] if "--estimate" not in flags and flags else []
    lines = complaint(capsys, "identify", opening, *estimate, *flags)
    assert len(lines) == len(said)
    for line, part in zip(lines, said, strict=True):
        assert part in line


def test_results_are_not_written_over_an_input_or_two_of_them_to_one_file(
    capsys: pytest.CaptureFixture[str], opening: Path, tmp_path: Path
) -> None:
    before = opening.read_bytes()
    estimate = ("--estimate", "motor.resistance")
    link = tmp_path / "link.json"
    link.symlink_to(opening)
    lines = complaint(capsys, "identify", opening, *estimate, "--result", link)
    assert "is an input file; allowed: a separate file" in lines[0]
    same = tmp_path / "same"
    lines = complaint(capsys, "identify", opening, *estimate, "--result", same, "--html", same)
    assert "--result writes it; allowed: a separate file" in lines[0]
    assert not same.exists()
    assert opening.read_bytes() == before


def test_issues_of_all_files_are_reported_at_once(
    capsys: pytest.CaptureFixture[str], opening: Path, tmp_path: Path
) -> None:
    empty = tmp_path / "empty.csv"
    empty.write_text("", encoding="utf-8")
    rubbish = tmp_path / "rubbish.mf4"
    rubbish.write_bytes(bytes(range(256)) * 20)
    lines = complaint(capsys, "identify", opening, empty, rubbish, tmp_path / "none.csv", "--preset", "thesis-1")
    assert all(name in line for name, line in zip(("empty", "rubbish", "none"), lines, strict=True))


def _spoiled(columns: dict[str, Floats], how: str) -> dict[str, Floats]:
    times = columns["time_s"]
    rest = np.zeros(len(times))
    random = np.random.default_rng(1)
    noise = 0.05 * random.standard_normal(len(times))
    currents = {"left_current_a": noise, "gate_angle_deg": 2.0 * noise}
    volts = {"time_s": times, "voltage_v": columns["left_voltage_v"]}
    return {
        "no input": {"time_s": times, "road_slope_deg": rest, "left_current_a": columns["left_current_a"]},
        "no output": volts,
        "no time": {name: each for name, each in columns.items() if name != "time_s"},
        "time backwards": {**columns, "time_s": np.append(times[:-1], 0.5)},
        "milliseconds": {**volts, "time_s": 1e3 * times, "left_current_a": columns["left_current_a"]},
        "mA": {**columns, "left_current_a": 1e3 * columns["left_current_a"]},
        "three times the voltage": {
            **columns,
            "left_voltage_v": 3.0 * columns["left_voltage_v"],
            "right_voltage_v": 3.0 * columns["right_voltage_v"],
        },
        "a current that is noise": {**volts, "left_current_a": noise},
        "rpm": {**columns, "left_speed_rps": 60.0 * np.gradient(columns["left_hall_count"] / 4.0, times)},
        "rad": {**columns, "gate_angle_deg": np.radians(columns["gate_angle_deg"])},
        "angle down": {**columns, "gate_angle_deg": -columns["gate_angle_deg"]},
        "nothing driven": {**columns, "left_voltage_v": rest, "right_voltage_v": rest},
        "nothing happens": {"time_s": times, "voltage_v": rest, "left_current_a": rest, "left_hall_count": rest},
        "noise": {**volts, **currents},
        "noise at rest": {"time_s": times, "voltage_v": rest, **currents},
        "input with a hole": {**columns, "left_voltage_v": np.where(np.arange(len(times)) == 300, np.nan, 1.0)},
        "few rows": {name: each[:3] for name, each in columns.items()},
    }[how]


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("no input", "no column drives the motors"),
        ("no output", "no output column"),
        ("no time", "time_s: missing"),
        ("time backwards", "time_s: row 1251"),
        ("milliseconds", "is it ms?"),
        ("mA", "is it mA?"),
        ("three times the voltage", "the simulation does not follow left_current_a (fit"),
        ("a current that is noise", "the simulation does not follow left_current_a (fit"),
        ("rpm", "is it 1/min?"),
        ("rad", "is it rad?"),
        ("angle down", "wrong sign?"),
        ("nothing driven", "nothing to identify from, with vehicle suv: "),
        ("nothing happens", "constant from beginning to end"),
        ("noise", "nothing to identify from, with vehicle suv: "),
        ("noise at rest", "nothing to identify from, with vehicle suv: "),
        ("input with a hole", "left_voltage_v: empty cell in row 301"),
        ("few rows", "3 rows; allowed: 20 or more"),
    ],
)
def test_unusable_data_give_one_line_and_no_estimate(
    capsys: pytest.CaptureFixture[str], columns: dict[str, Floats], tmp_path: Path, how: str, said: str
) -> None:
    path = write_columns(tmp_path / "spoiled.csv", _spoiled(columns, how))
    saved = tmp_path / "saved.toml"
    lines = complaint(capsys, "identify", path, "--estimate", "motor.resistance", "--save-vehicle", saved)
    assert len(lines) == 1
    assert str(path) in lines[0]
    assert said in lines[0]
    assert not saved.exists()


def test_constant_hall_counts_of_a_locked_rotor_do_not_prevent_the_use_of_its_currents(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    times = np.arange(1001) / 500.0
    inputs = {"time_s": times, "voltage_v": np.where(times > 0.2, 0.6, 0.0)}
    locked = ("--set", "gear.friction_torque=100")
    out = simulated(tmp_path, inputs, "--set", "motor.resistance=0.95", *locked)
    assert np.all(out["left_hall_count"] == 0.0)
    path = write_columns(tmp_path / "locked.csv", noisy(out))
    result = found(capsys, path, "--estimate", "motor.resistance", *locked)
    assert_true(result, {"motor.resistance": 0.95})
    assert result["noise_outputs"] == ["left_current_a"]
    flags = ("--estimate", "motor.resistance", "--outputs", "position")
    assert "never changes" in complaint(capsys, "identify", path, *flags)[0]


def test_a_plan_prints_the_json_that_it_writes_and_refuses_a_html_report(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    plan = ("identify", "--plan", "--estimate", "motor.resistance", "--duration", 1)
    assert call(*plan, "--json", "--result", tmp_path / "plan.json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))
    lines = complaint(capsys, *plan, "--html", tmp_path / "plan.html")
    assert lines == ["liftgate-hil: --html: not with --plan"]


def test_the_saved_inputs_of_a_plan_are_accepted_by_simulate(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    plan = ("identify", "--plan", "--estimate", "motor.resistance,spring.preload", "--duration", 1)
    assert call(*plan, "--save-inputs", tmp_path / "inputs") == 0
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("written: ")]
    files = sorted((tmp_path / "inputs").iterdir())
    assert [line.split(": ")[1] for line in told] == [str(path) for path in files]
    assert len(files) == 3
    for path in files:
        assert call("simulate", "--input", path, "--output", tmp_path / "out.csv") == 0
        assert (tmp_path / "out.csv").read_text().count("\n") == 1002  # a second at 1 kHz, and the header
    capsys.readouterr()
    assert complaint(capsys, "identify", "x.csv", "--save-inputs", tmp_path)[0].startswith(
        "liftgate-hil: --save-inp"
    )


def test_ctrl_c_ends_identify_without_a_crash_or_partial_result(opening: Path, tmp_path: Path) -> None:
    """Steps so short that a simulation takes seconds: the interrupt comes while machine code runs."""
    result = tmp_path / "result.json"
    arguments = ["identify", str(opening), "--estimate", NAMES, "--step", "1e-5", "--quiet"]
    code = (
        "import liftgate_hil.cli.main, sys, liftgate_hil.identification.fit as i\n"
        "search = i._check_excited\n"
        "def told(problem):\n    search(problem)\n    print('begun', flush=True)\n"
        "    while True:\n        search(problem)\n"
        "i._check_excited = told\n"
        f"sys.exit(liftgate_hil.cli.main.main({[*arguments, '--result', str(result)]!r}))"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors == ""
    assert not result.exists()


def test_currents_of_the_wrong_sign_give_no_estimate(
    columns: dict[str, Floats], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    columns["left_current_a"] = -columns["left_current_a"]
    path = write_columns(tmp_path / "turned.csv", columns)
    (line,) = complaint(capsys, "identify", path, "--estimate", "motor.resistance")
    assert "currents of the right sign" in line


def test_a_model_without_end_stops_is_fitted_to_the_travel_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = simulated(tmp_path, driven(6.5, 12.0), *settings(TRUTH))
    assert out["gate_angle_deg"].max() > 80.0
    path = write_columns(tmp_path / "whole.csv", noisy(out, (*KEPT, "gate_angle_deg")))
    flags = ("--estimate", "motor.resistance", "--set", "motor.torque_constant=0.0113")
    result = found(capsys, path, *flags, "--set", "motor.rotor_inertia=1.6e-5", "--model", "third-order")
    (cut,) = [note for note in result["notes"] if "cut to" in note]
    assert "79.5 deg" in cut
    assert result["fit_percent"]["left_current_a"] > 80.0
    assert result["parameters"]["motor.resistance"]["value"] == pytest.approx(0.95, rel=0.01)


def test_warnings_are_in_the_json_too(opening: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = found(capsys, opening, "--estimate", "motor.resistance,spring.stop_stiffness")
    assert not result["identifiable"]["spring.stop_stiffness"]
    assert any("spring.stop_stiffness is not identifiable" in each for each in result["warnings"])


@pytest.mark.filterwarnings("error")
def test_indistinguishable_parameters_in_noise_free_data_are_reported_without_python_warnings(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "exact.csv"
    given = tmp_path / "given.csv"
    write_columns(given, driven(1.0, 8.0))
    assert call("simulate", "--input", given, "--output", path) == 0
    capsys.readouterr()
    names = "motor.rotor_inertia,gear.inertia"
    flags = ("--estimate", names, "--set", "motor.rotor_inertia=1.5e-5", "--quiet")
    lines = complaint(capsys, "identify", path, *flags)
    assert "nothing to identify from, with vehicle suv: " in lines[0]


def test_a_value_held_at_a_given_bound_is_saved_with_that_value(opening: Path, tmp_path: Path) -> None:
    saved, result = tmp_path / "saved.toml", tmp_path / "result.json"
    flags = (
        "--estimate",
        "motor.resistance,motor.speed_constant",
        "--bounds",
        "motor.resistance=0.5:0.72",
        "--quiet",
    )
    assert call("identify", opening, *flags, "--save-vehicle", saved, "--result", result) == 0
    told = json.loads(result.read_text())["parameters"]["motor.resistance"]
    assert (told["value"], told["is_held"]) == (0.72, True)
    assert vehicle_from(str(saved)).left.motor.resistance == 0.72


def test_a_stated_initial_position_that_contradicts_the_data_is_refused(
    opening: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ("--estimate", "motor.resistance")
    (line,) = complaint(capsys, "identify", opening, *flags, "--initial", "open")
    assert "opening.csv: its first gate_angle_deg is" in line
    assert line.endswith("while it states 80; allowed: auto, or the angle at which each file begins")
    data = Data("a.csv", np.arange(3.0), np.zeros((3, 14)), {"left_speed_rps": np.array([40.0, 45.0, 50.0])})
    with pytest.raises(ConfigError, match=r"`initial` closed: a.csv: its first left_speed_rps is 40, while"):
        _check_beginnings([data], [0.0], "closed")
    _check_beginnings([data], [None], "auto")


def test_the_other_reports_are_written_although_one_cannot_be(opening: Path, tmp_path: Path) -> None:
    html, vehicle, result = (tmp_path / each for each in ("ok.html", "ok.toml", "ok.json"))
    flags = ("--estimate", "motor.resistance", "--result", "/dev/full", "--html", html, "--save-vehicle", vehicle)
    assert call("identify", opening, *flags) == 2
    assert html.is_file()
    assert vehicle.is_file()
    command = [
        sys.executable,
        "-m",
        "liftgate_hil",
        *map(str, ("identify", opening, *flags[:2], "--result", result)),
    ]
    with Path("/dev/full").open("w") as full:
        assert (
            subprocess.run(command, stdout=full, stderr=subprocess.DEVNULL, check=False, timeout=300).returncode
            == 1
        )
    assert json.loads(result.read_text())["parameters"]


def test_a_prior_with_a_too_small_deviation_is_refused(opening: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ("--estimate", "motor.resistance", "--prior", "motor.resistance=0.6:1e-300")
    assert "--prior motor.resistance=0.6:1e-300" in complaint(capsys, "identify", opening, *flags)[0]


def test_neither_html_page_nor_saved_vehicle_replaces_an_input_or_a_file_of_another_kind(
    opening: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture, recording, vehicle = (tmp_path / each for each in ("p.png", "r.csv", "v.toml"))
    for each in (picture, recording):
        each.write_bytes(b"mine")
    vehicle.write_bytes(find_config("vehicles", "suv").read_bytes())
    estimate = ("identify", opening, "--vehicle", vehicle, "--estimate", "motor.resistance")
    lines = complaint(capsys, *estimate, "--html", picture, "--save-vehicle", recording)
    assert [each.partition("; ")[0].removeprefix("liftgate-hil: ") for each in lines] == [
        f"--save-vehicle {recording}: is a file of another kind",
        f"--html {picture}: is a file of another kind",
    ]
    assert picture.read_bytes() == recording.read_bytes() == b"mine"
    (line,) = complaint(capsys, *estimate, "--save-vehicle", vehicle)
    assert "is an input file; allowed: a separate file" in line
