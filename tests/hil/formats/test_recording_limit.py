"""Recordings in files of a limited size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_support import BOTH, messages_in, read_csv, rows_from, sent

from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.open import FORMATS, open_writer
from liftgate_hil.formats.rotation import Limit
from liftgate_hil.running.options import RunOptions

LIMIT = 300_000
BUS = [suffix for suffix, each in FORMATS.items() if each.has_frames]


def recorded(path: Path, limit: Limit, rows: int, frames: int) -> list[Path]:
    random = np.random.default_rng(1)
    recorder = open_writer(path, BOTH, limit)
    recorder.begin(10**18)
    for k in range(0, rows, 100):
        block = rows_from(k, 100)
        block[:, 1:5] = random.normal(size=(100, 4))
        recorder.write_rows(block)
    for k in range(0, frames, 100):
        payloads = random.bytes(800)
        block = [(k + n, payloads[8 * n : 8 * n + 8]) for n in range(100)]
        recorder.write_frames(sent([(0x80000000 | number, data) for number, data in block], 1e-3 * k))
    recorder.close()
    assert recorder.failure == ""
    return [Path(name) for name in recorder.files]


@pytest.mark.parametrize("suffix", BUS)
@pytest.mark.filterwarnings("ignore")
def test_all_frames_are_there_once_in_files_that_sort_and_are_not_larger(tmp_path: Path, suffix: str) -> None:
    files = recorded(tmp_path / f"run{suffix}", Limit(LIMIT), 0, 30_000)
    assert len(files) > 1
    assert files == sorted(tmp_path.iterdir())
    assert files[0].name == f"run.0001{suffix}"
    found: list[int] = []
    for file in files:
        assert file.stat().st_size <= LIMIT
        found += [message.arbitration_id for message in messages_in(file)]
    assert found == list(range(30_000))


def test_all_rows_are_there_once_each_file_with_its_header(tmp_path: Path) -> None:
    files = recorded(tmp_path / "run.csv", Limit(LIMIT), 3000, 0)
    assert len(files) > 2
    assert all(file.stat().st_size <= LIMIT for file in files)
    times = [row["time_s"] for file in files for row in read_csv(file)]
    assert times == [0.001 * k for k in range(3000)]


def test_a_run_that_fits_has_one_file(tmp_path: Path) -> None:
    assert recorded(tmp_path / "run.csv", Limit(LIMIT), 100, 0) == [tmp_path / "run.0001.csv"]


def test_the_last_files_are_kept(tmp_path: Path) -> None:
    files = recorded(tmp_path / "run.csv", Limit(LIMIT, keep=2), 5000, 0)
    assert len(files) == 2
    assert sorted(tmp_path.iterdir()) == files
    assert read_csv(files[-1])[-1]["time_s"] == 4.999
    assert int(files[0].name.split(".")[1]) > 1


def test_what_an_earlier_run_left_is_not_mixed_with_this_one(tmp_path: Path) -> None:
    assert len(recorded(tmp_path / "run.csv", Limit(LIMIT), 3000, 0)) > 2
    other = tmp_path / "run.final.0001.csv"
    other.write_text("somebody's")
    files = recorded(tmp_path / "run.csv", Limit(LIMIT), 100, 0)
    assert sorted(tmp_path.iterdir()) == sorted([*files, other])


def test_two_cannot_record_to_one_row_of_files(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    first = open_writer(path, BOTH, Limit(LIMIT, keep=2))
    for k in range(30):
        first.write_rows(rows_from(100 * k, 100))
    with pytest.raises(ConfigError, match="another recording is being written to it"):
        open_writer(path, BOTH, Limit(LIMIT))
    first.close()
    assert all(Path(name).is_file() for name in first.files)


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"record_limit": 1000}, "`record_limit` 1000: allowed: bytes from 1,000,000 on"),
        ({"record_keep": 2}, "`record_keep` 2: allowed: together with `record_limit`"),
        ({"record_limit": 10**6, "record_keep": 1}, "`record_keep` 1: allowed: a whole number from 2 to"),
    ],
)
def test_a_limit_that_cannot_be_is_reported(more: dict[str, int], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        RunOptions(**more).check()
