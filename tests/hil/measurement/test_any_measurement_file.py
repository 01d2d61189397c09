"""Files with any content are read as measurements or refused with issues that name them."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hil_support import CALM, shipped_rig
from hypothesis import given
from hypothesis import strategies as st
from measurement_files import read
from pyarrow import parquet

from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.table import read_measurement

CELLS = st.sampled_from(["0", "1", "-1.5e3", "", "nan", "inf", "x", " 2 ", '"3"', '"', "1,5", "1e400"])
NAMES = st.sampled_from(
    ["time_s", "voltage_v", "left_duty", "left_current_a", "latched", "left_coast", "left_current_ma", ""]
)


def check_read_or_refused(name: str, content: bytes) -> None:
    """Check that a file is read as a sound measurement, or refused with issues that name it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        issues = [f"{path}: "]
        try:
            m = read_measurement(path, {}, shipped_rig())
            assert np.all(np.diff(m.times) > 0.0)
            assert all(len(values) == len(m.times) for values in m.columns.values())
        except ConfigError as error:
            issues = error.issues
        assert issues
        assert all(fault.startswith(f"{path}: ") for fault in issues)


@CALM
@given(
    st.lists(NAMES, min_size=1, max_size=5),
    st.lists(st.lists(CELLS, min_size=1, max_size=5), max_size=5),
    st.sampled_from([",", ";", "\t"]),
)
def test_any_table_is_read_or_refused(names: list[str], rows: list[list[str]], delimiter: str) -> None:
    lines = [names, *rows]
    check_read_or_refused("m.csv", "\n".join(delimiter.join(line) for line in lines).encode())


@pytest.mark.parametrize("name", ["m.csv", "m.log", "m.asc", "m.blf", "m.trc"])
@CALM
@given(content=st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(name: str, content: bytes) -> None:
    check_read_or_refused(name, content)


@pytest.mark.parametrize("name", ["m.log", "m.asc", "m.trc"])
@CALM
@given(content=st.text(alphabet="0123456789ABCDEF #().canRdxT\n;", max_size=200))
def test_any_text_is_read_or_refused(name: str, content: str) -> None:
    check_read_or_refused(name, content.encode())


# Parquet files: the same columns as CSV, and what cannot be one.

TIMES = [0.0, 0.1, 0.2, 0.3]
COLUMNS: dict[str, Any] = {"time_s": TIMES, "U": [12.0] * 4, "left_current_a": [1.0, None, 3.0, 4.0]}


def parquet_file(path: Path, columns: dict[str, Any]) -> Path:
    units = {"U": "mV"}
    fields = [
        pa.field(name, pa.array(values).type, metadata={"unit": units.get(name, "")})
        for name, values in columns.items()
    ]
    parquet.write_table(pa.table(list(map(pa.array, columns.values())), pa.schema(fields)), path)
    return path


def test_parquet_columns_are_read_with_values_converted_units_and_empty_cells(tmp_path: Path) -> None:
    found = read(parquet_file(tmp_path / "m.parquet", COLUMNS), "left_voltage_v=U")
    assert found.times.tolist() == TIMES
    assert found.columns["left_voltage_v"].tolist() == [0.012] * 4
    np.testing.assert_equal(found.columns["left_current_a"], [1.0, np.nan, 3.0, 4.0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"U": ["a"] * 4}, "U: string; allowed: numbers"),
        ({"U": [1.0, float("inf"), 1.0, 1.0]}, "U: inf in row 2; allowed: a finite number"),
        ({"time_s": [0.0, 0.2, 0.1, 0.3]}, "time_s: row 3; allowed: finite and rising"),
    ],
)
def test_parquet_with_texts_infinities_or_falling_times_is_refused(tmp_path: Path, change: Any, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        read(parquet_file(tmp_path / "m.parquet", COLUMNS | change), "left_voltage_v=U")


def test_a_file_that_is_no_parquet_is_reported(tmp_path: Path) -> None:
    (tmp_path / "m.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(ConfigError, match=r"m\.parquet: cannot be read"):
        read(tmp_path / "m.parquet")
