"""`identify` estimates only values that `--set` and a vehicle file accept."""

from __future__ import annotations

import dataclasses
import json
import math
import tomllib
from pathlib import Path

import pytest
from fitting_files import KEPT, call, driven, noisy, settings, simulated, write_columns

from liftgate_hil.errors import ConfigError
from liftgate_hil.identification.commands import identification_of, vehicle_text_of
from liftgate_hil.identification.request import IdentifyRequest
from liftgate_hil.plan.setup import vehicle_from

NAMES = "motor.torque_constant,motor.speed_constant,motor.resistance"


@pytest.fixture(scope="module")
def weak(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Opening at 8 V for 2.5 s; the current sensor shows 4 % too little, as if the motor generated energy."""
    folder = tmp_path_factory.mktemp("weak")
    out = simulated(folder, driven(2.5, 8.0))
    columns = noisy(out, (*KEPT, "gate_angle_deg"))
    columns["left_current_a"] = 0.96 * columns["left_current_a"]
    return write_columns(folder / "weak.csv", columns)


def test_motor_constants_that_would_generate_energy_are_held_at_the_limit_for_vehicles(
    capsys: pytest.CaptureFixture[str], weak: Path, tmp_path: Path
) -> None:
    saved, report = tmp_path / "saved.toml", tmp_path / "report.json"
    flags = ("--save-vehicle", saved, "--result", report)
    assert call("identify", weak, "--estimate", NAMES, *flags) == 0
    told = capsys.readouterr().out
    assert "motor.torque_constant: held with others at a limit for valid vehicles: " in told
    assert "makes energy" in told
    found = json.loads(report.read_text(encoding="utf-8"))["parameters"]
    values = {name: each["value"] for name, each in found.items()}
    limit = 1.01 * values["motor.speed_constant"] / (2.0 * math.pi)
    assert values["motor.torque_constant"] == pytest.approx(limit, rel=1e-4)
    for flags in (settings(values), ["--vehicle", str(saved)]):
        assert call("simulate", "--voltage", 9, "--duration", 0.01, *flags) == 0


def test_a_torque_constant_estimated_alone_that_would_generate_energy_is_refused(
    capsys: pytest.CaptureFixture[str], weak: Path
) -> None:
    assert call("identify", weak, "--estimate", "motor.torque_constant", "--quiet") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "nothing to identify from, with vehicle suv: motor.torque_constant: at a limit for valid" in line
    assert "allowed: up to speed_constant/2π" in line


def test_an_estimate_is_not_saved_beside_an_initial_value_that_contradicts_it(weak: Path, tmp_path: Path) -> None:
    """A torque constant that is not identifiable keeps its value, above the limit by the new speed constant."""
    names = "motor.torque_constant,motor.speed_constant"
    target = str(tmp_path / "saved.toml")
    request = IdentifyRequest.of(files=str(weak), estimate=names, save_vehicle=target)
    result = identification_of(request)
    torque, speed = result.parameters
    found = (dataclasses.replace(torque, identifiable=False), dataclasses.replace(speed, value=0.0755))
    with pytest.raises(ConfigError) as caught:
        vehicle_text_of(request, dataclasses.replace(result, parameters=found))
    (line,) = caught.value.issues
    assert line.startswith(f"`save_vehicle` {target}: motor.torque_constant: 0.0122 makes energy")
    assert "motor.torque_constant kept the initial value; allowed: `estimate` without it" in line
    text = vehicle_text_of(request, result)
    assert tomllib.loads(text)["identification"]["not_identifiable"] == []
    Path(target).write_text(text, encoding="utf-8")
    assert vehicle_from(target).left.motor.speed_constant == speed.value
