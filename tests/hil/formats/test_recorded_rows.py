"""Rows in recordings: every column with its name, every number to the last bit, in every table format."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest
from hil_support import OPEN, both, command_frame, frames_of, loop_config, outside, start_of
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_support import BOTH, ROW, read_csv, recorded_rows, rows_from, table_in

from liftgate_hil.codec.frames import Frames, empty_frames
from liftgate_hil.config.rig import Rig
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.csv_writer import CsvText, put_lines
from liftgate_hil.formats.open import open_writer
from liftgate_hil.formats.suffixes import TABLES
from liftgate_hil.loop.tick import tick
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS, ON_TIME, ROW_WIDTH, columns_of

PROMISED = [
    "time_s",
    "left_voltage_v",
    "left_current_a",
    "left_speed_rps",
    "left_position_rev",
    "left_hall_count",
    "left_force_n",
    "right_voltage_v",
    "right_current_a",
    "right_speed_rps",
    "right_position_rev",
    "right_hall_count",
    "right_force_n",
    "gate_angle_deg",
    "gate_rate_degps",
    "pinch_force_n",
    "terminal_voltage_v",
]
NUMBERS = [0.0, -0.0, 1.0 / 3.0, math.pi * 1e-300, -1e22, 5e-324, 0.1 + 0.2, 1e16, 123456789.0, -7.5e-7]


def unit_in(path: Path, name: str) -> str:
    """Return the unit of a column as other programs read it."""
    if path.suffix == ".parquet":
        from pyarrow import parquet

        return parquet.read_schema(path).field(name).metadata[b"unit"].decode()
    if path.suffix == ".mcap":
        from mcap.reader import make_reader

        with path.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        (schema,) = [each for each in summary.schemas.values() if each.name.endswith("/truth")]
        return json.loads(schema.data)["properties"][name]["unit"]
    from asammdf import MDF

    with MDF(path) as measured:
        return measured.get(name).unit


@pytest.mark.parametrize("suffix", TABLES)
@pytest.mark.parametrize(("drives", "offline"), [(1, False), (2, False), (2, True)])
@pytest.mark.filterwarnings("ignore")  # asammdf's own
def test_every_column_has_the_values_of_its_name(tmp_path: Path, suffix: str, drives: int, offline: bool) -> None:
    """For one row or many at a time: no column is permuted, missing or doubled."""
    names, rows = columns_of(drives, offline), rows_from(0, 300)
    for blocks in ([rows], [rows[:1], rows[1:1], rows[1:]], [row[np.newaxis] for row in rows]):
        path = recorded_rows(tmp_path / f"table{suffix}", *blocks, content=Content(names))
        table = table_in(path)
        assert list(table) == names
        for name, values in table.items():
            assert np.array_equal(values, rows[:, COLUMN_PLACE[name]]), name
    assert {each.name for each in tmp_path.iterdir()} == {path.name, f"table.previous{suffix}"}


@pytest.mark.parametrize("suffix", [".parquet", ".mf4", ".mcap"])
@pytest.mark.filterwarnings("ignore")
def test_a_column_has_its_unit_in_the_file(tmp_path: Path, suffix: str) -> None:
    path = recorded_rows(tmp_path / f"table{suffix}", rows_from(0, 3))
    assert unit_in(path, "gate_rate_degps") == "degps"
    assert unit_in(path, "latched") == ""


@pytest.mark.parametrize("suffix", TABLES)
@pytest.mark.filterwarnings("ignore")
def test_numbers_read_back_to_the_last_bit(tmp_path: Path, suffix: str) -> None:
    rows = rows_from(0, len(NUMBERS))
    names = [name for name, signal in COLUMNS.items() if not signal.is_whole and name != "time_s"]
    for k, name in enumerate(names):
        rows[:, COLUMN_PLACE[name]] = np.roll(NUMBERS, k)
    table = table_in(recorded_rows(tmp_path / f"table{suffix}", rows))
    for name in names:
        bits = np.ascontiguousarray(rows[:, COLUMN_PLACE[name]]).view(np.int64)
        assert np.array_equal(table[name].view(np.int64), bits), name


def test_columns_have_their_documented_order_and_names_that_end_in_a_unit() -> None:
    assert list(COLUMNS)[: len(PROMISED)] == PROMISED
    # What the ECU sees stands beside the truth, with a prefix.
    assert {"sensed_left_current_a", "sensed_right_hall_count"} < set(COLUMNS)
    units = (
        "_s", "_v", "_a", "_rps", "_rev", "_count", "_n", "_nm", "_ns", "_deg", "_degps", "_degc", "_pa", "_kg",
        "_m", "_mps2", "_duty", "_coast", "latched", "_hall_b", "_hall_speed", "_pulled", "_pressed", "_position",
        "_half", "_home", "_strip", "_missed", "_dropped", "_made",
    )  # fmt: skip
    assert all(name.endswith(units) for name in columns_of(2))


def test_a_gate_with_one_drive_has_no_right_columns() -> None:
    assert set(columns_of(1)) == {name for name in columns_of(2) if "right_" not in name}


# The text of CSV.


def one_by_one(names: list[str], rows: np.ndarray) -> bytes:
    """Return the CSV lines written cell by cell."""
    lines = []
    for row in rows:
        cells = []
        for name in names:
            value = float(row[COLUMN_PLACE[name]])
            if not math.isfinite(value):
                cells.append(repr(value))
            elif COLUMNS[name].is_whole:
                cells.append(str(int(value)))
            else:
                cells.append(orjson.dumps(value).decode())
        lines.append(",".join(cells) + "\n")
    return "".join(lines).encode()


@pytest.fixture(params=["plain", "compiled"])
def text(request: pytest.FixtureRequest) -> CsvText:
    """The writer of CSV lines of all columns, in plain Python and in machine code."""
    made = CsvText(columns_of(2))
    if request.param == "plain":
        made._put = put_lines
    return made


CELL = st.one_of(
    st.sampled_from([*NUMBERS, math.nan, math.inf, -math.inf]), st.floats(width=64)
)  # fmt: skip
WHOLE = st.one_of(st.integers(-(2**53), 2**53), st.sampled_from([0, -1, 9, 10, 99, 100, math.nan]))


@given(data=st.data(), count=st.integers(1, 5))
@settings(max_examples=60, deadline=None)
def test_a_csv_line_is_its_cells_joined_by_commas(data: Any, count: int) -> None:
    rows = np.tile(ROW, (count, 1))
    for name in data.draw(st.lists(st.sampled_from(sorted(COLUMNS)), unique=True)):
        kind = WHOLE if COLUMNS[name].is_whole else CELL
        column = data.draw(st.lists(kind, min_size=count, max_size=count))
        rows[:, COLUMN_PLACE[name]] = column
    names = columns_of(2)
    text = CsvText(names)
    assert text.lines(rows) == one_by_one(names, rows)


def test_plain_python_writes_the_same_lines_as_machine_code(text: CsvText) -> None:
    rows = rows_from(0, 7)
    rows[3, ::3] = np.nan
    rows[4, ::4] = -np.inf
    rows[5:, 7:] = rows[5, 7:]
    assert text.lines(rows) == one_by_one(columns_of(2), rows)
    assert text.lines(rows[:0]) == b""


def test_equal_columns_are_written_with_the_same_text(text: CsvText) -> None:
    """Except whole numbers, which have no point; -0.0 and 0.0 are different."""
    rows = rows_from(0, 9)
    numbers = [1.0, -2.0, 3.0, math.nan, 0.0, math.inf, 7.0, 8.0, 9.0]
    for name in ("left_hall_count", "left_current_a", "right_current_a", "gate_angle_deg"):
        rows[:, COLUMN_PLACE[name]] = numbers
    rows[4, COLUMN_PLACE["right_current_a"]] = -0.0
    assert COLUMNS["left_hall_count"].is_whole
    assert text.lines(rows) == one_by_one(columns_of(2), rows)


def test_numbers_are_written_with_the_fewest_digits_that_read_back_the_same() -> None:
    random = np.random.default_rng(1)
    numbers = random.integers(-(2**63), 2**63, 20_000).view(np.float64)
    numbers = numbers[np.isfinite(numbers)]
    text = CsvText(["left_current_a"])
    rows = np.zeros((len(numbers), ROW_WIDTH))
    rows[:, COLUMN_PLACE["left_current_a"]] = numbers
    cells = text.lines(rows).decode().splitlines()
    for cell, value in zip(cells, numbers.tolist(), strict=True):
        assert float(cell) == value
        assert len(digits(cell)) == len(digits(repr(value)))


def digits(text: str) -> str:
    """Return the significant digits of a number."""
    return text.lstrip("-").partition("e")[0].replace(".", "").strip("0")


def test_the_text_of_rows_does_not_depend_on_the_block_size() -> None:
    rows = rows_from(0, 20_000)
    rows[:, 5:20] = rows[0, 5:20]
    rows[12_345:, 10] = 0.25
    names = columns_of(2)
    text = CsvText(names)
    whole = text.lines(rows)
    assert whole == b"".join(text.lines(rows[k : k + 777]) for k in range(0, len(rows), 777))
    assert whole.count(b"\n") == len(rows)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_rows_of_a_diverged_plant_are_recorded(tmp_path: Path, value: float) -> None:
    for suffix in TABLES:
        recorded_rows(tmp_path / f"run{suffix}", rows_from(0, 3), np.full((1, ROW_WIDTH), value))
    assert set((tmp_path / "run.csv").read_text().splitlines()[-1].split(",")) == {repr(value)}


@pytest.mark.parametrize("which", ["plain", "compiled"])
def test_recorded_rows_equal_the_rows_of_their_ticks(rig: Rig, fast_tick: Any, tmp_path: Path, which: str) -> None:
    call = tick if which == "plain" else fast_tick
    config = loop_config(rig=rig)
    state = start_of(config)
    path = tmp_path / "plant.csv"
    recorder = open_writer(path, BOTH)
    recorded = []
    for number in range(50):
        given = [command_frame(rig, number // 10, **both(50.0, OPEN, 1))]
        frames: Frames = frames_of(given) if number % 10 == 0 else empty_frames(0)
        state, _, truth, sensed = call(config, state, frames, outside())
        recorder.write_rows(np.array([*truth, *sensed, *ON_TIME])[np.newaxis])
        recorded.append((*truth, *sensed, *ON_TIME))
    recorder.close()
    assert [tuple(row.values()) for row in read_csv(path)] == recorded
    with path.open(newline="") as stream:
        row = list(csv.DictReader(stream))[-1]
    assert row["left_hall_count"].lstrip("-").isdigit()
    assert row["left_coast"] == "0"
