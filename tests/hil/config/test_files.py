"""What is said of a file that cannot be read is true."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from liftgate_hil.config.files import check_file, issue_with, read_bytes
from liftgate_hil.errors import ConfigError


def folder(at: Path) -> Path:
    return at


def fifo(at: Path) -> Path:
    os.mkfifo(at / "fifo.toml")
    return at / "fifo.toml"


def listening(at: Path) -> Path:
    # A socket's name has room for 107 letters.
    here = Path.cwd()
    os.chdir(at)
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind("socket.toml")
    finally:
        os.chdir(here)
    return at / "socket.toml"


def loop_of_links(at: Path) -> Path:
    (at / "a.toml").symlink_to("b.toml")
    (at / "b.toml").symlink_to("a.toml")
    return at / "a.toml"


def link_to_nothing(at: Path) -> Path:
    (at / "link.toml").symlink_to("gone.toml")
    return at / "link.toml"


def below_a_file(at: Path) -> Path:
    (at / "file").write_text("")
    return at / "file" / "x.toml"


CASES = {
    "a folder": (folder, "is a folder; allowed: a file"),
    "a FIFO": (fifo, "is a pipe; allowed: a file"),
    "a socket": (listening, "is a socket; allowed: a file"),
    "a device": (lambda at: Path("/dev/zero"), "is a device; allowed: a file"),
    "nothing": (lambda at: at / "no.toml", "no such file"),
    "a link to nothing": (link_to_nothing, "a link to no file; allowed: a file"),
    "a loop": (loop_of_links, "cannot be read: Too many levels of symbolic links"),
    "a name too long": (lambda at: at / ("n" * 300), "cannot be read: File name too long"),
    "below a file": (below_a_file, "cannot be read: Not a directory"),
    "a NUL": (lambda at: at / "a\0b", "no such file"),
    "no text": (lambda at: at / "\ud800", "no such file"),
}


@pytest.mark.parametrize("case", CASES)
def test_what_keeps_a_file_from_being_read_is_reported(case, tmp_path):
    make, said = CASES[case]
    path = make(tmp_path)
    assert issue_with(path).startswith(said)
    for read in (check_file, read_bytes):
        with pytest.raises(ConfigError) as raised:
            read(path, called="`vehicle` theirs")
        (issue,) = raised.value.issues
        assert issue.startswith(f"`vehicle` theirs: {said}")


def test_a_file_without_permission_is_not_called_missing(tmp_path, monkeypatch):
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


def test_a_file_is_read_whole(tmp_path):
    path = tmp_path / "x\udcff.toml"  # a name that is not UTF-8
    path.write_bytes(b"a\0\xff")
    assert issue_with(path) == ""
    assert read_bytes(path) == b"a\0\xff"


def test_a_file_that_is_far_too_large_is_not_read(tmp_path):
    path = tmp_path / "large.toml"
    path.write_bytes(b"a" * 11)
    with pytest.raises(ConfigError, match="11 bytes; allowed: up to 10"):
        read_bytes(path, 10)
    assert len(read_bytes(path, 11)) == 11
