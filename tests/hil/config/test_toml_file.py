"""Contents of TOML files: every mistake is a ConfigError with file, key and what is allowed."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hil_support import issues_of, text_file

from liftgate_hil.config.rig import load_rig
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.config.toml import known_keys, number, show, text
from liftgate_hil.config.vehicle import load_vehicle
from liftgate_hil.errors import ConfigError, ConfigIssues

LOADERS: list[Callable[[Path], Any]] = [load_vehicle, load_rig, load_scenario]


@pytest.mark.parametrize("load", LOADERS)
@pytest.mark.parametrize(
    "content",
    [
        b"drives = ",
        b"[motor\n",
        b"a = 1\na = 2\n",
        b"\xff\xfe\x00d",
        b"\x00\x01\x02",
        b"drives = 99999999999999999999999999999999" + b"9" * 5000,
        b"x = " + b"[" * 3000,
    ],
    ids=["no value", "open table", "twice", "utf-16", "binary", "5000 digits", "deep nesting"],
)
def test_a_file_that_is_no_toml_is_one_issue_with_its_path(
    tmp_path: Path, load: Callable[[Path], Any], content: bytes
):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    (issue,) = issues_of(load, path)
    assert str(path) in issue


@pytest.mark.parametrize("load", LOADERS)
def test_an_empty_file_is_an_issue_unless_it_is_a_scenario(tmp_path: Path, load: Callable[[Path], Any]):
    path = text_file(tmp_path / "empty.toml", "")
    if load is load_scenario:
        assert load(path).duration is None
    else:
        with pytest.raises(ConfigError, match=r"missing|allowed"):
            load(path)


@pytest.mark.parametrize(
    "value",
    [
        *(pytest.param(each, id=str(each)) for each in (math.nan, math.inf, -1.0, 10.1)),
        *(pytest.param(each, id=repr(each)) for each in (True, "5", None, [1], {})),
        *(pytest.param(sign * 10**400, id=f"{sign:+} huge") for sign in (1, -1)),
    ],
)
def test_a_value_that_is_no_number_in_range_is_reported_with_the_range(value: object):
    issues = ConfigIssues("file")
    number(issues, "key", value, 0.0, 10.0, "V")
    (line,) = issues.lines
    assert line.startswith("file: key: ")
    assert "0 to 10 V" in line


@pytest.mark.parametrize("value", [0, 0.0, 10, 10.0, 3])
def test_a_range_includes_its_limits(value: float):
    issues = ConfigIssues("file")
    assert number(issues, "key", value, 0.0, 10.0) == value
    assert issues.lines == []


@pytest.mark.parametrize("value", [1, None, ["a"], "c", ""])
def test_a_value_that_is_no_allowed_text_is_reported_with_the_allowed_ones(value: object):
    issues = ConfigIssues("file")
    assert text(issues, "key", value, ("a", "b")) == ""
    assert "a, b" in issues.lines[0]


def test_an_empty_text_is_an_issue_even_where_any_text_is_allowed():
    issues = ConfigIssues("file")
    text(issues, "key", "")
    assert issues.lines


def test_all_unknown_keys_are_reported():
    issues = ConfigIssues("file")
    known_keys(issues, "t", {"a": 1, "b": 2, "c": 3}, ("a", "d"))
    assert [line.split(": ")[1] for line in issues.lines] == ["t.b", "t.c"]
    assert "allowed: a, d" in issues.lines[0]


@pytest.mark.parametrize("value", ["x" * 1000, "a\nb", list(range(1000))])
def test_a_value_in_a_message_is_shortened_to_one_line(value: object):
    assert len(show(value)) <= 60
    assert "\n" not in show(value)
