"""Names that are no files, and extreme file contents: one clear message, without delay."""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hil_support import issues_of, text_file

from liftgate_hil.config.rig import load_rig
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.toml import DEEPEST, MOST_BYTES, read_toml
from liftgate_hil.config.vehicle import load_vehicle
from liftgate_hil.errors import MOST, ConfigError, ConfigIssues, TransportError, printable

LOADERS: list[Callable[[Path], Any]] = [load_vehicle, load_rig, load_scenario]


def test_a_byte_order_mark_is_ignored(tmp_path: Path):
    path = tmp_path / "v.toml"
    path.write_bytes(b"\xef\xbb\xbfdrives = 2\r\n")
    assert read_toml(path) == {"drives": 2}


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (Path.mkdir, "is a folder"),
        (os.mkfifo, "is a pipe"),
        (lambda path: path.symlink_to(path), "Too many levels of symbolic links"),
        (lambda path: path.symlink_to(path.with_name("gone")), "a link to no file"),
    ],
)
def test_a_folder_pipe_or_link_loop_is_reported_as_such(tmp_path: Path, make: Callable[[Path], Any], said: str):
    path = tmp_path / "x.toml"
    make(path)
    for load in LOADERS:
        (issue,) = issues_of(load, path)
        assert said in issue
    (issue,) = issues_of(find_config, "rigs", str(path))
    assert issue.startswith("`rig` ")
    assert said in issue


@pytest.mark.parametrize("name", ["a" * 300, "a" * 300 + ".toml"])
def test_a_too_long_file_name_is_reported_as_such(name: str):
    (issue,) = issues_of(find_config, "vehicles", name)
    assert "File name too long" in issue
    assert len(issue) < 150


@pytest.mark.parametrize("name", ["x\0y.toml", "\udcff.toml", "none", "none.toml", "none/none"])
def test_a_name_that_is_neither_a_file_nor_a_shipped_name_is_reported(tmp_path: Path, name: str):
    (issue,) = issues_of(find_config, "vehicles", name)
    assert "no such file" in issue or "neither a file nor a shipped name" in issue


def test_a_file_with_a_similar_name_is_suggested(tmp_path: Path):
    (tmp_path / "test_reverses.toml").touch()
    for name in ("test_closes.toml", "test_reverses.csv"):
        (tmp_path / name).touch()
    (issue,) = issues_of(find_config, "scenarios", str(tmp_path / "test_reverse.toml"))
    assert f"no such file; did you mean {tmp_path / 'test_reverses.toml'}? allowed: a file, or" in issue
    (issue,) = issues_of(find_config, "scenarios", str(tmp_path / "else" / "test_reverse.toml"))
    assert "no such file; allowed: a file, or" in issue


def test_an_unreadable_database_of_a_rig_is_reported_with_the_cause(tmp_path: Path):
    rig = text_file(tmp_path / "r.toml", 'dbc = "x.dbc"\n')
    (tmp_path / "x.dbc").symlink_to(tmp_path / "x.dbc")
    (issue,) = issues_of(load_rig, rig)
    assert "x.dbc: cannot be read: Too many levels" in issue


def issues_soon(load: Callable[[Path], Any], path: Path) -> list[str]:
    """Return the issues of a file, within a time that a quadratic effort in its keys would exceed."""
    before = time.process_time()
    issues = issues_of(load, path)
    assert time.process_time() - before < 10.0
    return issues


@pytest.mark.parametrize("load", LOADERS)
def test_of_many_unknown_keys_20_are_listed_and_the_others_counted(tmp_path: Path, load: Callable[[Path], Any]):
    path = text_file(tmp_path / "x.toml", "".join(f"k{i}=1\n" for i in range(100_000)))
    issues = issues_soon(load, path)
    assert len([issue for issue in issues if ": unknown key; allowed" in issue]) == 20
    assert any("k20: and 99979 more: unknown keys" in issue for issue in issues)
    assert len(issues) <= MOST + 1


@pytest.mark.parametrize("load", LOADERS)
@pytest.mark.parametrize(
    "content",
    [
        ".".join("a" * 50_000) + " = 1\n",
        "[" + " . ".join(["'b'", '"c"'] * 1500) + "]\n",
        "a = " + "{ b = " * 3000 + "1" + " }" * 3000,
        "a = " + "{ b = " * (DEEPEST + 1) + "1" + " }" * (DEEPEST + 1),
        "a = " + "[" * (DEEPEST + 1) + "]" * (DEEPEST + 1),
        "".join(f"k{i}=1\n" for i in range(700_000)),
        "a" * (MOST_BYTES - 10) + " = 1\n",
    ],
    ids=["50,000 parts", "quoted", "3,000 tables", "a table too many", "lists", "7 MB", "one key"],
)
def test_too_deep_or_too_large_content_is_reported_without_delay(
    tmp_path: Path, load: Callable[[Path], Any], content: str
):
    path = text_file(tmp_path / "x.toml", content)
    for issue in issues_soon(load, path):
        assert "allowed" in issue or "not valid TOML" in issue
        assert len(issue) < 1000


def test_dots_in_texts_and_lists_do_not_count_as_nested_keys(tmp_path: Path):
    path = text_file(tmp_path / "x.toml", f'a = "{"1. " * 50}"\nb = [{"1.5, " * 50}]\n')
    assert len(read_toml(path)["b"]) == 50


def test_control_characters_are_escaped_in_messages(tmp_path: Path):
    path = text_file(tmp_path / "v\x1b[31m.toml", '"\\u001b]0;owned\\u0007" = 1\n"a\\nb\\u202e" = "\\u009b2J"\n')
    issues = issues_of(load_vehicle, path)
    assert any("\\x1b]0;owned\\x07" in issue for issue in issues)
    assert printable("\x1b[0m°µ…\ud800") == "\\x1b[0m°µ…\\ud800"
    assert str(TransportError("a\nb\x07")) == "a\nb\\x07"


def test_line_breaks_in_names_stay_escaped_when_an_error_is_pickled():
    error = ConfigError(["one\ntwo", "three"])
    assert pickle.loads(pickle.dumps(error)).issues == ["one\\ntwo", "three"]


def test_issues_beyond_a_maximum_are_counted_and_not_listed():
    issues = ConfigIssues("file")
    for i in range(1000):
        issues.add(f"k{i}", "wrong")
    lines = issues_of(issues.raise_if_any)
    assert len(lines) == MOST + 1
    assert lines[-1] == f"file: and {1000 - MOST} more issues"
