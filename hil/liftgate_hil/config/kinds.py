"""Kinds of values: what a key of a file or an option of a run may hold, and how it is read."""

from __future__ import annotations

import contextlib
import math
import os
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from liftgate_hil.config.toml import Table, is_number, is_whole, number, show, table, text
from liftgate_hil.errors import ConfigIssues, with_unit

_UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_SIZE = re.compile(r"(\d{1,18}(?:\.\d+)?) ?((?:[KMGT]?B)?)", re.IGNORECASE | re.ASCII)
_EMPTY: Table = {}  # which nobody changes
Value = TypeVar("Value")


class Kind(Protocol):
    """Protocol of a kind of value that a key may have."""

    @property
    def allowed(self) -> str:
        """The allowed values in words, for messages."""

    @property
    def invalid(self) -> Any:
        """The value that stands in memory for an invalid or missing one."""

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Any:
        """Return a value as it is held in memory; `invalid` and an issue if it is not allowed."""


class OfKind(Generic[Value]):
    """Base class of the kinds of values, with `allowed` in words and the substitute `invalid`."""

    allowed: str
    invalid: Value

    def __init__(self, allowed: str = "") -> None:
        self.allowed = allowed or self.allowed

    def refused(self, issues: ConfigIssues, key: str, value: object) -> Value:
        """Note that a value is not allowed, and return the substitute `invalid`."""
        issues.add(key, f"{show(value)}; allowed: {self.allowed}")
        return self.invalid


class Number(OfKind[float]):
    """Kind of value: a number from `low` to `high` [`unit`], multiplied by `scale` for the unit in memory."""

    invalid = math.nan

    def __init__(self, low: float, high: float, unit: str = "", scale: float = 1.0) -> None:
        super().__init__(with_unit(f"{low:g} to {high:g}", unit))
        self.low, self.high, self.unit, self.scale = low, high, unit, scale

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float:
        """Return the number in the unit in memory; NaN and an issue if it is invalid."""
        return self.scale * number(issues, key, value, self.low, self.high, self.unit)


class Flag(OfKind[bool]):
    """Kind of value: a boolean."""

    allowed, invalid = "true or false", False

    def read(self, issues: ConfigIssues, key: str, value: Any) -> bool:
        """Return the boolean; false and an issue if the value is no boolean."""
        return value if isinstance(value, bool) else self.refused(issues, key, value)


class Whole(OfKind[int]):
    """Kind of value: a whole number within [low, high]; `low` stands for invalid ones."""

    def __init__(self, low: int, high: int) -> None:
        super().__init__(f"a whole number from {low} to {high}")
        self.low, self.high, self.invalid = low, high, low

    def read(self, issues: ConfigIssues, key: str, value: Any) -> int:
        """Return the whole number; `low` and an issue if it is invalid."""
        found = int(value) if isinstance(value, float) and value.is_integer() else value
        return found if is_whole(found, self.low, self.high) else self.refused(issues, key, value)


class Size(OfKind[int]):
    """Kind of value: a size of at least `least` bytes, as a whole number or a text with a unit ("500MB")."""

    def __init__(self, least: int) -> None:
        super().__init__(f"bytes from {least:,} on, or a size such as 500MB, 2GB")
        self.invalid = least

    def read(self, issues: ConfigIssues, key: str, value: Any) -> int:
        """Return the size in bytes; `least` and an issue if it is invalid."""
        match = _SIZE.fullmatch(value) if isinstance(value, str) else None
        found = round(float(match[1]) * _UNITS[match[2].upper()]) if match else value
        return found if is_whole(found, self.invalid) else self.refused(issues, key, value)


class Choice(OfKind[str]):
    """Kind of value: one of several words."""

    invalid = ""

    def __init__(self, words: Sequence[str]) -> None:
        super().__init__(f"one of {', '.join(words)}")
        self.words = words

    def read(self, issues: ConfigIssues, key: str, value: Any) -> str:
        """Return the word; "" and an issue if the value is none of those allowed."""
        return text(issues, key, value, self.words)


class Choices(OfKind[tuple[str, ...]]):
    """Kind of value: a list of which each item is one of several words."""

    invalid = ()

    def __init__(self, values: Sequence[str]) -> None:
        super().__init__(f"a list of {', '.join(values)}")
        self._values = values

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[str, ...]:
        """Return the items; an empty tuple and an issue if they are invalid."""
        is_valid = isinstance(value, list) and all(each in self._values for each in value)
        return tuple(value) if is_valid else self.refused(issues, key, value)


class Level(OfKind[float]):
    """Kind of value: a binary level, 0 or 1, or a word for a level."""

    invalid = math.nan

    def __init__(self, words: tuple[str, str] = ("low", "high")) -> None:
        super().__init__(f"0 ({words[0]}) or 1 ({words[1]})")
        self.words = words

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float:
        """Return the level, 0.0 or 1.0; NaN and an issue if it is invalid."""
        if isinstance(value, str) and value in self.words:
            return float(self.words.index(value))
        return float(value) if is_number(value) and value in (0, 1) else self.refused(issues, key, value)


