"""Vehicle, rig, seed and initial state of a run: flags override the scenario, on every command alike."""

from __future__ import annotations

from pathlib import Path

import pytest

from liftgate_hil.cli.main import main

FOREIGN = Path(__file__).parents[2] / "system" / "foreign" / "foreign.toml"
WIND = '[[profile]]\nquantity = "hand_force_n"\npoints = [[0.0, 5.0], [0.2, -5.0]]\n'
SAID = {"vehicle": "compact", "rig": str(FOREIGN), "seed": "7", "initial": "30"}
SETTINGS = {"environment.ambient_temperature_degc": "10", "sensors.current_noise": "0.05"}
OTHERS = {"vehicle": "heavy-suv", "rig": "liftgate", "seed": "8", "initial": "open"}

COMMANDS = {
    "run": ["--bus", "virtual:setup", "--clock", "free", "--quiet", "--record"],
    "demo": ["demo", "--clock", "free", "--quiet", "--no-record", "--record"],
    "demo in lockstep": ["demo", "--clock", "lockstep", "--quiet", "--no-record", "--record"],
    "simulate": ["simulate", "--voltage", "5", "--output"],
}


def scenario_file(folder: Path, text: str) -> Path:
    path = folder / "scenario.toml"
    path.write_text(text + WIND)
    return path


def saying() -> str:
    """Return a scenario that states vehicle, rig, seed, initial state and settings."""
    initial, seed = float(SAID["initial"]), int(SAID["seed"])
    lines = [f'vehicle = "{SAID["vehicle"]}"', f'rig = "{SAID["rig"]}"', f"seed = {seed}"]
    settings = [f'"{key}" = {value}' for key, value in SETTINGS.items()]
    return "\n".join([*lines, f"initial = {initial}", "[set]", *settings, ""])


def flags(command: str, values: dict[str, str], settings: dict[str, str]) -> list[str]:
    has_rig = command != "simulate"
    named = [(f"--{key}", value) for key, value in values.items() if has_rig or key != "rig"]
    given = [*named, *(("--set", f"{key}={value}") for key, value in settings.items())]
    return [each for pair in given for each in pair]


def rows_of(command: str, folder: Path, scenario: Path, more: list[str]) -> str:
    """Return the table that a command writes."""
    output = folder / "rows.csv"
    line = [*COMMANDS[command], str(output), "--scenario", str(scenario), "--duration", "0.3"]
    assert main([*line, *more]) == 0
    return output.read_text()


@pytest.mark.parametrize("command", COMMANDS)
def test_the_setup_of_a_scenario_has_the_same_effect_as_flags(command: str, tmp_path: Path) -> None:
    by_flags = rows_of(command, tmp_path, scenario_file(tmp_path, ""), flags(command, SAID, SETTINGS))
    assert "right_current_a" not in by_flags.splitlines()[0]
    by_itself = rows_of(command, tmp_path, scenario_file(tmp_path, saying()), [])
    assert by_itself == by_flags
    for key, value in (("seed", "8"), ("initial", "31")):
        other = flags(command, {**SAID, key: value}, SETTINGS)
        assert rows_of(command, tmp_path, scenario_file(tmp_path, ""), other) != by_flags


@pytest.mark.parametrize("command", COMMANDS)
def test_flags_override_the_setup_of_a_scenario(command: str, tmp_path: Path) -> None:
    warm = {**SETTINGS, "environment.ambient_temperature_degc": "30"}
    by_flags = rows_of(command, tmp_path, scenario_file(tmp_path, ""), flags(command, OTHERS, warm))
    against = flags(command, OTHERS, {"environment.ambient_temperature_degc": "30"})
    assert rows_of(command, tmp_path, scenario_file(tmp_path, saying()), against) == by_flags


@pytest.mark.parametrize("command", ["run", "demo"])
def test_frames_follow_the_rig_of_the_scenario(command: str, tmp_path: Path) -> None:
    log = tmp_path / "frames.log"
    line = [*COMMANDS[command], str(log), "--duration", "0.1", "--scenario"]
    assert main([*line, str(scenario_file(tmp_path, saying()))]) == 0
    foreign = {row.split()[2].partition("#")[0] for row in log.read_text().splitlines()}
    assert main([*line, str(scenario_file(tmp_path, ""))]) == 0
    ours = {row.split()[2].partition("#")[0] for row in log.read_text().splitlines()}
    assert ours
    assert foreign
    assert not foreign & ours


def test_the_working_directory_is_searched_for_ecus_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ecu = "class Ecu:\n    def step(self, now_s, frames):\n        return []\n"
    (tmp_path / "silent_ecu.py").write_text(ecu)
    (tmp_path / "numpy.py").write_text("raise SystemExit('code of the working directory was run')\n")
    monkeypatch.chdir(tmp_path)
    line = ["demo", "--clock", "free", "--quiet", "--no-record", "--duration", "0.1"]
    assert main([*line, "--ecu", "silent_ecu:Ecu"]) == 0
