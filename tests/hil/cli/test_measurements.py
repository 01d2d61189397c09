"""The flags of `identify` and `validate` that describe the measured data."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from liftgate_hil.cli.command import Call, add_flags
from liftgate_hil.errors import ConfigError
from liftgate_hil.identification.measurements import measurements_of
from liftgate_hil.identification.request import MeasuredRequest
from liftgate_hil.measurement.measurement import Measurement
from liftgate_hil.measurement.quality import angle_of_position
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.initial import initial_state
from liftgate_plant.vehicle import plant_of

COUNT = 3001


def measure(*arguments: object, vehicle: str = "suv") -> list[Measurement]:
    parser = argparse.ArgumentParser(allow_abbrev=False)
    add_flags(parser, MeasuredRequest)
    call = Call(vars(parser.parse_args([str(each) for each in arguments])))
    return measurements_of(call.request(MeasuredRequest), vehicle_from(vehicle))


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A measurement of 3 s at 1 kHz: the angle goes from 0 to 60 degrees and back."""
    times = np.arange(COUNT) * 0.001
    angle = 60.0 * np.sin(np.pi * times / 3.0)
    current = 2.0 + 0.1 * np.sin(40.0 * times)
    current[1000] = 80.0
    path = tmp_path / "drive.csv"
    table = np.column_stack([times, np.full(COUNT, 9.0), np.full(COUNT, 8.0), current, angle])
    header = "time_s,left_voltage_v,right_voltage_v,left_current_a,gate_angle_deg"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.17g")
    return path


def test_without_flags_all_rows_of_a_file_are_used(drive: Path) -> None:
    (m,) = measure(drive)
    assert len(m.times) == COUNT
    assert m.columns["left_current_a"][1000] == 80.0
    assert [note for note in m.notes if "outlier" in note] == [
        "left_current_a: 1 outlier, the first 80 at 1 s; kept, `drop_outliers` would drop them"
    ]


def test_time_and_angle_cuts_leave_the_longest_stretch_and_outliers_are_dropped(drive: Path) -> None:
    (m,) = measure(drive, "--from", 0.5, "--to", 2.9, "--cut-angle", "0:50", "--drop-outliers")
    # 0:50 holds from 0.5 s (30 deg) to 0.94 s and again from 2.06 s on: the second is longer.
    assert m.times[0] == pytest.approx(2.06, abs=0.003)
    assert m.times[-1] == pytest.approx(2.9, abs=0.003)
    assert np.nanmax(m.columns["left_current_a"]) < 3.0
    assert len(m.notes) == 3


def test_outliers_are_not_taken_for_another_unit_and_can_be_dropped(drive: Path) -> None:
    text = drive.read_text().replace(",80,", ",8000,")
    drive.write_text(text)
    with pytest.raises(ConfigError) as caught:
        measure(drive)
    assert caught.value.issues == [
        f"{drive}: left_current_a: 1 outlier beyond 169.5 A, the largest 8000 in row 1001; allowed: up to 169.5 A "
        "with this vehicle, or `drop_outliers`"
    ]
    (m,) = measure(drive, "--drop-outliers")
    assert np.nanmax(m.columns["left_current_a"]) < 3.0


def test_each_file_gives_one_measurement(drive: Path) -> None:
    again = drive.with_name("again.csv")
    again.write_bytes(drive.read_bytes())
    first, second = measure(drive, again)
    assert (first.source, second.source) == (str(drive), str(again))


def test_a_gate_with_one_drive_has_no_right_columns(drive: Path) -> None:
    (m,) = measure(drive, vehicle="compact")
    assert not [name for name in m.columns if name.startswith("right_")]


def test_issues_of_all_files_are_reported_at_once(drive: Path, tmp_path: Path) -> None:
    few = tmp_path / "few.csv"
    few.write_text("time_s,voltage_v,left_current_a\n0,1,1\n1,1,1\n")
    bad = tmp_path / "bad.csv"
    bad.write_text("time_s,voltage_v\n0,1\n")
    with pytest.raises(ConfigError) as caught:
        measure(few, drive, bad, tmp_path / "none.blf")
    assert caught.value.issues[0] == f"{few}: 2 rows; allowed: 20 or more"
    assert caught.value.issues[1].startswith(f"{bad}: no output column; allowed: left_current_a, ")
    assert caught.value.issues[2] == f"{tmp_path / 'none.blf'}: no such file"
    assert len(caught.value.issues) == 3


