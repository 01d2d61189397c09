"""Parquet files as measurements: the same columns as CSV, and what cannot be one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.mapping import parse_maps
from liftgate_hil.measurement.measurement import Measurement
from liftgate_hil.measurement.table import read_measurement

TIMES = [0.0, 0.1, 0.2, 0.3]
COLUMNS: dict[str, Any] = {"time_s": TIMES, "U": [12.0] * 4, "left_current_a": [1.0, None, 3.0, 4.0]}


def read(path: Path, columns: dict[str, Any], *maps: str) -> Measurement:
    units = {"U": "mV"}
    fields = [
        pa.field(name, pa.array(values).type, metadata={"unit": units.get(name, "")})
        for name, values in columns.items()
    ]
    parquet.write_table(pa.table(list(map(pa.array, columns.values())), pa.schema(fields)), path)
    return read_measurement(path, parse_maps(maps), lambda: pytest.fail("no rig is needed"))


def test_columns_have_their_values_units_and_empty_cells(tmp_path: Path) -> None:
    found = read(tmp_path / "m.parquet", COLUMNS, "left_voltage_v=U")
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
def test_what_is_no_measurement_is_reported(tmp_path: Path, change: Any, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        read(tmp_path / "m.parquet", COLUMNS | change, "left_voltage_v=U")


def test_what_is_no_parquet_is_reported(tmp_path: Path) -> None:
    (tmp_path / "m.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(ConfigError, match=r"m\.parquet: cannot be read"):
        read_measurement(tmp_path / "m.parquet", {}, lambda: pytest.fail("no rig is needed"))
