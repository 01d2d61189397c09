"""Report files: own ones are replaced, other content is set aside, failures change nothing."""

from __future__ import annotations

import errno
import json
import os
import tempfile
from pathlib import Path

import pytest
from hil_support import text_file

from liftgate_compiler.files import name_beside
from liftgate_hil.errors import ConfigError
from liftgate_hil.report.drawing import new_figure, pdf, png
from liftgate_hil.report.files import check_targets, is_ours, put_report
from liftgate_hil.report.page import page
from liftgate_hil.testing.junit import issues_as_junit

OURS = {
    "report.html": page("a title", "", ["<p>text</p>"]).encode(),
    "junit.xml": issues_as_junit(["an issue"]),
    "verdicts.json": b'{\n  "verdict": "pass", "provenance": {"versions": {"liftgate-hil": "1"}}}',
    "fit.json": b'{"model": "full", "provenance": {"versions": {"liftgate-hil": "1"}}}',
}
THEIRS = {
    "report.html": b"<!DOCTYPE html><html><head><title>liftgate-hil</title></head></html>",
    "junit.xml": b'<?xml version="1.0"?><testsuites name="pytest tests"></testsuites>',
    "verdicts.json": b'{\n  "verdict": "pass"\n}',
    "package.json": b'{"name": "liftgate-hil", "provenance": ["versions"]}',
    "list.json": b'["liftgate-hil"]',
    "vehicle.toml": b"[identification]\n",
    "photo.png": b"\x89PNG\r\n\x1a\n",
    "paper.pdf": b"%PDF-1.4\n/Creator (LaTeX)\n",
    "figure.svg": b"<svg><dc:title>Inkscape</dc:title></svg>",
}


@pytest.mark.parametrize("name", OURS)
def test_a_report_of_this_program_is_replaced(tmp_path: Path, name: str) -> None:
    path, said = tmp_path / name, list[str]()
    path.write_bytes(OURS[name])
    put_report(path, b"after", said.append)
    assert path.read_bytes() == b"after"
    assert list(tmp_path.iterdir()) == [path]
    assert said == []


def test_a_figure_of_this_program_is_recognized(tmp_path: Path) -> None:
    for path, content in (
        (tmp_path / "a.png", png(new_figure(1.0, 1.0))),
        (tmp_path / "a.pdf", pdf(new_figure(1.0, 1.0))),
    ):
        path.write_bytes(content)
        assert is_ours(path)


@pytest.mark.parametrize("name", THEIRS)
def test_a_foreign_file_at_the_target_is_renamed_before_a_report_is_written(tmp_path: Path, name: str) -> None:
    path, said = tmp_path / name, list[str]()
    aside, second = (path.with_name(f"{path.stem}.previous{end}{path.suffix}") for end in ("", ".2"))
    for content in (THEIRS[name], b"not ours either"):
        path.write_bytes(content)
        put_report(path, b"after", said.append)
    assert path.read_bytes() == b"after"
    assert (aside.read_bytes(), second.read_bytes()) == (THEIRS[name], b"not ours either")
    assert said == [f"{path}: the file that was there is now {each}" for each in (aside, second)]


def test_unchanged_content_is_not_written_again(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.toml"
    put_report(path, b"[motor]\n")
    before = path.stat()
    put_report(path, b"[motor]\n")
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mtime_ns == before.st_mtime_ns


@pytest.mark.parametrize("operation", ["fsync", "link", "replace"])
def test_a_failed_write_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, operation: str) -> None:
    path = tmp_path / "photo.png"
    path.write_bytes(b"somebody's")

    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, operation, fail)
    with pytest.raises((OSError, ConfigError)):
        put_report(path, b"after")
    assert [each.read_bytes() for each in tmp_path.iterdir()] == [b"somebody's"]
    assert path.exists() == (operation != "replace")


def test_a_foreign_file_in_a_read_only_folder_is_not_overwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A report of this program would be overwritten in place."""
    real = os.open

    def refuse(path: object, flags: int, *more: int, **others: object) -> int:
        if flags & os.O_CREAT:
            raise OSError(errno.EACCES, os.strerror(errno.EACCES))
        return real(path, flags, *more, **others)  # type: ignore[arg-type]

    path = tmp_path / "report.html"
    tempfile.gettempdir()  # which is found by creating a file, once
    monkeypatch.setattr(os, "open", refuse)
    path.write_bytes(THEIRS["report.html"])
    with pytest.raises(OSError, match="Permission denied"):
        put_report(path, b"after")
    assert path.read_bytes() == THEIRS["report.html"]
    path.write_bytes(OURS["report.html"])
    put_report(path, b"after")
    assert path.read_bytes() == b"after"


def test_temporary_files_of_a_killed_process_beside_a_target_are_removed(tmp_path: Path) -> None:
    left, other = tmp_path / name_beside("fit.json"), tmp_path / name_beside("other.json")
    left.touch()
    other.touch()
    check_targets({"result": str(tmp_path / "fit.json")}, [])
    assert list(tmp_path.iterdir()) == [other]


@pytest.mark.parametrize("link", [os.link, os.symlink])
def test_a_target_that_is_also_an_input_is_refused(tmp_path: Path, link: object) -> None:
    source, target = tmp_path / "in.csv", tmp_path / "out.json"
    source.write_text("time_s\n")
    link(source, target)  # type: ignore[operator]
    with pytest.raises(ConfigError, match=r"`result` .*out\.json: is an input file; allowed: a separate file"):
        check_targets({"result": str(target)}, [tmp_path / "not there", source])


def test_a_report_of_another_kind_is_recognized(tmp_path: Path) -> None:
    from liftgate_hil.report.files import is_of_another_kind

    path = text_file(tmp_path / "k.json", json.dumps({"provenance": {"versions": {"liftgate-hil": "1"}}}))
    assert not is_of_another_kind(path, "json")
    assert is_of_another_kind(path, "html")
    assert is_of_another_kind(path, "junit")
