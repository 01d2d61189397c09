"""Tables of other programs: comments, missing headers, dates, encodings."""

from __future__ import annotations

from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.csv_header import COMMAS, COMMENTED, NUMBERED
from liftgate_hil.formats.open import open_file
from liftgate_hil.formats.recording import FileColumn, ReadOptions
from liftgate_hil.measurement.mapping import parse_maps
from liftgate_hil.measurement.table import read_table


def series_in(path: Path, *names: str, zone: str | None = None) -> dict[str, FileColumn]:
    """Return these columns of a file, by name, with dates in a time zone. Raises ConfigError with all issues."""
    file = open_file(path, how=ReadOptions(zone=None if zone is None else ZoneInfo(zone)))
    issues: list[str] = []
    found = file.read(names, issues)
    if issues:
        raise ConfigError(issues)
    return found


def written(folder: Path, text: str, encoding: str = "utf-8", name: str = "t.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


def test_comments_anywhere_in_a_table_are_skipped(tmp_path: Path) -> None:
    path = written(tmp_path, "# by a logger\n\n// 1,2\ntime_s,F\n0,1\n# 7,7\n  % 8,8\n1,2\n#end")
    found = series_in(path, "time_s", "F")
    assert found["time_s"].values.tolist() == [0.0, 1.0]
    assert found["F"].values.tolist() == [1.0, 2.0]


def test_the_last_comment_is_the_header_where_there_is_no_other(tmp_path: Path) -> None:
    """As written by numpy's savetxt."""
    path = tmp_path / "t.csv"
    np.savetxt(path, [[0.0, 1.0], [1.0, 2.0]], delimiter=",", header="made by numpy\nt,F (kN)")
    file = open_file(path)
    assert list(file.names) == ["t", "F (kN)"]
    assert COMMENTED in file.notes
    assert series_in(path, "F (kN)")["F (kN)"].values.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "values"),
    [("0,5\n1,6\n", [5.0, 6.0]), ("0,5;1,5\n1,5;2\n", [1.5, 2.0]), ("# a\n0\t5\n1\t6\n", [5.0, 6.0])],
)
def test_columns_without_a_header_are_named_by_numbers(tmp_path: Path, text: str, values: list[float]) -> None:
    path = written(tmp_path, text)
    file = open_file(path)
    assert list(file.names) == ["1", "2"]
    assert NUMBERED in file.notes
    assert (COMMAS in file.notes) == (";" in text)
    assert series_in(path, "2")["2"].values.tolist() == values


@pytest.mark.parametrize("text", ["0 1 2\n1 2 3\n", "t F\n0 1\n1 2\n"])
def test_a_table_separated_by_blanks_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match="cells separated by blanks; allowed: by commas, semicolons or tabs"):
        open_file(written(tmp_path, text))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])
def test_unicode_text_saved_by_excel_is_read(tmp_path: Path, encoding: str) -> None:
    path = written(tmp_path, "time_s\tWinkel [°]\r\n0\t1,5\r\n1\t2,5", encoding, "t.txt")
    assert series_in(path, "Winkel [°]")["Winkel [°]"].values.tolist() == [1.5, 2.5]


@pytest.mark.parametrize(
    ("cells", "seconds", "epoch_ns"),
    [
        (("2025-09-29 13:00:00.5", "2025-09-29 13:00:01.25"), 0.75, 1_759_122_000_500_000_000),
        (("2025-09-29T13:00:00.000000001", "2025-09-29T13:00:00.000000004"), 3e-9, 1_759_122_000_000_000_001),
        (("2025-09-29T05:00:00Z", "2025-09-30T05:00:00Z"), 86_400.0, 1_759_122_000_000_000_000),
        (("2025-09-29T00:00:00-05:00", "2025-09-29T00:00:02-05:00"), 2.0, 1_759_122_000_000_000_000),
        (("29.09.2025 13:00:00,5", "29.09.2025 13:00:01,5"), 1.0, 1_759_122_000_500_000_000),
        (("2025/09/29 13:00", "2025/09/29 13:01"), 60.0, 1_759_122_000_000_000_000),
        (("23:59:59.9", "0:00:00.1"), 0.2, 0),
    ],
)
def test_dates_are_converted_to_seconds_from_the_first_one(
    tmp_path: Path, cells: tuple[str, str], seconds: float, epoch_ns: int
) -> None:
    """The wall clock is in the given time zone, eight hours ahead of UTC."""
    path = written(tmp_path, "Time;F\n" + "".join(f"{cell};1\n" for cell in cells))
    found = series_in(path, "Time", zone="Asia/Shanghai")["Time"]
    assert found.values.tolist() == [0.0, pytest.approx(seconds, rel=1e-12)]
    assert found.unit == "s"
    assert found.start_ns == epoch_ns


