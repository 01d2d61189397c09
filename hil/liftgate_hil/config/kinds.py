"""Kinds of values: what a key of a file or an option of a run may be, and how that is read."""

from __future__ import annotations

import contextlib
import math
import os
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from liftgate_hil.config.toml import Table, number, show, table, text
from liftgate_hil.errors import ConfigIssues

_UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_SIZE = re.compile(r"(\d{1,18}(?:\.\d+)?) ?((?:[KMGT]?B)?)", re.IGNORECASE | re.ASCII)


class Kind(Protocol):
    """Kind of the values that a key may have."""

    @property
    def allowed(self) -> str:
        """The allowed values in words."""

    @property
    def invalid(self) -> Any:
        """The value in memory in place of an invalid or missing one."""

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Any:
        """Return the value as it is in memory; `invalid` and an issue if it is not allowed."""


class Number(NamedTuple):
    """Kind of value: a number from `low` to `high` [`unit`], times `scale` in the unit in memory."""

    low: float
    high: float
    unit: str = ""
    scale: float = 1.0

    @property
    def invalid(self) -> float:
        """NaN."""
        return math.nan

    @property
    def allowed(self) -> str:
        """The range with its unit."""
        return f"{self.low:g} to {self.high:g}{' ' + self.unit if self.unit else ''}"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float:
        """Return the number in the unit in memory; NaN and an issue if it is invalid."""
        return self.scale * number(issues, key, value, self.low, self.high, self.unit)


class Flag:
    """Kind of value: a boolean."""

    allowed, invalid = "true or false", False

    def read(self, issues: ConfigIssues, key: str, value: Any) -> bool:
        """Return the value; false and an issue if it is no boolean."""
        if not isinstance(value, bool):
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
        return value is True


class Whole(NamedTuple):
    """Kind of value: a whole number within [low, high]."""

    low: int
    high: int

    @property
    def allowed(self) -> str:
        """The range in words."""
        return f"a whole number from {self.low} to {self.high}"

    @property
    def invalid(self) -> int:
        """The lowest number."""
        return self.low

    def read(self, issues: ConfigIssues, key: str, value: Any) -> int:
        """Return the number; `low` and an issue if it is invalid."""
        found = int(value) if isinstance(value, float) and value.is_integer() else value
        if isinstance(found, bool) or not isinstance(found, int) or not self.low <= found <= self.high:
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return self.invalid
        return found


class Size(NamedTuple):
    """Kind of value: a size of at least `least` bytes, as a whole number or a text with a unit ("500MB")."""

    least: int

    @property
    def allowed(self) -> str:
        """The range in words."""
        return f"bytes from {self.least:,} on, or a size such as 500MB, 2GB"

    @property
    def invalid(self) -> int:
        """The smallest size."""
        return self.least

    def read(self, issues: ConfigIssues, key: str, value: Any) -> int:
        """Return the size in bytes; `least` and an issue if it is invalid."""
        match = _SIZE.fullmatch(value) if isinstance(value, str) else None
        found = round(float(match[1]) * _UNITS[match[2].upper()]) if match else value
        if isinstance(found, bool) or not isinstance(found, int) or found < self.least:
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return self.invalid
        return found


class Choice(NamedTuple):
    """Kind of value: one of several words."""

    words: Sequence[str]

    @property
    def invalid(self) -> str:
        """An empty text."""
        return ""

    @property
    def allowed(self) -> str:
        """The list of the words."""
        return f"one of {', '.join(self.words)}"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> str:
        """Return the word; "" and an issue if it is none of them."""
        return text(issues, key, value, self.words)


class Choices(NamedTuple):
    """Kind of value: a list of which each item is one of several words."""

    values: Sequence[str]

    @property
    def invalid(self) -> tuple[str, ...]:
        """An empty tuple."""
        return ()

    @property
    def allowed(self) -> str:
        """The list of the words."""
        return f"a list of {', '.join(self.values)}"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[str, ...]:
        """Return the items; an empty tuple and an issue if they are invalid."""
        if not isinstance(value, list) or any(each not in self.values for each in value):
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return self.invalid
        return tuple(value)


class Level(NamedTuple):
    """Kind of value: a binary level, 0 or 1, or the word for it."""

    words: tuple[str, str] = ("low", "high")

    @property
    def invalid(self) -> float:
        """NaN."""
        return math.nan

    @property
    def allowed(self) -> str:
        """Both levels with their words."""
        return f"0 ({self.words[0]}) or 1 ({self.words[1]})"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float:
        """Return 0.0 or 1.0; NaN and an issue if it is neither."""
        if isinstance(value, str) and value in self.words:
            return float(self.words.index(value))
        if isinstance(value, int | float) and not isinstance(value, bool) and value in (0, 1):
            return float(value)
        issues.add(key, f"{show(value)}; allowed: {self.allowed}")
        return math.nan


class Label(NamedTuple):
    """Kind of value: that of a signal, as a number in the database's unit or a label of its value table."""

    allowed: str = "a number, or a label of the signal"

    @property
    def invalid(self) -> float:
        """NaN."""
        return math.nan

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float | str:
        """Return the number or the label; NaN and an issue if it is neither."""
        if isinstance(value, str) and value:
            return value
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if is_number and abs(value) <= sys.float_info.max:  # a whole number may be beyond it
            return float(value)
        issues.add(key, f"{show(value)}; allowed: {self.allowed}")
        issues.settle(key)  # the signal's own reader has no other issue with it
        return math.nan


