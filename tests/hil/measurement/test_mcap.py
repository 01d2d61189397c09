"""MCAP recordings of this program are read exactly as written; other files are refused."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.mcap_file import McapFile, open_mcap
from liftgate_hil.formats.open import open_writer
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS, ROW_WIDTH, columns_of

writer = pytest.importorskip("mcap.writer")

ROWS = 12_000  # in several chunks
EPOCH_NS = 1_700_000_000_123_456_789


def rows_of(count: int) -> np.ndarray:
    """Return random rows, whole numbers where the catalogue says so."""
    random = np.random.default_rng(1)
    rows = random.normal(size=(count, ROW_WIDTH)) * 10.0 ** random.integers(-9, 9, ROW_WIDTH)
    for name, signal in COLUMNS.items():
        if signal.is_whole:
            rows[:, COLUMN_PLACE[name]] = np.round(rows[:, COLUMN_PLACE[name]]) + 0.0
    rows[:, COLUMN_PLACE["time_s"]] = 0.001 * np.arange(1, count + 1)
    return rows


def recorded(path: Path, rows: np.ndarray, drives: int = 2) -> McapFile:
    recorder = open_writer(path, Content(columns_of(drives), "can3"))
    recorder.begin(EPOCH_NS)
    for first in range(0, len(rows), 999):
        recorder.write_rows(rows[first : first + 999])
    recorder.close()
    assert recorder.failure == ""
    return open_mcap(path)


def test_any_columns_are_read_back_exactly_in_any_order(tmp_path: Path) -> None:
    rows = rows_of(ROWS)
    file = recorded(tmp_path / "run.mcap", rows)
    assert file.names == columns_of(2)
    assert file.start_ns == EPOCH_NS
    for wanted in (
        ["sensed_left_current_a", "time_s", "left_hall_count", "gate_angle_deg"],
        ["time_s"],
        ["sensed_gate_angle_deg"],
    ):
        blocks = list(file.rows(wanted))
        assert len(blocks) > 1
        expected = rows[:, [COLUMN_PLACE[name] for name in wanted]]
        assert np.array_equal(np.concatenate(blocks).view(np.int64), expected.view(np.int64))


def test_a_recording_of_a_gate_with_one_drive_has_the_columns_of_that_drive(tmp_path: Path) -> None:
    assert recorded(tmp_path / "run.mcap", rows_of(3), drives=1).names == columns_of(1)


# What is none.


def made(write: Callable[[Any], None]) -> bytes:
    """Content of an MCAP file of another program, whose records `write` adds to its writer."""
    stream = io.BytesIO()
    new = writer.Writer(stream)
    new.start()
    write(new)
    new.finish()
    return stream.getvalue()


def foreign(new: Any) -> None:
    """Write a message on the topic /truth, as another program might."""
    schema = new.register_schema("x", "jsonschema", b"{}")
    new.add_message(new.register_channel("/truth", "json", schema), 0, b"{}", 0)


def told(path: Path, content: bytes) -> str:
    """Return the single issue with which a file of this content is refused, without its name."""
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        open_mcap(path).read(["time_s"], [])
    (issue,) = caught.value.issues
    assert issue.startswith(f"{path}: ")
    return issue.removeprefix(f"{path}: ")


def test_an_mcap_file_of_another_program_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    assert told(path, b"") == "cannot be read: not an MCAP file"
    assert told(path, b"time_s,left_current_a\n0,1\n") == "cannot be read: not an MCAP file"
    ours = "not written by liftgate-hil; allowed: its own recordings"
    assert told(path, made(foreign)) == ours
    assert told(path, made(lambda _: None)) == ours


def test_a_truncated_mcap_file_is_reported(tmp_path: Path) -> None:
    recorded(tmp_path / "run.mcap", rows_of(2000))
    whole = (tmp_path / "run.mcap").read_bytes()
    for length in (9, 16, 100, len(whole) // 2, len(whole) - 1):
        said = told(tmp_path / "cut.mcap", whole[:length])
        assert said == "cannot be read: it was not completed, its end is missing"


def test_a_corrupted_byte_in_an_mcap_file_is_reported_and_never_changes_values(tmp_path: Path) -> None:
    expected = recorded(tmp_path / "run.mcap", rows_of(200)).read(["left_current_a"], [])
    whole = (tmp_path / "run.mcap").read_bytes()
    path, refused = tmp_path / "hurt.mcap", 0
    for place in range(20, len(whole) - 20, len(whole) // 60):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        try:
            found = open_mcap(path).read(["left_current_a"], issues := [])
        except ConfigError as error:
            issues = error.issues
        if issues:
            refused += issues[0].startswith(f"{path}: ")
            continue
        assert np.array_equal(found["left_current_a"].values, expected["left_current_a"].values)
    assert refused > 20


def test_a_null_in_mcap_json_is_an_empty_cell(tmp_path: Path) -> None:
    rows = rows_of(5)
    rows[3, COLUMN_PLACE["gate_angle_deg"]] = np.nan
    issues: list[str] = []
    found = recorded(tmp_path / "run.mcap", rows).read(["time_s", "gate_angle_deg"], issues)
    assert issues == []
    assert np.isnan(found["gate_angle_deg"].values).tolist() == [False] * 3 + [True, False]
