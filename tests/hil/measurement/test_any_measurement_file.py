"""Whatever a file holds: a measurement, or faults that name it."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hil_support import CALM, shipped_rig
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.table import read_measurement

CELLS = st.sampled_from(["0", "1", "-1.5e3", "", "nan", "inf", "x", " 2 ", '"3"', '"', "1,5", "1e400"])
NAMES = st.sampled_from(
    ["time_s", "voltage_v", "left_duty", "left_current_a", "latched", "left_coast", "left_current_ma", ""]
)


def read_or_told(name: str, content: bytes) -> None:
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
def test_any_table(names: list[str], rows: list[list[str]], delimiter: str) -> None:
    lines = [names, *rows]
    read_or_told("m.csv", "\n".join(delimiter.join(line) for line in lines).encode())


@pytest.mark.parametrize("name", ["m.csv", "m.log", "m.asc", "m.blf", "m.trc"])
@CALM
@given(content=st.binary(max_size=300))
def test_any_bytes(name: str, content: bytes) -> None:
    read_or_told(name, content)


@pytest.mark.parametrize("name", ["m.log", "m.asc", "m.trc"])
@CALM
@given(content=st.text(alphabet="0123456789ABCDEF #().canRdxT\n;", max_size=200))
def test_any_text(name: str, content: str) -> None:
    read_or_told(name, content.encode())
