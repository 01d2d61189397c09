"""An operator's marks, as foreign programs read them."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import can
import pytest
from recording_support import BOTH, messages_in, rows_from, sent

from liftgate_hil.formats.open import open_recording, open_writer
from liftgate_hil.formats.suffixes import FORMATS, RECORDED, WITH_MARKS

TEXT = "gate squeaks – left"


def written(path: Path) -> Path:
    writer = open_writer(path, BOTH)
    writer.begin(1_700_000_000_000_000_000)
    writer.write_rows(rows_from(0, 3))
    writer.write_frames(sent([(0x100 + k, bytes([k])) for k in range(3)], 0.001))
    writer.write_mark(0.0025, TEXT)
    writer.write_rows(rows_from(3, 3))
    writer.close()
    assert writer.failure == ""
    return path


def unpacked(path: Path) -> bytes:
    """The objects of a BLF with one container."""
    content = path.read_bytes()
    return zlib.decompress(content[content.index(b"LOBJ") + 32 :])


def test_asammdf_reads_a_marker_event(tmp_path: Path) -> None:
    from asammdf import MDF

    with MDF(written(tmp_path / "run.mf4")) as measured:
        (event,) = measured.events
        assert (event.name, event.value) == (TEXT, pytest.approx(0.0025))


def test_mcap_reads_a_message_on_marks(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    with written(tmp_path / "run.mcap").open("rb") as stream:
        (found,) = [each for _, channel, each in make_reader(stream).iter_messages() if channel.topic == "/marks"]
    assert json.loads(found.data) == {"time_s": 0.0025, "text": TEXT}
    assert found.log_time == 2_500_000


def test_a_blf_holds_a_global_marker(tmp_path: Path) -> None:
    path = written(tmp_path / "run.blf")
    reader = can.BLFReader(path)
    assert len(list(reader)) == 3
    reader.stop()
    assert b"gate squeaks ? left" in unpacked(path)  # in ASCII, as python-can writes it


@pytest.mark.parametrize("suffix", [".asc", ".trc"])
def test_text_logs_hold_a_comment(tmp_path: Path, suffix: str) -> None:
    path = written(tmp_path / f"run{suffix}")
    assert TEXT in path.read_text(encoding="utf-8")
    assert len(messages_in(path)) == 3


@pytest.mark.parametrize("suffix", RECORDED)
def test_a_mark_changes_neither_rows_nor_frames(tmp_path: Path, suffix: str) -> None:
    found = open_recording(written(tmp_path / f"run{suffix}"))
    rows = sum(len(block) for block in found.rows(["time_s"])) if found.signals else 0
    assert rows == (6 if FORMATS[suffix].has_rows else 0)
    assert sum(len(block) for block in found.frames()) == (3 if FORMATS[suffix].has_frames else 0)
    assert (suffix in WITH_MARKS) == (suffix not in (".csv", ".parquet", ".log"))


@pytest.mark.parametrize("suffix", [".mf4", ".mcap"])
def test_our_reader_has_them_too(tmp_path: Path, suffix: str) -> None:
    ((time_s, text),) = open_recording(written(tmp_path / f"run{suffix}")).marks
    assert (time_s, text) == (pytest.approx(0.0025), TEXT)
