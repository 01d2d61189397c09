"""Simulated measurements of known parameters for the tests of `identify` and `validate`, and calls of these."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from liftgate_hil.cli.main import main

Floats = NDArray[np.float64]
TRUTH = {"motor.resistance": 0.95, "motor.torque_constant": 0.0113, "motor.rotor_inertia": 1.6e-5}
NAMES = ",".join(TRUTH)
KEPT = ("time_s", "left_voltage_v", "right_voltage_v", "left_current_a", "left_hall_count")


def call(*arguments: object) -> int:
    """Call the command line, and return its exit code, returned or raised."""
    try:
        return main([str(each) for each in arguments])
    except SystemExit as leaving:
        return int(leaving.code or 0)


def complaint(capsys: pytest.CaptureFixture[str], *arguments: object) -> list[str]:
    """Return the lines on stderr of a call that must be refused, with nothing on stdout."""
    assert call(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Traceback" not in captured.err
    lines = [each for each in captured.err.splitlines() if not each.startswith("compiling")]
    assert lines
    assert all(line.startswith("liftgate-hil") for line in lines)
    return lines


def write_columns(path: Path, columns: Mapping[str, Floats]) -> Path:
    """Write columns to a CSV file, NaN as an empty cell."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [",".join("" if x != x else repr(x) for x in row) for row in rows]
    path.write_text("\n".join([",".join(columns), *lines, ""]), encoding="utf-8")
    return path


def read_columns(path: Path) -> dict[str, Floats]:
    """Return the columns of a CSV file that has no empty cells."""
    names = path.read_text(encoding="utf-8").partition("\n")[0].split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


def driven(seconds: float, volts: float) -> dict[str, Floats]:
    """Return input columns: a voltage ramp, a wobble so that parameters can be identified, and off."""
    times = np.arange(round(seconds * 500) + 1) / 500.0
    wobble = 1.0 + 0.2 * np.sign(np.sin(8.0 * times)) * (times > 0.6)
    return {
        "time_s": times,
        "voltage_v": volts * np.clip(times / 0.3, 0.0, 1.0) * wobble * (times < seconds - 0.3),
    }


def simulated(folder: Path, inputs: Mapping[str, Floats], *flags: object) -> dict[str, Floats]:
    """Return the columns that `simulate` gives for these inputs, at 500 Hz."""
    given, out = folder / "given.csv", folder / "out.csv"
    write_columns(given, inputs)
    step = ("--step", 0.0005, "--every", 4)
    assert call("simulate", "--input", given, "--output", out, *step, *flags) == 0
    columns = read_columns(out)
    out.unlink()  # else the next one would say that it is set aside
    return columns


def settings(values: Mapping[str, float]) -> list[str]:
    """Return parameter values as arguments of `--set`."""
    return [text for name, value in values.items() for text in ("--set", f"{name}={value!r}")]


def noisy(columns: Mapping[str, Floats], kept: tuple[str, ...] = KEPT) -> dict[str, Floats]:
    """Return some columns, the currents with 0.05 A of noise, the angle with 0.1 deg."""
    random = np.random.default_rng(2008)
    sizes = {"left_current_a": 0.05, "right_current_a": 0.05, "gate_angle_deg": 0.1}
    return {
        name: columns[name] + sizes.get(name, 0.0) * random.standard_normal(len(columns[name])) for name in kept
    }
