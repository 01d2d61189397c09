"""Frames of a log: equal by any reader; columns have the values sent under their names."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from catalogue_bus import FIRST_OUTPUT, catalogue_rig, input_frames
from hil_support import CALM, shipped_rig
from hypothesis import given, settings
from hypothesis import strategies as st
from measurement_files import write_log

from liftgate_hil.formats import bus_log, candump_file
from liftgate_hil.measurement.log_frames import LogFrames, read_frames
from liftgate_hil.measurement.measurement import OUTPUTS
from liftgate_hil.measurement.table import read_measurement
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS, PROFILES
from liftgate_plant.bridge import CLOSE, OPEN
from liftgate_plant.signals import Sensed, bus_name, signals_of

NAMES = ["Gate", "LeftDrive"]  # 0x220, 0x210
LINES = st.builds(
    "({:.6f}) can0 {}{}{}".format,
    st.integers(0, 999_999_999_999_999).map(lambda us: us / 1e6),
    st.sampled_from(["220#", "210#", "2A1#", "00000220#", "20000080#", "220##0", "220##1"]),
    st.one_of(st.binary(max_size=8).map(lambda data: data.hex().upper()), st.just("11ab")),
    st.sampled_from(["", " R", " T"]),
)
OTHERS = st.sampled_from(
    ["(1.500000) can0 220#R", "(1.500000) can0 220#R8 R", "(3.000000) can0 210#R T", "rubbish", ""]
)


def same(one: LogFrames, other: LogFrames) -> None:
    """Check that two readings have equal frames, times and notes."""
    assert one.times_ns.tolist() == other.times_ns.tolist()
    assert (one.notes, one.span, one.silences) == (other.notes, other.span, other.silences)
    for a, b in zip(one.frames, other.frames, strict=True):
        np.testing.assert_array_equal(a, b)


@settings(CALM, max_examples=40)
@given(
    lines=st.lists(st.one_of(LINES, OTHERS), max_size=20), end=st.sampled_from(["\n", "\r\n", "\n(1.0) can0 22"])
)
def test_the_block_reader_gives_the_same_frames_as_the_line_reader(
    lines: list[str], end: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "lines.log"  # the same one each time: folders take longer
    path.write_bytes("".join(f"{line}\n" for line in lines)[:-1].encode() + end.encode() if lines else b"")
    at_once = read_frames(path, NAMES, shipped_rig())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(candump_file, "_at_once", lambda *_: None)
        same(at_once, read_frames(path, NAMES, shipped_rig()))


def test_a_block_may_end_within_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "m.log"
    path.write_text("".join(f"({0.2 * k:.6f}) can0 220#{k:02X}00000000 T\n" for k in range(50)))
    whole = read_frames(path, NAMES, shipped_rig())
    assert whole.frames.count == 50
    assert whole.silences[0] == (0.0, 0.2)
    assert len(whole.silences) == 49
    monkeypatch.setattr(bus_log, "_FIRST_BYTES", 37)
    monkeypatch.setattr(bus_log, "_BLOCK_BYTES", 41)
    same(read_frames(path, NAMES, shipped_rig()), whole)


@pytest.mark.parametrize(("benches", "notes"), [(1, 0), (2, 1)])
def test_a_log_of_two_benches_on_one_bus_is_noted(tmp_path: Path, benches: int, notes: int) -> None:
    rig, path = shipped_rig(), tmp_path / "m.log"
    cycle = 1e-3 * rig.cycle_ms("Gate")
    lines = [f"({cycle * k:.6f}) can0 220#{k % 16:02X}00000000 T\n" * benches for k in range(50)]
    path.write_text("".join(lines))
    said = [note for note in read_frames(path, NAMES, rig).notes if "times as often" in note]
    assert len(said) == notes
    assert all(note.startswith("Gate comes ") and "two benches" in note for note in said)


# A log of every quantity of the catalogue.


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


def test_every_column_of_a_log_has_the_values_sent_under_its_name(tmp_path: Path) -> None:
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
