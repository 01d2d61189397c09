"""An undriven gate that gains energy is reported as diverged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from liftgate_hil.cli.main import main
from liftgate_hil.loop import energy_watch
from liftgate_hil.loop.energy_watch import EnergyWatch, motion_of
from liftgate_hil.signals import COLUMNS
from liftgate_plant.constants import constants_of
from liftgate_plant.energy import energy, potential
from liftgate_plant.rows import AT, INPUT_COLUMNS
from tests.plant.runs import suv

AT_ROW = {name: place for place, name in enumerate(COLUMNS)}
N = 40


def rows_of(speeds: np.ndarray) -> np.ndarray:
    """Rows of a gate at 20 degrees whose drives turn within their play, without moving it."""
    rows = np.zeros((N, len(COLUMNS)))
    rows[:, AT_ROW["gate_angle_deg"]] = 20.0
    rows[:, AT_ROW["ambient_temperature_degc"]] = 20.0
    link = CONSTANTS.plant.link
    over = potential(CONSTANTS.plant, CONSTANTS.load)
    extended = np.interp(np.radians(20.0), over.angles, over.extensions)
    for side in ("left", "right"):
        rows[:, AT_ROW[f"{side}_position_rev"]] = extended / CONSTANTS.plant.left.travel
        rows[:, AT_ROW[f"{side}_speed_rps"]] = speeds
    assert link.stroke > extended
    return rows


CONSTANTS = constants_of(suv())
NOTHING = np.full((N, len(INPUT_COLUMNS)), np.nan)
SLOWING = np.linspace(200.0, 100.0, N)


def gained(rows: np.ndarray, given: np.ndarray = NOTHING) -> int | None:
    """Return the row in which a gate with these inputs gains energy, or None."""
    return EnergyWatch(CONSTANTS, has_faults=False).gain(rows, given)


def test_a_gate_that_slows_down_gains_no_energy() -> None:
    assert gained(rows_of(SLOWING)) is None


@pytest.mark.parametrize(("share", "expected"), [(0.008, None), (0.012, 25)])
def test_an_energy_gain_above_one_percent_is_found_at_its_row(share: float, expected: int | None) -> None:
    rows, speeds = rows_of(SLOWING), SLOWING.copy()
    over = potential(CONSTANTS.plant, CONSTANTS.load)
    start = energy(CONSTANTS.plant, CONSTANTS.load, over, motion_of(rows))[0] - over.least
    drive = CONSTANTS.plant.left
    half = 0.5 * drive.inertia * (2.0 * np.pi) ** 2
    speeds[25:] = np.sqrt(speeds[24] ** 2 + 0.5 * share * start / half)
    assert gained(rows_of(speeds)) == expected


def test_energy_is_compared_with_that_of_earlier_blocks() -> None:
    watch = EnergyWatch(CONSTANTS, has_faults=False)
    assert watch.gain(rows_of(SLOWING), NOTHING) is None
    assert watch.gain(rows_of(SLOWING[::-1]), NOTHING) is not None


@pytest.mark.parametrize("name", ["left_duty", "right_voltage_v"])
def test_a_driven_gate_may_gain_energy(name: str) -> None:
    given = NOTHING.copy()
    given[:, getattr(AT, name)] = 0.5
    assert gained(rows_of(SLOWING[::-1]), given) is None
    assert gained(rows_of(SLOWING[::-1])) is not None


@pytest.mark.parametrize("name", ["hand_force_n", "wind_pressure_pa", "pinch_force_n"])
def test_a_pushed_gate_may_gain_energy(name: str) -> None:
    rows = rows_of(SLOWING[::-1])
    rows[:, AT_ROW[name]] = 20.0
    assert gained(rows) is None


def test_a_change_of_road_slope_restarts_the_energy_comparison() -> None:
    rows = rows_of(np.repeat([100.0, 200.0], N // 2))
    rows[N // 2 :, AT_ROW["road_slope_deg"]] = 5.0
    assert gained(rows) is None


@pytest.mark.parametrize("every", ["1", "7"])
def test_a_simulation_that_gains_energy_ends_as_diverged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], every: str
) -> None:
    def growing(*values: object) -> np.ndarray:
        levels = energy(*values)  # type: ignore[arg-type]
        return levels + np.where(np.arange(len(levels)) >= 30, 50.0, 0.0)

    monkeypatch.setattr(energy_watch, "energy", growing)
    output = tmp_path / "out.csv"
    flags = ["--ideal", "--initial", "20", "--duration", "0.1", "--output", str(output)]
    flags += ["--every", every]
    assert main(["simulate", "--voltage", "0", *flags]) != 0
    assert "the plant diverged at 0.03 s: nothing drives it, and it gains more than 1%" in (
        capsys.readouterr().err
    )
