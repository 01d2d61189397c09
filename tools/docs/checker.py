"""Allowed keys and values of rig and scenario files, read from the checkers' messages on files full of errors."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import tomlkit

from liftgate_hil.errors import ConfigError

WRONG = "?"
UNKNOWN = "no_such_key"


def allowed(load: Callable[[Path], object], content: Mapping[str, Any]) -> dict[str, str]:
    """Return what is allowed for each key, from the issues that `load` reports for a file with this content.

    If a table contains the key `UNKNOWN`, the entry of that key lists the keys that the table may have. Raises
    AssertionError if the file has no issues.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "wrong.toml")
        path.write_text(tomlkit.dumps(content), encoding="utf-8")
        try:
            load(path)
        except ConfigError as error:
            lines = [str(line).removeprefix(f"{path}: ") for line in error.issues]
        else:
            raise AssertionError("a file in which all is wrong was taken")
    found: dict[str, str] = {}
    for line in lines:
        match = re.fullmatch(r"(\S+): .*?allowed: (.*)", line)
        if match:
            found.setdefault(match[1], match[2])
    return found


def keys_of(answers: Mapping[str, str], prefix: str = "") -> list[str]:
    """Return the keys that a table may have."""
    key = f"{prefix}.{UNKNOWN}" if prefix else UNKNOWN
    return answers[key].split(", ")


def a_range(answer: str) -> str:
    """Return an answer as a table shows it: the words after "one of" as code."""
    if answer.startswith("one of "):
        return ", ".join(f"`{each}`" for each in answer.removeprefix("one of ").split(", "))
    return answer
