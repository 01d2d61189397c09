"""Input files of `simulate`: each column is read under its own name."""

from __future__ import annotations

import csv
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.errors import ConfigError
from liftgate_hil.loop.simulation import Offline, blocks_of
from liftgate_hil.measurement.mapping import parse_maps
from liftgate_hil.plan.setup import vehicle_from
from liftgate_hil.signals import COLUMN_PLACE, INPUT_SIGNALS, ROW_WIDTH
from liftgate_hil.simulation.simulate import read_samples
from liftgate_hil.stimuli.stimulus_plan import stimulus_plan_of
from liftgate_plant.constants import constants_of
from liftgate_plant.friction_profile import friction_profile
from liftgate_plant.initial import initial_state
from liftgate_plant.rows import AT
from liftgate_plant.vehicle import plant_of

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
    """Write a table of these columns in an order other than the catalogue's."""
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
    """Return columns without those of the motors that end so: a file has either voltages or duties."""
    motors = {f"left_{end}", f"right_{end}"}
    return {name: value for name, value in columns.items() if name not in motors}


@pytest.mark.parametrize("left_out", ["duty", "voltage_v"])
def test_every_column_becomes_the_input_of_its_name(tmp_path: Path, left_out: str) -> None:
    given = without(VALUES, left_out)
    samples, _ = read_samples(written(tmp_path, given), {})
    rows = samples.rows_at(np.array([0.0005, 0.001, 0.004, 9.0]))
    assert rows.shape == (4, len(INPUT_SIGNALS))
    for name in INPUT_SIGNALS:
        values = given.get(name, [np.nan] * 3)
        expected = [values[0], values[1], values[1], values[2]]
        np.testing.assert_equal(rows[:, getattr(AT, name)], expected, name)
    assert len(np.unique(rows[0][np.isfinite(rows[0])])) == len(given)


def test_one_voltage_column_drives_both_motors_and_missing_columns_are_nan(tmp_path: Path) -> None:
    samples, notes = read_samples(written(tmp_path, {"voltage_v": [1.0, 2.0, 3.0], "snow_mass_kg": [4.0] * 3}), {})
    assert notes == ()
    (row,) = samples.rows_at(np.array([0.001]))
    said = {"left_voltage_v": 2.0, "right_voltage_v": 2.0, "snow_mass_kg": 4.0}
    for name in INPUT_SIGNALS:
        np.testing.assert_equal(row[getattr(AT, name)], said.get(name, np.nan), name)


LATCH = ("latch_released", "latch_cinched")  # shown by what the latch does


def test_the_simulated_table_has_every_input_in_its_column(tmp_path: Path) -> None:
    mild = {
        "left_voltage_v": 1.5, "right_voltage_v": -2.5, "left_duty": 0.0, "right_duty": 0.0,
        "left_coast": 0.0, "right_coast": 0.0, "supply_voltage_v": 11.0, "road_slope_deg": 3.0,
        "ambient_temperature_degc": -8.0, "wind_pressure_pa": 17.0, "snow_mass_kg": 5.0,
        "hand_force_n": -40.0, "external_torque_nm": 13.0, "handle_pulled": 1.0, "button_pressed": 0.0,
        "latch_released": 1.0, "latch_cinched": 0.0,
    }  # fmt: skip
    assert mild.keys() == INPUT_SIGNALS.keys()
    vehicle = vehicle_from("suv", ideal=True)
    plant = plant_of(vehicle)
    constants = constants_of(vehicle)

    def offline() -> Offline:
        return Offline(
            constants=constants,
            stimuli=stimulus_plan_of(constants),
            friction=friction_profile(vehicle, plant, 0),
            row=np.full((1, ROW_WIDTH), np.nan),
            nothing=empty_frames(0),
            step=0.001,
            seed=0,
        )

    def shown(**changes: float) -> dict[str, float]:
        said = without({**mild, **changes}, "voltage_v" if "left_duty" in changes else "duty")
        given = {name: [value] * len(TIMES) for name, value in said.items()}
        samples, _ = read_samples(written(tmp_path, given), {})
        (block,) = blocks_of(offline(), initial_state(plant, 0.5), samples, 3)
        last = block.rows[-1]
        return {name: last[COLUMN_PLACE[name]] for name in mild if name not in LATCH}

    seen = {name: value for name, value in mild.items() if name not in LATCH}
    driven = {"left_duty": 0.25, "right_duty": -0.5}
    volts = {"left_voltage_v": 0.25 * 11.0, "right_voltage_v": -0.5 * 11.0}
    for found, expected in ((shown(), seen), (shown(**driven), {**seen, **driven, **volts})):
        for name, value in expected.items():
            assert abs(found[name] - value) < 1e-12, name
    for side in ("left", "right"):
        other = {"left": "right", "right": "left"}[side]
        found = shown(**{f"{side}_coast": 1.0})
        assert (found[f"{side}_coast"], found[f"{other}_coast"]) == (1.0, 0.0)


