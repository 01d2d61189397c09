"""What the checkers of rig and scenario files allow, in their own words: asked by files in which all is wrong."""

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
    """Key: what the message on it allows, of a file with this content.

    Where a table has the key `UNKNOWN`, its entry lists the keys that the table may have.
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
    """The keys that a table may have."""
    key = f"{prefix}.{UNKNOWN}" if prefix else UNKNOWN
    return answers[key].split(", ")


def a_range(answer: str) -> str:
    """An answer as it stands in a table: what follows "one of" as code."""
    if answer.startswith("one of "):
        return ", ".join(f"`{each}`" for each in answer.removeprefix("one of ").split(", "))
    return answer