class Text(NamedTuple):
    """Kind of value: any text that is not empty; `allowed` is what messages call it."""

    allowed: str = "a text"

    @property
    def invalid(self) -> str:
        """An empty text."""
        return ""

    def read(self, issues: ConfigIssues, key: str, value: Any) -> str:
        """Return the text, of a path, too; "" and an issue if it is none."""
        value = os.fspath(value) if isinstance(value, os.PathLike) else value
        if not isinstance(value, str) or not value.strip():
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return ""
        return value


class Texts(NamedTuple):
    """Kind of value: a list of texts, or a single text; `allowed` is what messages call it."""

    allowed: str

    @property
    def invalid(self) -> tuple[str, ...]:
        """An empty tuple."""
        return ()

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[str, ...]:
        """Return the texts; an empty tuple and an issue if they are invalid."""
        given = [value] if isinstance(value, str | os.PathLike) else value
        if not isinstance(given, list) or not all(isinstance(each, str | os.PathLike) and each for each in given):
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return self.invalid
        return tuple(map(os.fspath, given))


class Names(NamedTuple):
    """Kind of value: names, in a list or separated by commas; `allowed` is what messages call them."""

    allowed: str = "names, in a list or separated by commas"

    @property
    def invalid(self) -> tuple[str, ...]:
        """An empty tuple."""
        return ()

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[str, ...]:
        """Return the names; an empty tuple and an issue if they are invalid."""
        given = [value] if isinstance(value, str) else value
        if isinstance(given, list) and all(isinstance(each, str) for each in given):
            found = tuple(name.strip() for each in given for name in each.split(",") if name.strip())
            if found or not given:
                return found
        issues.add(key, f"{show(value)}; allowed: {self.allowed}")
        return self.invalid


class File:
    """Kind of value: the path of a file."""

    allowed, invalid = "a path", Path()

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Path:
        """Return the path; an issue if it is none."""
        if not isinstance(value, str | os.PathLike) or not os.fspath(value):
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return self.invalid
        return Path(value)


class Paths:
    """Kind of value: paths of files, in a list, or one."""

    allowed, invalid = "a path, or a list of them", ()

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[Path, ...]:
        """Return the paths; an empty tuple and an issue if they are invalid."""
        given = value if isinstance(value, list) else [value]
        if not given or not all(isinstance(each, str | os.PathLike) and os.fspath(each) for each in given):
            issues.add(key, f"{show(value) if given else 'none'}; allowed: {self.allowed}")
            return self.invalid
        return tuple(map(Path, given))


class Loaded(NamedTuple):
    """Kind of value: a shipped name, a file, or an object that was loaded from one."""

    classes: tuple[str, ...]  # their names, the public one first: not every command loads them
    invalid: str = ""

    @property
    def allowed(self) -> str:
        """Name, file and public class in words."""
        return f"a shipped name, a file, a {self.classes[0]}"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Any:
        """Return the value as it is; an issue if it is none of these."""
        is_named = isinstance(value, str | os.PathLike) and bool(os.fspath(value))
        if is_named or type(value).__name__ in self.classes:
            return value
        issues.add(key, f"{show(value)}; allowed: {self.allowed}")
        return self.invalid


class NumbersByName(NamedTuple):
    """Kind of value: numbers by their names, as a mapping or as texts NAME=VALUE."""

    allowed: str = "NAME=VALUE with a finite number, each name once"

    @property
    def invalid(self) -> dict[str, float]:
        """No numbers."""
        return {}

    def read(self, issues: ConfigIssues, key: str, value: Any) -> dict[str, float]:
        """Return the numbers by their names; an issue if the texts state none, or a name twice.

        Those of a mapping are validated where they are used, which states their ranges.
        """
        if isinstance(value, Mapping) and all(isinstance(name, str) for name in value):
            return dict(value)
        found: dict[str, float] = {}
        for each in value if isinstance(value, list) else [value]:
            name, _, text = (
                (part.strip() for part in each.partition("=")) if isinstance(each, str) else ("", "", "")
            )
            with contextlib.suppress(ValueError):
                if name and name not in found and math.isfinite(amount := float(text.replace("_", ""))):
                    found[name] = amount
                    continue
            issues.add(key, f"{show(each)}; allowed: {self.allowed}")
            break
        return found


class NumberOr(NamedTuple):
    """Kind of value: a number, or a word; `allowed` is what messages call it."""

    allowed: str

    @property
    def invalid(self) -> None:
        """None."""
        return None

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float | str | None:
        """Return the value; None and an issue if it is neither."""
        if isinstance(value, str | int | float) and not isinstance(value, bool):
            return value
        issues.add(key, f"{show(value)}; allowed: {self.allowed}")
        return self.invalid


class Raw(NamedTuple):
    """Kind of value: any, which a reader of its own validates later."""

    allowed: str

    @property
    def invalid(self) -> None:
        """None."""
        return None

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Any:
        """Return the value as it is."""
        return value


class Subtable(NamedTuple):
    """Kind of value: a table, whose keys are read later."""

    allowed: str = "a table"

    @property
    def invalid(self) -> Table:
        """An empty table."""
        return {}

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Table:
        """Return the table; an empty one and an issue if it is none."""
        return table(issues, key, value)


def listed(given: str | Path | Sequence[str | Path]) -> list[str | Path]:
    """Return the items of a value of Texts or Paths: those of a list, or the single one."""
    return [given] if isinstance(given, str | Path) else list(given)


SEED = Whole(0, 2**32 - 1)
