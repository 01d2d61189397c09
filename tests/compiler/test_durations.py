"""Recorded durations of compilations, for estimates of the next ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from liftgate_compiler import expected_s, note_duration


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    own = tmp_path / "liftgate-hil"
    own.mkdir(mode=0o700)
    return own


def test_the_last_duration_of_each_entry_point_is_kept(folder: Path) -> None:
    assert expected_s("run_realtime") is None
    note_duration("run_realtime", 30.04)
    note_duration("run_stretch", 20.0)
    note_duration("run_realtime", 12.3)
    assert (expected_s("run_realtime"), expected_s("run_stretch")) == (12.3, 20.0)
    assert [path.name for path in folder.iterdir()] == ["durations.json"]


@pytest.mark.parametrize(
    "content", ["", "[]", "5", '{"x": "y"}', '{"x": -1}', '{"x": 1e99}', '{"x": NaN}', "{", "\x00"]
)
def test_a_corrupted_file_of_durations_is_ignored(folder: Path, content: str) -> None:
    (folder / "durations.json").write_text(content)
    assert expected_s("x") is None
    note_duration("x", 3.0)
    assert expected_s("x") == 3.0


def test_without_a_writable_cache_no_duration_is_known(folder: Path) -> None:
    folder.rmdir()
    note_duration("x", 3.0)
    assert expected_s("x") is None
