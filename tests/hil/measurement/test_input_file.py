"""Inputs of `simulate` from a file: each column arrives under its own name."""

from __future__ import annotations

import csv
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from liftgate_hil.config.scenario import no_scenario
from liftgate_hil.loop.simulation import Offline, simulate
from liftgate_hil.measurement.input_file import read_samples
from liftgate_hil.session import vehicle_from
from liftgate_hil.signals import COLUMN_PLACE, INPUT_SIGNALS
from liftgate_plant.dynamics import initial_state
from liftgate_plant.rows import AT
from liftgate_plant.vehicle import load_of, plant_of

TIMES = [0.0, 0.001, 0.005]
# Of each range another share, so that no two are alike.
VALUES = {
    name: [
        signal.low + (signal.high - signal.low) * (place + 0.1 * turn + 1.0) / (len(INPUT_SIGNALS) + 2.0)
        for turn in range(len(TIMES))
    ]
    for place, (name, signal) in enumerate(INPUT_SIGNALS.items())
}  # fmt: skip


def written(folder: Path, columns: dict[str, list[float]]) -> Path:
    """A table of these, in any order but the catalogue's."""
    names = list(columns)
    random.Random(3).shuffle(names)
    assert names != list(columns)
    path = folder / "in.csv"
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([*names, "time_s"])
        for row, time in enumerate(TIMES):
            writer.writerow([*(repr(columns[name][row]) for name in names), time])
    return path


def without(columns: dict[str, Any], end: str) -> dict[str, Any]:
    """A file says of a motor either its voltage or its duty."""
    motors = {f"left_{end}", f"right_{end}"}
    return {name: value for name, value in columns.items() if name not in motors}


@pytest.mark.parametrize("left_out", ["duty", "voltage_v"])
def test_every_column_fills_the_place_of_its_name(tmp_path: Path, left_out: str) -> None:
    given = without(VALUES, left_out)
    samples = read_samples(written(tmp_path, given))
    rows = samples.rows_at(np.array([0.0005, 0.001, 0.004, 9.0]))
    assert rows.shape == (4, len(INPUT_SIGNALS))
    for name in INPUT_SIGNALS:
        values = given.get(name, [np.nan] * 3)
        expected = [values[0], values[1], values[1], values[2]]
        np.testing.assert_equal(rows[:, getattr(AT, name)], expected, name)
    assert len(np.unique(rows[0][np.isfinite(rows[0])])) == len(given)


def test_one_voltage_is_both_motors_and_what_is_not_said_is_not_there(tmp_path: Path) -> None:
    samples = read_samples(
        written(tmp_path, {"voltage_v": [1.0, 2.0, 3.0], "snow_mass_kg": [4.0] * 3})
    )
    (row,) = samples.rows_at(np.array([0.001]))
    said = {"left_voltage_v": 2.0, "right_voltage_v": 2.0, "snow_mass_kg": 4.0}
    for name in INPUT_SIGNALS:
        np.testing.assert_equal(row[getattr(AT, name)], said.get(name, np.nan), name)


def test_what_is_simulated_shows_every_input_in_its_column(tmp_path: Path) -> None:
    mild = {
        "left_voltage_v": 1.5, "right_voltage_v": -2.5, "left_duty": 0.0, "right_duty": 0.0,
        "left_coast": 0.0, "right_coast": 0.0, "supply_voltage_v": 11.0, "road_slope_deg": 3.0,
        "ambient_temperature_degc": -8.0, "wind_pressure_pa": 17.0, "snow_mass_kg": 5.0,
        "hand_force_n": -40.0, "external_torque_nm": 13.0, "latch_released": 1.0,
    }  # fmt: skip
    assert mild.keys() == INPUT_SIGNALS.keys()
    vehicle = vehicle_from("suv")
    plant = plant_of(vehicle)
    offline = Offline(
        plant=plant,
        sensors=vehicle.sensors,
        timeline=no_scenario().timeline,
        base=load_of(vehicle),
        step=0.001,
        every=1,
        seed=0,
    )

    def shown(**changes: float) -> dict[str, float]:
        said = without({**mild, **changes}, "voltage_v" if "left_duty" in changes else "duty")
        given = {name: [value] * len(TIMES) for name, value in said.items()}
        samples = read_samples(written(tmp_path, given))
        (rows,) = simulate(offline, initial_state(plant, 0.5), samples, 3)
        return {name: rows[-1, COLUMN_PLACE[name]] for name in mild if name != "latch_released"}

    seen = dict(mild)
    del seen["latch_released"]
    driven = {"left_duty": 0.25, "right_duty": -0.5}
    volts = {"left_voltage_v": 0.25 * 11.0, "right_voltage_v": -0.5 * 11.0}
    for found, expected in ((shown(), seen), (shown(**driven), {**seen, **driven, **volts})):
        for name, value in expected.items():
            assert abs(found[name] - value) < 1e-12, name
    for side in ("left", "right"):
        other = {"left": "right", "right": "left"}[side]
        found = shown(**{f"{side}_coast": 1.0})
        assert (found[f"{side}_coast"], found[f"{other}_coast"]) == (1.0, 0.0)
