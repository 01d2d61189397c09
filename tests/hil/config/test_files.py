"""The message for a file that cannot be read names the true cause."""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path

import pytest
from hil_support import issues_of

from liftgate_hil.config.files import check_file, issue_with, read_bytes
from liftgate_hil.errors import ConfigError


def listening(path: Path) -> None:
    # A socket's name has room for 107 letters.
    with contextlib.chdir(path.parent), socket.socket(socket.AF_UNIX) as made:
        made.bind(path.name)


CASES = {
    "a folder": ("folder", Path.mkdir, "is a folder; allowed: a file"),
    "a FIFO": ("fifo.toml", os.mkfifo, "is a pipe; allowed: a file"),
    "a socket": ("socket.toml", listening, "is a socket; allowed: a file"),
    "a device": ("/dev/zero", None, "is a device; allowed: a file"),
    "nothing": ("no.toml", None, "no such file"),
    "a link to nothing": ("link", lambda path: path.symlink_to("gone"), "a link to no file; allowed: a file"),
    "a loop": ("loop", lambda path: path.symlink_to(path), "cannot be read: Too many levels of symbolic links"),
    "a name too long": ("n" * 300, None, "cannot be read: File name too long"),
    "below a file": ("file/x.toml", lambda path: path.parent.touch(), "cannot be read: Not a directory"),
    "a NUL": ("a\0b", None, "no such file"),
    "no text": ("\ud800", None, "no such file"),
}


@pytest.mark.parametrize("case", CASES)
def test_the_cause_why_a_file_cannot_be_read_is_reported(case, tmp_path):
    name, make, said = CASES[case]
    path = tmp_path / name
    if make is not None:
        make(path)
    assert issue_with(path).startswith(said)
    for read in (check_file, read_bytes):
        (issue,) = issues_of(read, path, called="`vehicle` theirs")
        assert issue.startswith(f"`vehicle` theirs: {said}")


def test_a_file_without_read_permission_is_not_reported_as_missing(tmp_path, monkeypatch):
    path = tmp_path / "locked" / "x.toml"
    path.parent.mkdir()
    path.write_text("a = 1\n")

    def refused(*_, **__):
        raise PermissionError(13, "Permission denied")

    # Root may read everything: the system's answer stands in for it.
    monkeypatch.setattr(Path, "stat", refused)
    assert issue_with(path) == "cannot be read: Permission denied"
    monkeypatch.undo()
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert issue_with(path) == "cannot be read: Permission denied"
    monkeypatch.undo()
    monkeypatch.setattr(Path, "read_bytes", refused)
    with pytest.raises(ConfigError, match="cannot be read: Permission denied"):
        read_bytes(path)


def test_a_file_whose_name_is_not_utf8_can_be_read(tmp_path):
    path = tmp_path / "x\udcff.toml"  # a name that is not UTF-8
    path.write_bytes(b"a\0\xff")
    assert issue_with(path) == ""
    assert read_bytes(path) == b"a\0\xff"


def test_a_file_above_the_size_limit_is_not_read(tmp_path):
    path = tmp_path / "large.toml"
    path.write_bytes(b"a" * 11)
    with pytest.raises(ConfigError, match="11 bytes; allowed: up to 10"):
        read_bytes(path, 10)
    assert len(read_bytes(path, 11)) == 11
