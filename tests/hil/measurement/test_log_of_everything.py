"""A bus log of every quantity of the catalogue: each column is what was said under its name."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from catalogue_bus import FIRST_OUTPUT, catalogue_rig, input_frames
from measurement_files import write_log

from liftgate_hil.measurement.measurement import OUTPUTS
from liftgate_hil.measurement.table import read_measurement
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS, PROFILES
from liftgate_plant.bridge import CLOSE, OPEN
from liftgate_plant.signals import Sensed, bus_name, signals_of

SAID = {
    "left_duty": 30.0, "right_duty": 55.0, "left_direction": float(OPEN), "right_direction": float(CLOSE),
    "latch_release": 1.0, "obstacle_angle": 20.0, "obstacle_rate": 0.0, "supply_voltage": 11.0,
    "road_slope": 3.0, "ambient_temperature": -8.0, "wind_pressure": 17.0, "snow_mass": 5.0,
    "hand_force": -40.0, "external_torque": 13.0, "handle_pulled": 1.0, "button_pressed": 1.0,
    "latch_cinch": 1.0,
}  # fmt: skip
# Enumerations end at 1; all others take a number of their own.
TOLD = {
    name: 1.0 if signal.high == 1.0 else float(2 + place)
    for place, (name, signal) in enumerate(BUS_OUTPUTS.items())
}


def test_every_column_of_a_log_is_what_was_said_under_its_name(tmp_path: Path) -> None:
    rig = catalogue_rig(tmp_path)
    assert SAID.keys() == BUS_INPUTS.keys()
    frames = []
    for number in range(60):
        at = 0.010 * number
        frames += [(at, *frame) for frame in input_frames(SAID)]
        for place, value in enumerate(TOLD.values()):
            if value <= list(BUS_OUTPUTS.values())[place].high:
                frames.append((at + 0.005, FIRST_OUTPUT + place, struct.pack("<d", value)))
    measured = read_measurement(write_log(tmp_path / "m.log", frames), {}, rig)

    def held(name: str) -> float:
        values = measured.columns[name]
        (value,) = np.unique(values[np.isfinite(values)])
        return float(value)

    for column, signal in PROFILES.items():
        assert held(column) == pytest.approx(SAID[bus_name(column, signal)]), column
    assert held("left_duty") == pytest.approx(0.30)
    assert held("right_duty") == pytest.approx(-0.55)
    assert (held("left_coast"), held("right_coast"), held("latch_released")) == (0.0, 0.0, 1.0)
    assert held("latch_cinched") == 1.0
    sensed = {name: signal for name, signal in signals_of(Sensed).items() if name in OUTPUTS}
    assert {*sensed} == {
        "left_current_a", "right_current_a", "left_hall_count", "right_hall_count", "gate_angle_deg",
    }  # fmt: skip
    for column, signal in sensed.items():
        assert held(column) == TOLD[bus_name(column, signal)], column