@pytest.mark.parametrize("cell", ["x", "13:00:00", "2025-09-29T13:00:00Z", "2025-13-29 13:00:00"])
def test_a_date_of_another_form_than_the_first_one_is_reported(tmp_path: Path, cell: str) -> None:
    path = written(tmp_path, f"t,F\n2025-09-29 13:00:00,1\n{cell},2\n")
    with pytest.raises(ConfigError, match=r"t: .* in row 2; allowed: as in the first row"):
        series_in(path, "t")


def test_a_date_with_ambiguous_day_and_month_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "t,F\n09/10/2025 13:00:00,1\n")
    with pytest.raises(ConfigError, match="or a date in each row, such as 2025-09-29"):
        series_in(path, "t")


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_more_than_20000_columns_are_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"t.{kind}"
    names = [f"c{k}" for k in range(20_001)]
    if kind == "csv":
        path.write_text(",".join(names) + "\n")
    else:
        parquet.write_table(pyarrow.table({name: [0.0] for name in names}), path)
    with pytest.raises(ConfigError, match="20001 columns; allowed: up to 20000"):
        open_file(path)


@pytest.mark.parametrize("unit", ["ns", "us", "ms", "s"])
def test_timestamps_in_parquet_are_converted_to_seconds_from_the_first_one(tmp_path: Path, unit: str) -> None:
    path = tmp_path / "t.parquet"
    times = np.array(["2025-09-29T05:00:00", "2025-09-29T05:00:02"], dtype=f"datetime64[{unit}]")
    spans = np.array([0, 1], dtype=f"timedelta64[{unit}]")
    columns = {
        "t": pyarrow.array(times, pyarrow.timestamp(unit)),
        "t_utc": pyarrow.array(times, pyarrow.timestamp(unit, "UTC")),
        "span": pyarrow.array(spans),
        "F": pyarrow.array([1, 2]).cast(pyarrow.decimal128(21, 2)),
    }
    parquet.write_table(pyarrow.table(columns), path)
    found = series_in(path, *columns, zone="Asia/Shanghai")
    assert found["t"].values.tolist() == found["t_utc"].values.tolist() == [0.0, 2.0]
    assert (found["t"].unit, found["t_utc"].start_ns) == ("s", 1_759_122_000_000_000_000)
    assert found["t"].start_ns == found["t_utc"].start_ns - 8 * 3600 * 10**9
    assert found["span"].values[1] == {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
    assert found["F"].values.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_wall_clocks_in_ms_us_or_ns_are_reported(tmp_path: Path, factor: float, unit: str) -> None:
    rows = "".join(f"{int((1_759_150_800 + k) * factor)},1\n" for k in range(3))
    path = written(tmp_path, f"time_s,pinch_force_n\n{rows}")
    (tmp_path / "s.toml").write_text('description = "x"\n[[expect]]\nname = "a"\nnever = "pinch_force_n > 5"\n')
    with pytest.raises(ConfigError, match=f"is it {unit}"):
        lh.judge([path], tmp_path / "s.toml")


@pytest.mark.parametrize("name", ["Speed, left", 'a "b"', "a;b"])
def test_a_column_name_with_a_delimiter_is_quoted(tmp_path: Path, name: str) -> None:
    source = tmp_path / "t.parquet"
    parquet.write_table(pyarrow.table({"time_s": [0.0, 1.0], name: [1.0, 2.0]}), source)
    assert main(["convert", str(source), str(tmp_path / "t.csv")]) == 0
    assert series_in(tmp_path / "t.csv", name)[name].values.tolist() == [1.0, 2.0]


def test_times_of_day_without_seconds_are_read_as_hours_and_minutes_with_a_note(tmp_path: Path) -> None:
    file = open_file(written(tmp_path, "t,F\n00:01,1\n00:02,2\n"))
    assert file.notes == ("t: 00:01 is read as hours and minutes",)
    assert series_in(file.path, "t")["t"].values.tolist() == [0.0, 60.0]
    assert open_file(written(tmp_path, "t,F\n00:01:00,1\n00:02:00,2\n")).notes == ()


@pytest.mark.parametrize("column", ["t[ms]", "t*1000"])
def test_a_unit_for_a_column_of_dates_is_refused(tmp_path: Path, column: str) -> None:
    path = written(tmp_path, "t,voltage_v,I\n" + "".join(f"2025-09-29 13:00:{k:02},6,1\n" for k in range(60)))
    (tmp_path / "s.toml").write_text('[[expect]]\nname = "a"\nalways = "left_current_a < 2"\n')
    maps = [f"time_s={column}", "left_current_a=I"]
    for read in (
        lambda: lh.judge([path], tmp_path / "s.toml", maps=maps),
        lambda: read_table(path, open_file(path), parse_maps(maps)),
    ):
        with pytest.raises(ConfigError, match=r"time_s \(t\): dates, which are in s; allowed: in `maps` without"):
            read()


@pytest.mark.parametrize("target", ["t.mcap", "t.mf4", "t.parquet"])
def test_dates_keep_their_wall_clock_after_a_conversion(tmp_path: Path, target: str) -> None:
    path = written(tmp_path, "time_s,F\n2025-09-29 13:00:00Z,1\n2025-09-29 13:00:01Z,2\n", name="d.csv")
    assert main(["convert", str(path), str(tmp_path / target)]) == 0
    assert open_file(tmp_path / target).start_ns == 1_759_150_800 * 10**9


def test_unnamed_columns_are_left_out_with_a_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, "time_s,,F\n1,2,3\n2,3,3\n")
    assert main(["convert", str(path), str(tmp_path / "t.mf4")]) == 0
    assert "columns without a name are left out" in capsys.readouterr().err
    assert list(open_file(tmp_path / "t.mf4").names) == ["F"]


