"""Recordings split into files of a limited size."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recording_support import BOTH, messages_in, read_csv, rows_from, sent

from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.guarded import GuardedWriter
from liftgate_hil.formats.open import open_writer
from liftgate_hil.formats.rotation import Limit
from liftgate_hil.formats.suffixes import FORMATS
from liftgate_hil.formats.target import aside_of
from liftgate_hil.plan.request import RunRequest

LIMIT = 300_000
BUS = [suffix for suffix, each in FORMATS.items() if each.has_frames]


def recorded(path: Path, limit: Limit, rows: int, frames: int) -> list[Path]:
    """Record these numbers of rows and frames with a limit; return the paths of the files."""
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


def write_many(recorder: GuardedWriter) -> None:
    """Write more rows than a file of the limit holds."""
    for k in range(30):
        recorder.write_rows(rows_from(100 * k, 100))


@pytest.mark.parametrize("suffix", BUS)
@pytest.mark.filterwarnings("ignore")
def test_all_frames_are_recorded_once_in_sorted_files_below_the_limit(tmp_path: Path, suffix: str) -> None:
    files = recorded(tmp_path / f"run{suffix}", Limit(LIMIT), 0, 30_000)
    assert len(files) > 1
    assert files == sorted(tmp_path.iterdir())
    assert files[0].name == f"run.0001{suffix}"
    found: list[int] = []
    for file in files:
        assert file.stat().st_size <= LIMIT
        found += [message.arbitration_id for message in messages_in(file)]
    assert found == list(range(30_000))


def test_all_rows_are_recorded_once_in_files_with_a_header_each(tmp_path: Path) -> None:
    files = recorded(tmp_path / "run.csv", Limit(LIMIT), 3000, 0)
    assert len(files) > 2
    assert all(file.stat().st_size <= LIMIT for file in files)
    times = [row["time_s"] for file in files for row in read_csv(file)]
    assert times == [0.001 * k for k in range(3000)]


def test_a_run_below_the_limit_has_one_file(tmp_path: Path) -> None:
    assert recorded(tmp_path / "run.csv", Limit(LIMIT), 100, 0) == [tmp_path / "run.0001.csv"]


def test_only_the_last_files_are_kept(tmp_path: Path) -> None:
    files = recorded(tmp_path / "run.csv", Limit(LIMIT, keep=2), 5000, 0)
    assert len(files) == 2
    assert sorted(tmp_path.iterdir()) == files
    assert read_csv(files[-1])[-1]["time_s"] == 4.999
    assert int(files[0].name.split(".")[1]) > 1


def names_in(folder: Path) -> list[str]:
    return sorted(each.name for each in folder.iterdir())


@pytest.mark.parametrize("suffix", [".csv", ".log", ".blf"])
def test_only_one_earlier_recording_is_kept(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    first = recorded(path, Limit(LIMIT), 3000, 30_000)
    assert len(first) > 2
    contents = [each.read_bytes() for each in first]
    (second,) = recorded(path, Limit(LIMIT), 100, 100)
    asides = [aside_of(each) for each in first]
    assert [each.read_bytes() for each in asides] == contents
    assert names_in(tmp_path) == sorted(each.name for each in (second, *asides))
    content = second.read_bytes()
    assert recorded(path, Limit(LIMIT), 100, 100) == [second]
    assert names_in(tmp_path) == [second.name, aside_of(second).name]
    assert aside_of(second).read_bytes() == content


@pytest.mark.parametrize("suffix", [".csv", ".log"])
def test_foreign_files_are_neither_counted_nor_deleted(tmp_path: Path, suffix: str) -> None:
    """Nor is a recording of ours that is named like a part by chance, nor a link."""
    path = tmp_path / f"drive{suffix}"
    (whole,) = recorded(path, Limit(LIMIT), 100, 100)
    others = [tmp_path / f"drive.{name}{suffix}" for name in ("2024", "final.0001", "0004", "0003.previous")]
    whole.rename(others[0])
    for each in others[1:]:
        each.write_text("somebody's")
    (tmp_path / f"drive.0002{suffix}").symlink_to(others[1])
    contents = [each.read_bytes() for each in others]
    for _ in range(2):
        files = recorded(path, Limit(LIMIT, keep=2), 3000, 30_000)
        assert len(files) == 2
    found = [each.read_bytes() for each in tmp_path.iterdir() if not each.is_symlink()]
    assert all(each in found for each in contents)
    assert others[0].read_bytes() == contents[0]


def test_files_of_an_earlier_recording_count_for_the_number_to_keep(tmp_path: Path) -> None:
    path, limit = tmp_path / "run.csv", Limit(LIMIT, keep=4)
    first = recorded(path, limit, 5000, 0)
    assert len(first) == 4
    open_writer(path, BOTH, limit).close()
    assert names_in(tmp_path) == sorted(["run.0001.csv", *(aside_of(each).name for each in first[1:])])
    files = recorded(path, limit, 5000, 0)
    assert names_in(tmp_path) == [each.name for each in files]


def test_a_file_that_replaced_an_earlier_one_meanwhile_is_not_deleted(tmp_path: Path) -> None:
    path, limit = tmp_path / "run.csv", Limit(LIMIT, keep=3)
    first = recorded(path, limit, 5000, 0)
    recorder = open_writer(path, BOTH, limit)
    aside_of(first[-1]).write_text("somebody's")
    write_many(recorder)
    recorder.close()
    assert recorder.failure == ""
    assert len(recorder.files) == 3
    assert aside_of(first[-1]).read_text() == "somebody's"


def test_an_input_file_named_like_a_part_is_not_deleted(tmp_path: Path) -> None:
    path, limit = tmp_path / "run.csv", Limit(LIMIT, keep=2)
    files = recorded(path, limit, 5000, 0)
    content = files[0].read_bytes()
    recorder = open_writer(path, replace(BOTH, inputs=[files[0]]), limit)
    write_many(recorder)
    recorder.close()
    assert files[0].read_bytes() == content


def test_recording_to_a_name_that_is_being_recorded_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    first = open_writer(path, BOTH, Limit(LIMIT, keep=2))
    write_many(first)
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
def test_an_invalid_file_size_limit_or_number_to_keep_is_refused(more: dict[str, int], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        RunRequest(**more).check()
