"""`simulate`'s rows in files: every column is the row's value of that name, in CSV and in MF4."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from liftgate_hil.recording.rows import write_rows
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS, columns_of
from liftgate_plant.signals import SUFFIXES

ROWS = np.array(
    [
        [100.0 * k + place + 0.5 * (not signal.is_whole) for place, signal in enumerate(COLUMNS.values())]
        for k in range(5)
    ]
)  # fmt: skip
BLOCKS = [ROWS[:2], ROWS[2:2], ROWS[2:]]


@pytest.mark.parametrize("drives", [1, 2])
@pytest.mark.parametrize("offline", [False, True])
def test_every_column_of_the_table_is_the_rows_value_of_its_name(
    tmp_path: Path, drives: int, offline: bool
) -> None:
    names = columns_of(drives, offline)
    path = tmp_path / "out.csv"
    write_rows(str(path), BLOCKS, names)
    with path.open(newline="") as stream:
        table = list(csv.DictReader(stream))
    assert list(table[0]) == names
    for row, found in zip(ROWS, table, strict=True):
        for name in names:
            assert float(found[name]) == row[COLUMN_PLACE[name]], name
            assert ("." in found[name]) is not COLUMNS[name].is_whole, name


@pytest.mark.filterwarnings("ignore")  # asammdf's own
@pytest.mark.parametrize("offline", [False, True])
def test_every_channel_of_the_mf4_is_the_rows_value_of_its_name(
    tmp_path: Path, offline: bool
) -> None:
    from asammdf import MDF

    names = columns_of(2, offline)
    path = tmp_path / "out.mf4"
    write_rows(str(path), BLOCKS, names)
    with MDF(path) as measured:
        for name in names[1:]:
            channel = measured.get(name)
            assert np.array_equal(channel.samples, ROWS[:, COLUMN_PLACE[name]]), name
            assert np.array_equal(channel.timestamps, ROWS[:, COLUMN_PLACE["time_s"]]), name
            assert channel.unit == SUFFIXES[COLUMNS[name].unit].removeprefix("_"), name