LARGE = [2**53, 2**53 + 1, -(2**63), 2**53 + 3, 5]  # of which two have more bits than a float


@pytest.mark.parametrize("form", ["csv", "semicolons.csv", "mf4", "parquet", "nulls.parquet"])
def test_integers_beyond_float_precision_are_rounded_with_a_note(tmp_path: Path, form: str) -> None:
    path = tmp_path / f"m.{form}"
    if form == "mf4":
        asammdf = pytest.importorskip("asammdf")
        with asammdf.MDF(version="4.10") as measured:
            measured.append([asammdf.Signal(np.array(LARGE), np.arange(5) * 0.1, name="n")])
            measured.save(path)
    elif form.endswith("csv"):
        mark = ";" if "semi" in form else ","
        rows = [f"{k / 10}{mark}{n}{mark}{1e20}" for k, n in enumerate(LARGE)]
        path.write_text("\n".join([f"time_s{mark}n{mark}x", *rows, ""]))
    else:
        numbers = [*LARGE, None] if "null" in form else [*LARGE, 6]
        parquet.write_table(pyarrow.table({"time_s": np.arange(6) * 0.1, "n": pyarrow.array(numbers)}), path)
    table = open_file(path)
    wanted = [name for name in ("time_s", "n", "x") if name in table.names or name == "time_s"]
    for _ in range(2):  # each pass counts anew
        found = np.concatenate(list(table.rows(wanted)))
        assert found[:5, 1].tolist() == [float(n) for n in LARGE]
        assert table.notes == (f"n: 2 integers beyond 2^53 rounded to 53 bits, the first is {2**53 + 1}",)


@pytest.mark.parametrize(
    "cell", ["nan", "NaN", "NA", "N/A", "#N/A", "null", "NULL", "None", "<NA>", "-nan", " NaN "]
)
@pytest.mark.parametrize("more", ["", ",bath none"])
def test_words_for_missing_values_are_read_as_empty_cells(tmp_path: Path, cell: str, more: str) -> None:
    extra = ",text" if more else ""
    path = written(tmp_path, f"time_s,F,G{extra}\n0,1,{cell}{more}\n1,{cell},2{more}\n2,{cell},{cell}{more}\n")
    found = series_in(path, "F", "G")
    np.testing.assert_array_equal(found["F"].values, [1.0, np.nan, np.nan])
    np.testing.assert_array_equal(found["G"].values, [np.nan, 2.0, np.nan])


def test_points_that_may_be_thousands_separators_are_noted(tmp_path: Path) -> None:
    """Excel writes 18 400 mA as 18.400 in German."""
    rows = [f"{k};{'18.400' if k == 5 else 900 + k}" for k in range(10)]
    file = open_file(written(tmp_path, "\n".join(["t;I [mA]", *rows, ""])))
    assert file.notes == ("18.400 is read as 18.4, not with thousands",)
    rows[3] = "3;0.250"  # so that they are decimal points
    assert open_file(written(tmp_path, "\n".join(["t;I [mA]", *rows, ""]))).notes == ()