def table(folder: Path, text: str) -> Path:
    path = folder / "in.csv"
    path.write_text(text)
    return path


def test_an_input_file_that_begins_late_is_shifted_to_time_0_with_a_note(tmp_path: Path) -> None:
    path = table(tmp_path, "time_s,voltage_v\n1700000000,1\n1700000000.5,2\n")
    samples, notes = read_samples(path, {})
    assert samples.times.tolist() == [0.0, 0.5]
    assert notes == ("begins at 1.7e+09 s, which is time 0 here",)


RECORDED = (
    "time_s,left_voltage_v,left_duty,left_coast,latched,supply_voltage_v\n"
    "0.001,6,0.5,0,1,12\n0.002,3,0.25,0,0,12\n0.003,0,0,1,0,11\n"
)


def test_the_inputs_of_a_recording_are_taken_from_the_next_row(tmp_path: Path) -> None:
    samples, notes = read_samples(table(tmp_path, RECORDED), {})
    assert "left_voltage_v" not in samples.columns
    assert samples.columns["left_duty"].tolist() == [0.25, 0.0, 0.0]
    assert samples.columns["left_coast"].tolist() == [0.0, 1.0, 1.0]
    assert samples.columns["latch_released"].tolist() == [1.0, 1.0, 1.0]
    assert "a recording of the emulator" in notes[0]


def test_mapped_voltages_of_a_recording_are_inputs_in_place_of_its_duties(tmp_path: Path) -> None:
    maps = parse_maps(["left_voltage_v=left_voltage_v"])
    samples, _ = read_samples(table(tmp_path, RECORDED), maps)
    assert "left_duty" not in samples.columns
    assert samples.columns["left_voltage_v"].tolist() == [3.0, 0.0, 0.0]


def test_a_map_sets_names_and_units_of_inputs_and_ignores_outputs(tmp_path: Path) -> None:
    path = table(tmp_path, "t,U,Iq\n5,1200,1\n10,2400,2\n")
    maps = parse_maps(["time_s=t[ms]", "left_voltage_v=U[mV]", "left_current_a=nowhere"])
    samples, _ = read_samples(path, maps)
    assert samples.times.tolist() == pytest.approx([0.0, 0.005])
    assert samples.columns.keys() == {"left_voltage_v"}
    assert samples.columns["left_voltage_v"].tolist() == pytest.approx([1.2, 2.4])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s,voltage_v,left_duty\n0,1,1\n", "chosen by `maps` left_duty=left_duty"),
        ("time_s,voltage_v\n0,1\n1,\n", "voltage_v: empty cell in row 2"),
        ("time_s,left_voltage_mv\n0,1\n", "unexpected unit"),
    ],
)
def test_issues_of_a_wrong_input_file_are_reported(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        read_samples(table(tmp_path, text), {})


def test_unused_columns_are_named_unless_recordings_have_such_a_column(tmp_path: Path) -> None:
    path = table(tmp_path, "time_s,voltage_v,slope,left_current_a [mA],latched\n0,0,5,0,1\n1,12,5,3,1\n")
    assert read_samples(path, {})[1] == ("ignored, as no input has this name: slope",)


def test_a_column_name_similar_to_an_input_is_reported_with_that_input(tmp_path: Path) -> None:
    path = table(tmp_path, "time_s,left_volt_v [mV],right_voltage_v\n0,0,5\n1,12,5\n")
    assert read_samples(path, {})[1] == ("left_volt_v [mV] is not read: is it left_voltage_v?",)
