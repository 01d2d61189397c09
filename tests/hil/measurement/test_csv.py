"""CSV files: every usual form is read, every issue is reported with its row and column."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from measurement_files import csv_text, faults_of, read, write_csv, written

from liftgate_hil.errors import ConfigError
from liftgate_hil.formats import csv_file
from liftgate_hil.formats.csv_file import open_csv
from liftgate_hil.formats.csv_header import COMMAS, UNITS, WINDOWS
from liftgate_hil.formats.open import open_recording
from liftgate_hil.measurement.measurement import INPUTS

TIMES = np.arange(30) * 0.01
GOOD = {"time_s": TIMES, "left_voltage_v": np.full(30, 6.0), "left_current_a": TIMES * 3.0}
HEAD = "time_s,left_voltage_v,left_current_a\n"


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_each_usual_form_of_csv_gives_the_same_numbers(
    tmp_path: Path, delimiter: str, encoding: str, newline: str
) -> None:
    text = csv_text(GOOD, delimiter).replace("\n", newline) + newline
    path = written(tmp_path, text.encode(encoding))
    measurement = read(path)
    assert measurement.source == str(path)
    assert not measurement.through_sensors
    assert np.array_equal(measurement.times, TIMES)
    for name in ("left_voltage_v", "left_current_a"):
        assert np.array_equal(measurement.columns[name], GOOD[name])


def test_quoted_cells_blanks_and_empty_lines_are_read(tmp_path: Path) -> None:
    path = written(tmp_path, '"time_s", left_voltage_v ,left_current_a\n"0", 1 ,2\n\n"0.1", 1.5 ,"3"\n')
    measurement = read(path)
    assert measurement.columns["left_voltage_v"].tolist() == [1.0, 1.5]
    assert measurement.columns["left_current_a"].tolist() == [2.0, 3.0]


@CALM
@given(
    arrays.arrays(np.float64, (7, 3), elements=st.floats(-900.0, 900.0, allow_nan=False, width=64)), st.booleans()
)
def test_the_fast_and_the_cell_by_cell_reader_agree_to_the_last_bit(table: np.ndarray, quoted: bool) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "m.csv"
        cells = [[f'"{value!r}"' if quoted else repr(value) for value in row] for row in table.tolist()]
        path.write_text("a,b,c\n" + "\n".join(map(",".join, cells)))
        for names in (["a", "c"], ["b"], ["c", "a", "b"]):
            fast, slow = values_in(path, names), carefully(path, names)
            assert np.array_equal(fast, slow)
            assert np.array_equal(fast, table[:, ["abc".index(name) for name in names]])


def values_in(path: Path, names: list[str]) -> np.ndarray:
    return np.concatenate(list(open_csv(path).rows(names)))


def carefully(path: Path, names: list[str]) -> np.ndarray:
    """Return the values by the reader that parses cell by cell."""
    with pytest.MonkeyPatch.context() as patch:
        for fast in ("_whole", "_cells"):
            patch.setattr(csv_file.CsvFile, fast, lambda *_: None)
        return values_in(path, names)


def test_a_truncated_last_row_is_left_out(tmp_path: Path) -> None:
    """A full disk or a killed process leaves such a row."""
    path = tmp_path / "cut.csv"
    path.write_text("time_s,voltage_v,left_current_a\n0,1,2\n0.001,1,3\n0.002,1")
    m = read(path)
    assert m.times.tolist() == [0.0, 0.001]
    assert m.notes == ("its last line is truncated and ignored",)
    path.write_text("time_s,voltage_v,left_current_a\n0,1,2\n0.001,1,3")
    assert len(read(path).times) == 2
    path.write_text("time_s,voltage_v,left_current_a\n0,1,2\n0.001,1\n")
    assert "row 2: 2 cells" in faults_of(path)[0]


def test_an_empty_cell_of_an_output_is_a_missing_sample(tmp_path: Path) -> None:
    current = TIMES.copy()
    current[[3, 7]] = np.nan
    measurement = read(write_csv(tmp_path / "m.csv", {**GOOD, "left_current_a": current}))
    assert np.array_equal(measurement.columns["left_current_a"], current, equal_nan=True)


def test_an_input_of_a_slower_raster_is_held(tmp_path: Path) -> None:
    volts = np.full(30, np.nan)
    volts[::5] = [0, 1, 2, 3, 4, 5]
    measurement = read(write_csv(tmp_path / "m.csv", {**GOOD, "left_voltage_v": volts}))
    assert measurement.columns["left_voltage_v"].tolist() == np.repeat(np.arange(6.0), 5).tolist()


def test_a_missing_value_of_an_input_is_refused(tmp_path: Path) -> None:
    volts = np.full(30, 6.0)
    volts[11] = np.nan
    assert faults_of(write_csv(tmp_path / "m.csv", {**GOOD, "left_voltage_v": volts})) == [
        "left_voltage_v: empty cell in row 12; allowed: an input has a value in every row, "
        "or in evenly spaced ones"
    ]


def test_a_common_voltage_column_is_used_for_both_drives(tmp_path: Path) -> None:
    columns = {"time_s": TIMES, "voltage_v": TIMES * 2.0, "left_current_a": TIMES}
    measurement = read(write_csv(tmp_path / "m.csv", columns))
    assert list(measurement.columns) == ["left_voltage_v", "right_voltage_v", "left_current_a"]
    for side in ("left", "right"):
        assert np.array_equal(measurement.columns[f"{side}_voltage_v"], TIMES * 2.0)


def test_position_and_count_are_both_kept(tmp_path: Path) -> None:
    columns = {**GOOD, "left_position_rev": TIMES, "left_hall_count": np.round(TIMES * 4.0)}
    measurement = read(write_csv(tmp_path / "m.csv", columns))
    assert {"left_position_rev", "left_hall_count"} <= set(measurement.columns)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", ["empty; allowed: a header and rows"]),
        (HEAD, ["no rows; allowed: one or more"]),
        ("time_s,time_s\n0,1\n", ["time_s: twice in the header; allowed: once"]),
        (
            HEAD + "0,1,2\n1,x,inf\n2,y,3\n",
            [
                "left_voltage_v: 'x' in row 2 (2 such rows); allowed: a number",
                "left_current_a: inf in row 2; allowed: a finite number",
            ],
        ),
        (HEAD + "0,1,1e999\n", ["left_current_a: 1e999 in row 1; allowed: a finite number"]),
        (HEAD + "0,1,1_0\n", ["left_current_a: 1_0 in row 1; allowed: a number"]),
        (
            "time_s,comment,left_voltage_v,left_current_a\n0,hello,1,2\n1,,1,inf\n",  # a comment is not read
            ["left_current_a: inf in row 2; allowed: a finite number"],
        ),
        (
            HEAD.replace(",", ";") + "0;1'234,5;2\n1;2,5;2\n",
            ['left_voltage_v: "1\'234,5" in row 1; allowed: a number'],
        ),
        (
            HEAD.replace(",", ";") + "0;1.0;1,5\n",  # a comma among points
            ["left_current_a: '1,5' in row 1; allowed: a number with a decimal point"],
        ),
        (HEAD + "0,5,1,2\n", ["row 1: 4 cells (is it a decimal comma?); allowed: 3, as in the header"]),
        (HEAD.replace(",", ";") + "0;5\n", ["row 1: 2 cells; allowed: 3, as in the header"]),
        (HEAD + "0,1,2\n0.2,1,2\n0.1,1,2\n", ["time_s: row 3; allowed: finite and rising (0.1 s after 0.2 s)"]),
        (HEAD + "0,1,2\n,1,2\n", ["time_s: empty cell in row 2; allowed: finite and rising"]),
        (
            HEAD + "0,1,20000\n0,-2000,2\n",
            [
                "left_voltage_v: -2000 in row 2; allowed: -1000 to 1000; is it mV? "
                "`maps` 'left_voltage_v=left_voltage_v[mV]'",
                "left_current_a: 20000 in row 1; allowed: -10000 to 10000; is it mA? "
                "`maps` 'left_current_a=left_current_a[mA]'",
                "time_s: row 2; allowed: finite and rising (0 s after 0 s)",
            ],
        ),
        (
            "time_s,left_duty,left_current_a\n0,50,2\n1,100,2\n",
            ["left_duty: 50 in row 1 (2 such rows); allowed: -1 to 1; is it %? `maps` 'left_duty=left_duty[%]'"],
        ),
        (
            "time_s,left_voltage_v,left_current_ma\n0,1,2\n",
            ["left_current_ma: unexpected unit; allowed: `maps` 'left_current_a=left_current_ma[mA]'"],
        ),
        (
            "time_ms,left_voltage_v,left_current_a\n0,1,2\n",
            ["time_ms: unexpected unit; allowed: `maps` 'time_s=time_ms[ms]'"],
        ),
        (
            "time_s,left_voltage_v,voltage_v,left_duty,left_current_a\n0,1,1,0,2\n",
            [
                "voltage_v and left_voltage_v and left_duty: allowed: one of them, "
                "chosen by `maps` left_duty=left_duty"
            ],
        ),
        (
            "t,left_voltage_v,left_current_a\n0,1,2\n",
            ["time_s: missing; allowed: a column of seconds, or `maps` time_s=..."],
        ),
        (
            "time_s,left_current_a\n0,2\n",
            [
                f"no input column; allowed: voltage_v, {', '.join(INPUTS)}, others by `maps`; "
                "the file has time_s, left_current_a"
            ],
        ),
        ("time_s,left_voltage_v,left_current_a\n0,1,\n", ["no sample of any output column"]),
        (b"time_s,\x81\n", ["cannot be read: not UTF-8 at byte 7"]),
        (HEAD.encode() + b"0,1,2\n\xb0", [f"cannot be read: not UTF-8 at byte {len(HEAD) + 6}"]),
        (
            b"\xb0," + HEAD.encode() + b"1,0,1,2\n\x81",
            [f"cannot be read: not Windows-1252 at byte {len(HEAD) + 10}"],
        ),
        (b"time_s\0", ["cannot be read: binary; allowed: a CSV text"]),
    ],
)
def test_all_issues_of_a_csv_file_are_reported_at_once_with_row_and_column(
    tmp_path: Path, text: str | bytes, said: list[str]
) -> None:
    assert faults_of(written(tmp_path, text)) == said


@pytest.mark.parametrize("name", ["m.csv", "m.mf4", "m.log", "m.blf", "m.asc", "m.trc"])
def test_a_missing_file_is_reported(tmp_path: Path, name: str, rig: object) -> None:
    from liftgate_hil.measurement.table import read_measurement

    with pytest.raises(ConfigError, match=r"no such file$"):
        read_measurement(tmp_path / name, {}, rig)


def test_an_unknown_file_suffix_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "m.xlsx"
    path.write_bytes(b"PK")
    assert faults_of(path) == [
        "format '.xlsx'; allowed: .csv, .tsv, .txt, .parquet, .mf4, .mcap, .log, .asc, .blf, .trc"
    ]


def test_a_table_with_very_many_columns_is_read(tmp_path: Path) -> None:
    names = ["time_s", "voltage_v", "left_current_a", *(f"c{k}" for k in range(19_997))]
    rows = [",".join([f"{0.01 * k:.2f}", "1", "2", *["0"] * 19_997]) for k in range(3)]
    measurement = read(written(tmp_path, "\n".join([",".join(names), *rows]) + "\n"))
    assert measurement.columns.keys() == {"left_voltage_v", "right_voltage_v", "left_current_a"}


CELLS = st.sampled_from(["1", "-2.5", "1e-3", "", " 7 ", "nan", "inf", "x"])


@CALM
@given(st.lists(st.tuples(CELLS, CELLS, CELLS), min_size=1, max_size=12), st.booleans(), st.integers(1, 40))
def test_blocks_of_any_size_agree_with_the_cell_by_cell_reader(
    rows: list[tuple[str, str, str]], is_ended: bool, block: int
) -> None:
    body = "\n".join(",".join(row) for row in rows) + "\n" * is_ended
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        path = Path(folder) / "m.csv"
        path.write_text(f"a,b,c\n0,0,0\n{body}")
        try:
            careful = carefully(path, ["c", "a"])
        except ConfigError:
            careful = None
        patch.setattr(csv_file, "_BLOCK", block)
        if careful is None:
            with pytest.raises(ConfigError, match=r"allowed: a (finite )?number"):
                values_in(path, ["c", "a"])
        else:
            assert np.array_equal(values_in(path, ["c", "a"]), careful, equal_nan=True)


def test_empty_cells_are_read_without_the_cell_by_cell_reader(tmp_path: Path) -> None:
    path = written(tmp_path, "a,b,c\n0,,\n1,2,\n,3,4\n,,\n5,6,.7")
    with pytest.MonkeyPatch.context() as patch:
        patch.delattr(csv_file.CsvFile, "_by_cell")
        values = values_in(path, ["a", "c"])
    expected = [[0.0, np.nan], [1.0, np.nan], [np.nan, 4.0], [np.nan, np.nan], [5.0, 0.7]]
    assert np.array_equal(values, expected, equal_nan=True)


def test_rows_with_a_wrong_number_of_cells_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    for body in ("1,2\n3,4,5,6", "1,2,3,4\n5,6,7", "1\n2,3,4,5,6"):
        path.write_text(f"a,b,c\n{body}")
        for names in (["a"], ["a", "b", "c"]):
            with pytest.raises(ConfigError, match=r"row 1: \d cells"):
                values_in(path, names)


@pytest.mark.parametrize(
    ("content", "notes"),
    [
        ("sep=;\r\nt;U;Winkel [°]\r\n0;12;1,5\r\n1;12;2,5\r\n", {WINDOWS, COMMAS}),
        ("t;U;Winkel\n[s];[V];[°]\n0;12;1,5\n1;12;2,5\n", {WINDOWS, COMMAS, UNITS}),
        ('t;U;"Winkel [°]"\n"0";"12";"1,5"\n"1";"12";"2,5"\n', {WINDOWS, COMMAS}),
        ("t\tU\tWinkel\nms\tmV\t°\n0\t12000\t1.5\n1000\t12000\t2.5\n", {WINDOWS, UNITS}),
        ('"sep=,"\n\nt,U,"Winkel"\ns,-,"deg"\n\n0,12,1.5\n1,12,2.5\n', {UNITS}),
    ],
)
def test_extra_lines_of_excel_and_measuring_programs_around_a_table_are_understood(
    tmp_path: Path, content: str, notes: set[str]
) -> None:
    path = written(tmp_path, content.encode("cp1252"))
    measurement = read(path, "time_s=t", "voltage_v=U", "gate_angle_deg=Winkel")
    assert np.array_equal(measurement.times, [0.0, 1.0])
    assert np.array_equal(measurement.columns["left_voltage_v"], [12.0, 12.0])
    assert np.array_equal(measurement.columns["gate_angle_deg"], [1.5, 2.5])
    assert set(open_csv(path).notes) == notes


@pytest.mark.parametrize(
    "rows",
    [
        "s,V,A",
        "s,V,A\ns,V,A\n0,1,2",
        "0,V,A\n0,1,2",
        ",V,A\n0,1,2",
        "s,V\n0,1,2",
        "s,V,nan\n0,1,2",
        "s,V,1.5\n0,1,2",
        "-,-,-\n0,1,2",
        "#N/A,#N/A,#N/A\n0,1,2",
        "n/a,V,A\n0,1,2",
    ],
)
def test_a_first_row_that_is_not_clearly_units_is_read_as_data(tmp_path: Path, rows: str) -> None:
    path = written(tmp_path, f"{HEAD}{rows}\n")
    assert open_csv(path).names == HEAD.strip().split(",")
    with pytest.raises(ConfigError, match="row 1"):
        read(path)


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_decimal_commas_are_read_if_the_file_has_no_decimal_points(tmp_path: Path, delimiter: str) -> None:
    rows = ["0,0", "-1,5", "2"], ["0,1", "2,25e1", ""], ["0,2", "3", "-0,5"]
    body = "".join(delimiter.join(row) + "\n" for row in rows)
    measurement = read(written(tmp_path, HEAD.replace(",", delimiter) + body))
    assert np.allclose(measurement.times, [0.0, 0.1, 0.2])
    assert np.allclose(measurement.columns["left_voltage_v"], [-1.5, 22.5, 3.0])
    assert np.allclose(measurement.columns["left_current_a"], [2.0, np.nan, -0.5], equal_nan=True)
    assert measurement.notes == ("decimal commas are read as points",)


def test_a_decimal_point_among_decimal_commas_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_file, "_LONGEST", 64)
    rows = [f"{k};1,5;2" for k in range(50)] + ["50;1.5;2"]
    path = written(tmp_path, HEAD.replace(",", ";") + "\n".join(rows) + "\n")
    assert faults_of(path) == ["left_voltage_v: 1.5 in row 51; allowed: a number"]


def test_a_recording_resaved_with_decimal_commas_keeps_its_start_time(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time_s;gate_angle_deg;run_start_s\n0;0,5;1764160000,5\n0,001;0,75;1764160000,5\n")
    recording = open_recording(path)
    assert recording.start_ns == 1764160000_500_000_000
    assert recording.notes == ("decimal commas are read as points",)
    assert np.concatenate([*recording.rows(["gate_angle_deg"])]).ravel().tolist() == [0.5, 0.75]


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("blank", ["", "\n"])
def test_a_recording_with_crlf_or_a_blank_line_is_recognized(tmp_path: Path, newline: str, blank: str) -> None:
    path = tmp_path / "run.csv"
    text = f"time_s,gate_angle_deg,run_start_s\n{blank}0,1,1764160000.5\n1,2,1764160000.5\n"
    path.write_bytes(text.replace("\n", newline).encode())
    recording = open_recording(path)
    assert recording.start_ns == 1764160000_500_000_000
    assert np.concatenate([*recording.rows(["gate_angle_deg"])]).ravel().tolist() == [1.0, 2.0]


def test_a_header_too_long_for_the_csv_reader_is_refused(tmp_path: Path) -> None:
    (said,) = faults_of(written(tmp_path, '{"a":"' + "x" * 140_000 + '"}\n'))
    assert said.startswith("its first line cannot be read: ")


def test_a_date_column_beside_decimal_commas_is_ignored(tmp_path: Path) -> None:
    rows = "0;1,5;2;01.02.2024\n1;2,5;2;01.02.2024\n"
    path = written(tmp_path, f"time_s;left_voltage_v;left_current_a;Datum\n{rows}")
    assert read(path).columns["left_voltage_v"].tolist() == [1.5, 2.5]


def test_a_column_name_similar_to_one_of_the_catalogue_is_noted(tmp_path: Path) -> None:
    columns = {**GOOD, "left_speed": TIMES, "left_curent_rms": TIMES, "comment": TIMES}
    assert read(write_csv(tmp_path / "m.csv", columns)).notes == ("left_speed is not read: is it left_speed_rps?",)
