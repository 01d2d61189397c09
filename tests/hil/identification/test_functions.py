"""`identify` and `validate` from Python: forms of their arguments, and the result file."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.errors import ConfigError, NotWrittenError
from liftgate_hil.identification.request import IdentifyRequest, ValidateRequest
from liftgate_hil.identification.result import Validation

NAME = "motor.resistance"


@pytest.fixture(scope="module")
def opening(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Measurement of 1.5 s of opening by 12 V from closed, with known true parameters."""
    path = tmp_path_factory.mktemp("opening") / "opening.csv"
    lh.simulate(voltage=12.0, duration=1.5, every=5, output=path, ideal=True)
    return path


def estimate(fit: Any) -> tuple[float, float]:
    """Return value and standard deviation of the only estimated parameter."""
    (found,) = fit.parameters
    return found.value, found.std


@pytest.mark.parametrize(
    "how",
    [
        {"estimate": [NAME]},
        {"preset": None, "initial": 0.0},
        {"initial": ["closed"], "input_delay": 0},
        {"input_delay": 0.0, "bounds": {NAME: (0.1, 4)}, "cut_angle": (-1.0, 360.0)},
        {"bounds": [f"{NAME}=0.1:4"], "cut_angle": "-1:360"},
        {"bounds": {NAME: np.array((0.1, 4.0))}},
    ],
)
def test_identify_accepts_its_arguments_in_several_forms(opening: Path, how: dict[str, Any]) -> None:
    arguments = {"estimate": NAME, "ideal": True, "outputs": "current"} | how
    value, _ = estimate(lh.identify(opening, **arguments))
    assert value == pytest.approx(lh.load_vehicle("suv").left.motor.resistance, rel=1e-6)


def test_priors_and_noise_are_given_as_numbers_by_name(opening: Path) -> None:
    given = {"estimate": NAME, "ideal": True, "outputs": ["current"], "noise": {"current": 0.1}}
    plain = estimate(lh.identify([opening], **given))
    value, std = estimate(lh.identify([opening], prior={NAME: (0.8, 1e-4)}, **given))
    assert std < plain[1]
    assert abs(value - 0.8) < abs(plain[0] - 0.8)


def test_an_identification_in_memory_is_validated_without_a_file(opening: Path, tmp_path: Path) -> None:
    off = {"settings": [f"{NAME}=0.9"], "ideal": True}
    fit = lh.identify(opening, estimate=NAME, result=tmp_path / "fit.json", **off)
    by_file = lh.validate(opening, parameters=tmp_path / "fit.json", **off)
    found = lh.validate(opening, parameters=fit, **off)
    assert found.fit_percent == by_file.fit_percent
    assert found.fit_percent["left_current_a"] > 99.9 > lh.validate(opening, **off).fit_percent["left_current_a"]
    assert found.provenance is not None
    assert found.provenance.command_line.startswith("ValidateRequest(files=")


def test_the_error_of_an_unwritable_file_carries_the_result(opening: Path) -> None:
    with pytest.raises(NotWrittenError, match="`html` /dev/full: cannot be written: No space") as caught:
        lh.validate(opening, ideal=True, html="/dev/full")
    result = caught.value.result
    assert isinstance(result, Validation)
    assert result.fit_percent["left_current_a"] > 99.0


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ({"estimate": NAME, "bounds": {NAME: (True, 2)}}, "`bounds`"),
        ({"estimate": NAME, "cut_angle": b"12"}, "`cut_angle`"),
        ({"estimate": NAME, "cut_angle": (True, 30)}, "`cut_angle` True, 30: allowed: LOW:HIGH"),
        ({"estimate": NAME, "initial": np.array([1, 2])}, "`initial`"),
        ({"estimate": NAME, "vehicle": 3}, "`vehicle` 3: allowed: a path"),
        ({"files": []}, "`files` : allowed: a path, or a list of them"),
        ({}, "`estimate`: missing; allowed: keys of the vehicle file, or `preset`"),
        ({"estimate": NAME, "from_s": 2.0, "to_s": 1.0}, "`from_s` 2 `to_s` 1: allowed: `from_s` before `to_s`"),
        ({"estimate": NAME, "maps": "x"}, "`maps` x"),
    ],
)
def test_wrong_arguments_are_refused_with_their_names(opening: Path, how: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        lh.identify(**{"files": opening, "ideal": True} | how)
    assert text in str(caught.value)
    assert len(str(caught.value)) < 300


def test_only_the_files_are_positional_arguments(opening: Path) -> None:
    with pytest.raises(TypeError):
        lh.identify(opening, "suv")  # type: ignore[call-overload]
    with pytest.raises(TypeError):
        IdentifyRequest(estimat="x")  # type: ignore[call-arg]
    with pytest.raises(TypeError):
        ValidateRequest()  # type: ignore[call-arg]


def test_a_request_object_replaces_the_arguments(opening: Path) -> None:
    request = pickle.loads(pickle.dumps(ValidateRequest(opening, ideal=True)))
    assert lh.validate(request).fit_percent == lh.validate(opening, ideal=True).fit_percent


def test_notes_name_arguments_in_python_and_flags_on_the_command_line(
    opening: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paused = lh.validate(opening, ideal=True, initial="pause")
    assert any("`initial` gives the angle" in note for note in paused.notes)
    flags = ["validate", str(opening), "--ideal", "--initial", "pause"]
    assert main([*flags, "--json", "--quiet"]) == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert notes == [note.replace("`initial`", "--initial") for note in paused.notes]
    assert main(flags) == 0
    assert "--initial gives the angle" in " ".join(capsys.readouterr().out.split())
