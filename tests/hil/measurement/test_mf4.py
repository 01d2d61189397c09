"""MF4 channels with different rasters and units."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from measurement_files import faults_of, read

from liftgate_hil.errors import ConfigError

asammdf = pytest.importorskip("asammdf")


def write(path: Path, *groups: list[tuple[str, np.ndarray, np.ndarray, str]]) -> Path:
    """Write channels (name, times, samples, unit); a list of them is a group with one raster."""
    with asammdf.MDF(version="4.10") as measurement:
        for group in groups:
            signals = []
            for name, times, samples, unit in group:
                encoding = "utf-8" if samples.dtype.kind == "S" else None
                signals.append(asammdf.Signal(samples, times, name=name, unit=unit, encoding=encoding))
            measurement.append(signals)
        measurement.save(path, overwrite=True)
    return path


FINE = np.arange(100) * 0.001
COARSE = np.arange(10) * 0.01


def test_channels_of_different_rasters_are_joined_with_inputs_held(tmp_path: Path) -> None:
    path = write(
        tmp_path / "m.mf4",
        [("left_current_a", FINE, FINE * 2.0, "A")],
        # The same instants by another clock: off by rounding.
        [("left_voltage_v", COARSE * (1.0 + 1e-12), np.arange(10.0), "V")],
        [("gate_angle_deg", np.cumsum(np.full(9, 0.01)), np.arange(9.0), "deg")],
    )
    m = read(path)
    assert not m.through_sensors
    assert np.allclose(m.times, FINE, rtol=0, atol=1e-9)
    assert np.allclose(m.columns["left_current_a"], FINE * 2.0, rtol=0, atol=1e-12)
    assert m.columns["left_voltage_v"].tolist() == np.repeat(np.arange(10.0), 10).tolist()
    angle = m.columns["gate_angle_deg"]
    assert np.flatnonzero(np.isfinite(angle)).tolist() == list(range(10, 100, 10))


def test_an_mf4_measurement_begins_when_all_inputs_are_known(tmp_path: Path) -> None:
    path = write(
        tmp_path / "m.mf4",
        [("left_current_a", FINE, FINE, "A")],
        [("left_voltage_v", COARSE + 0.02, np.arange(10.0), "V")],
    )
    m = read(path)
    assert m.times[0] == pytest.approx(0.02)
    assert m.columns["left_voltage_v"][0] == 0.0
    assert m.columns["left_current_a"][0] == pytest.approx(0.02)
    assert m.notes == ("begins at 0.02 s, the first sample of all inputs",)


def test_the_unit_of_a_channel_is_converted(tmp_path: Path) -> None:
    path = write(
        tmp_path / "m.mf4",
        [
            ("left_current_a", FINE, FINE * 1e3, "mA"),
            ("left_voltage_v", FINE, FINE, ""),
            ("speed", FINE, FINE * 60.0, "1/min"),
            ("angle", FINE, np.degrees(FINE), "no unit at all"),
        ],
    )
    m = read(path, "left_speed_rps=speed", "gate_angle_deg=angle[deg]")
    assert np.allclose(m.columns["left_current_a"], FINE, rtol=1e-12)
    assert np.allclose(m.columns["left_speed_rps"], FINE, rtol=1e-12)
    assert np.allclose(m.columns["gate_angle_deg"], np.degrees(FINE), rtol=1e-12)


def test_a_channel_unit_of_another_dimension_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "m.mf4", [("left_current_a", FINE, FINE, "V"), ("left_voltage_v", FINE, FINE, "V")])
    assert faults_of(path) == [
        "left_current_a: unit 'V'; allowed: A, mA, µA, kA; or `maps` 'left_current_a=left_current_a[unit]'"
    ]
    m = read(path, "left_current_a=left_current_a[A]*2")
    assert np.allclose(m.columns["left_current_a"], 2.0 * FINE)


def test_integer_channels_are_read_as_numbers(tmp_path: Path) -> None:
    path = write(
        tmp_path / "m.mf4",
        [
            ("left_duty", FINE, np.full(100, 50, dtype=np.uint8), "%"),
            ("left_hall_count", FINE, np.arange(100, dtype=np.int16), "count"),
        ],
    )
    m = read(path)
    assert set(m.columns["left_duty"]) == {0.5}
    assert np.array_equal(m.columns["left_hall_count"], np.arange(100.0))


def test_infinite_out_of_range_and_text_samples_of_an_mf4_channel_are_reported(tmp_path: Path) -> None:
    current, volts = FINE.copy(), FINE.copy()
    current[[4, 9]] = np.inf
    current[12] = np.nan  # no value
    volts[7] = 5000.0
    path = write(
        tmp_path / "m.mf4",
        [
            ("left_current_a", FINE, current, "A"),
            ("left_voltage_v", FINE, volts, "V"),
            ("left_speed_rps", FINE, np.array([b"fast"] * 100), ""),
        ],
    )
    assert faults_of(path) == [
        "left_current_a: inf in sample 5 (2 such samples); allowed: a finite number",
        "left_speed_rps: not numeric; allowed: one number per sample",
        "left_voltage_v: 5000 in sample 8; allowed: -1000 to 1000; is it mV? "
        "`maps` 'left_voltage_v=left_voltage_v[mV]'",
    ]


def test_a_channel_in_two_groups_or_a_mapped_time_is_refused(tmp_path: Path) -> None:
    group = [("left_current_a", FINE, FINE, "A"), ("left_voltage_v", FINE, FINE, "V")]
    path = write(tmp_path / "m.mf4", group, group[:1])
    assert "left_voltage_v, group 0.left_current_a, group 1.left_current_a" in faults_of(path)[0]
    assert "left_current_a" in read(path, "left_current_a=group 1.left_current_a").columns
    assert "time_s: mapped; allowed: not mapped, MF4 channels have their own times" in faults_of(
        path, "time_s=left_current_a"
    )


def test_times_that_do_not_increase_are_refused(tmp_path: Path) -> None:
    late = FINE.copy()
    late[50] = late[49]
    path = write(tmp_path / "m.mf4", [("left_current_a", FINE, FINE, "A")], [("left_voltage_v", late, FINE, "V")])
    assert faults_of(path) == [
        "left_voltage_v: time 0.049 s in sample 51 is not later than the one before; allowed: finite and rising"
    ]


def test_channels_without_samples_are_refused(tmp_path: Path) -> None:
    none = np.zeros(0)
    path = write(tmp_path / "m.mf4", [("left_current_a", none, none, "A"), ("left_voltage_v", none, none, "V")])
    assert faults_of(path) == ["no sample of any input column", "no sample of any output column"]


@pytest.mark.parametrize("ring", ["data groups", "channel groups"])
def test_a_circular_chain_of_blocks_is_reported(tmp_path: Path, ring: str) -> None:
    path = write(tmp_path / "m.mf4", [("left_current_a", FINE, FINE, "A")])
    data = bytearray(path.read_bytes())
    (group,) = struct.unpack_from("<Q", data, 64 + 24)
    if ring == "channel groups":
        (group,) = struct.unpack_from("<Q", data, group + 24 + 8)
    struct.pack_into("<Q", data, group + 24, group)
    path.write_bytes(data)
    with pytest.raises(ConfigError, match=f"form a ring at byte {group}"):
        read(path)