class Label(OfKind[float]):
    """Kind of value: value of a bus signal, as a number in the database's unit or a label of its value table."""

    allowed, invalid = "a number, or a label of the signal", math.nan

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float | str:
        """Return the number or the label; NaN and an issue if the value is neither."""
        if isinstance(value, str) and value:
            return value
        if is_number(value) and abs(value) <= sys.float_info.max:  # a whole number may be beyond it
            return float(value)
        self.refused(issues, key, value)
        issues.settle(key)  # the signal's own reader has no other issue with it
        return math.nan


class Text(OfKind[str]):
    """Kind of value: any text that is not empty; `allowed` is what messages call it."""

    allowed, invalid = "a text", ""

    def read(self, issues: ConfigIssues, key: str, value: Any) -> str:
        """Return the text, also of a path; "" and an issue if the value is no text or empty."""
        value = os.fspath(value) if isinstance(value, os.PathLike) else value
        return value if isinstance(value, str) and value.strip() else self.refused(issues, key, value)


class Texts(OfKind[tuple[str, ...]]):
    """Kind of value: a list of texts, or a single text; `allowed` is what messages call it."""

    invalid = ()

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[str, ...]:
        """Return the texts; an empty tuple and an issue if they are invalid."""
        given = [value] if isinstance(value, str | os.PathLike) else value
        if not isinstance(given, list) or not all(isinstance(each, str | os.PathLike) and each for each in given):
            return self.refused(issues, key, value)
        return tuple(map(os.fspath, given))


class Names(OfKind[tuple[str, ...]]):
    """Kind of value: names, in a list or separated by commas; `allowed` is what messages call them."""

    allowed, invalid = "names, in a list or separated by commas", ()

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[str, ...]:
        """Return the names; an empty tuple and an issue if they are invalid."""
        given = [value] if isinstance(value, str) else value
        if isinstance(given, list) and all(isinstance(each, str) for each in given):
            found = tuple(name.strip() for each in given for name in each.split(",") if name.strip())
            if found or not given:
                return found
        return self.refused(issues, key, value)


class File(OfKind[Path]):
    """Kind of value: the path of a file."""

    allowed, invalid = "a path", Path()

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Path:
        """Return the path; `Path()` and an issue if the value is no path."""
        return Path(value) if _is_named(value) else self.refused(issues, key, value)


class Paths(OfKind[tuple[Path, ...]]):
    """Kind of value: paths of files, in a list, or a single path."""

    allowed, invalid = "a path, or a list of them", ()

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[Path, ...]:
        """Return the paths; an empty tuple and an issue if they are invalid."""
        given = value if isinstance(value, list) else [value]
        if not given or not all(map(_is_named, given)):
            issues.add(key, f"{show(value) if given else 'none'}; allowed: {self.allowed}")
            return self.invalid
        return tuple(map(Path, given))


class Loaded(OfKind[Any]):
    """Kind of value: a shipped name, a file, or an object already loaded from one, of a class with these names.

    Not every command loads the classes; the first one is public.
    """

    invalid = ""

    def __init__(self, classes: tuple[str, ...]) -> None:
        super().__init__(f"a shipped name, a file, a {classes[0]}")
        self._classes = classes

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Any:
        """Return a text, a path or an object of these classes unchanged; "" and an issue for any other value."""
        is_valid = _is_named(value) or type(value).__name__ in self._classes
        return value if is_valid else self.refused(issues, key, value)


class NumbersByName(OfKind[dict[str, float]]):
    """Kind of value: numbers by name, as a mapping or as texts NAME=VALUE."""

    allowed, invalid = "NAME=VALUE with a finite number, each name once", _EMPTY

    def read(self, issues: ConfigIssues, key: str, value: Any) -> dict[str, float]:
        """Return the numbers by name; an issue if a text states none, or a name twice.

        Numbers in a mapping are validated where they are used, with their ranges there.
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


class NumberOr(OfKind[None]):
    """Kind of value: a number, or a text that another reader validates; `allowed` is what messages call it."""

    invalid = None

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float | str | None:
        """Return the number or the text, of whatever words; None and an issue if the value is neither."""
        return value if isinstance(value, str) or is_number(value) else self.refused(issues, key, value)


class Raw(OfKind[None]):
    """Kind of value: any value, which another reader validates later."""

    invalid = None

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Any:
        """Return the value unchanged."""
        return value


class Subtable(OfKind[Table]):
    """Kind of value: a table, whose keys are read separately."""

    allowed, invalid = "a table", _EMPTY

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Table:
        """Return the table; an empty one and an issue if the value is no table."""
        return table(issues, key, value)


def _is_named(value: object) -> bool:
    """Whether a value may be the name or path of a file: a text or path that is not empty."""
    return isinstance(value, str | os.PathLike) and bool(os.fspath(value))


def listed(given: str | Path | Sequence[str | Path]) -> list[str | Path]:
    """Return the items of a value of kind Texts or Paths: those of a list, or the single one."""
    return [given] if isinstance(given, str | Path) else list(given)


SEED = Whole(0, 2**32 - 1)