def test_a_cut_that_leaves_too_few_rows_is_refused(drive: Path) -> None:
    with pytest.raises(ConfigError, match=r"drive\.csv: 11 rows; allowed: 20 or more"):
        measure(drive, "--from", 1, "--to", 1.01)


def test_values_beyond_the_vehicles_limits_are_reported_as_a_likely_wrong_unit(drive: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        measure(drive, "--map", "left_current_a=left_current_a[A]*100")
    assert caught.value.issues == [
        f"{drive}: left_current_a: 8000 in row 1001: is it mA? allowed: up to 169.5 A with this vehicle"
    ]


def test_from_after_to_is_refused(drive: Path) -> None:
    with pytest.raises(ConfigError, match="`from_s` 2 `to_s` 1: allowed: `from_s` before `to_s`"):
        measure(drive, "--from", 2, "--to", 1)


@pytest.mark.parametrize(
    "flags",
    [
        ["--cut-angle", "20"],
        ["--cut-angle", "30:20"],
        ["--cut-angle", "nan:20"],
        ["--decimate", "0"],
        ["--resample", "0"],
        ["--from", "inf"],
    ],
)
def test_bad_flags_are_refused(drive: Path, flags: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        measure(drive, *flags)
    assert caught.value.code == 2
    assert "allowed" in capsys.readouterr().err


def test_the_angle_of_a_spindle_position_is_that_of_the_plant() -> None:
    vehicle = vehicle_from("suv")
    angle = angle_of_position(vehicle)
    for degrees in (0.0, 10.0, 45.0, 80.0):
        state = initial_state(plant_of(vehicle), np.radians(degrees))
        assert angle(state.left.position) == pytest.approx(degrees, abs=1e-6)
    assert np.isnan(angle(1e6))


def moved(drive: Path, row: int, change: str) -> Path:
    """A copy of the measurement, the times after `row` changed by an expression of `t`; returns its path."""
    lines = drive.read_text().splitlines()
    for k in range(1, len(lines)):
        if k > row:
            time, _, rest = lines[k].partition(",")
            lines[k] = f"{eval(change, {}, {'t': float(time)})!r},{rest}"
    path = drive.with_name("moved.csv")
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("row", "change"),
    [
        (COUNT - 1, "t + 36_000.0"),  # the last row ten hours later
        (1, "t + 1.7e9"),  # a clock that was set after the first row
        (1500, "t + 61.0"),
        (COUNT - 1, "1e306"),
        (COUNT - 1, "1.7e308"),
    ],
)
def test_a_clock_that_jumps_is_reported_and_can_be_cut_off(drive: Path, row: int, change: str) -> None:
    path = moved(drive, row, change)
    with pytest.raises(ConfigError, match=rf"time_s: .* from row {row} .*; allowed: up to 60 s"):
        measure(path)
    flags = ("--from", 1e9) if row == 1 else ("--to", 2.9)
    assert len(measure(path, *flags)) == 1


@pytest.mark.parametrize("change", ["t * 5e-324", "t * 1e-300", "t * 1e300", "t * 5e307"])
def test_times_near_the_limits_of_floating_point_are_reported(drive: Path, change: str) -> None:
    with pytest.raises(ConfigError, match="time_s"):
        measure(moved(drive, 0, change))


def test_timestamps_since_1970_are_accepted(drive: Path) -> None:
    assert len(measure(moved(drive, 0, "t + 1.7e9"))) == 1


def test_a_measurement_of_more_than_a_day_is_refused(tmp_path: Path) -> None:
    # Nobody's median distance is a minute: half of the rows are close together.
    times = np.cumsum(np.where(np.arange(4000) % 2, 0.4, 55.0))
    path = tmp_path / "long.csv"
    table = np.column_stack([times, np.full(4000, 9.0), np.arange(4000) % 3])
    header = "time_s,voltage_v,left_current_a"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.17g")
    with pytest.raises(ConfigError, match="allowed: up to 86400 s"):
        measure(path)
