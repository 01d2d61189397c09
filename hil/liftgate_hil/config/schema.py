"""Schema of the tables in files, defined once: files are validated by it, the documentation is made from it."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from liftgate_hil.config.toml import Table, known_keys, number, show, text
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.stimuli.moments import Instant

LATEST = 1e6  # s


class Kind(Protocol):
    """Kind of the values that a key may have."""

    @property
    def allowed(self) -> str:
        """The allowed values in words."""

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Any:
        """Return the value as it is in memory; issues are noted."""


@dataclass(frozen=True)
class Number:
    """A number, converted to the unit in memory by `scale`."""

    low: float
    high: float
    unit: str = ""
    scale: float = 1.0

    @property
    def allowed(self) -> str:
        """The range with its unit."""
        return f"{self.low:g} to {self.high:g}{' ' + self.unit if self.unit else ''}"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float:
        """Return the number in the unit in memory; NaN and an issue if it is invalid."""
        return self.scale * number(issues, key, value, self.low, self.high, self.unit)


class Flag:
    """A boolean."""

    allowed = "true or false"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> bool:
        """Return the value; false and an issue if it is no boolean."""
        if not isinstance(value, bool):
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
        return value is True


@dataclass(frozen=True)
class Whole:
    """A whole number within [low, high]."""

    low: int
    high: int

    @property
    def allowed(self) -> str:
        """The range in words."""
        return f"a whole number of {self.low} to {self.high}"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> int:
        """Return the number; `low` and an issue if it is invalid."""
        found = int(value) if isinstance(value, float) and value.is_integer() else value
        if (
            isinstance(found, bool)
            or not isinstance(found, int)
            or not self.low <= found <= self.high
        ):
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return self.low
        return found


@dataclass(frozen=True)
class Choice:
    """Kind of value: one of several words."""

    words: Sequence[str]

    @property
    def allowed(self) -> str:
        """The list of the words."""
        return f"one of {', '.join(self.words)}"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> str:
        """Return the word; "" and an issue if it is none of them."""
        return text(issues, key, value, self.words)


@dataclass(frozen=True)
class Choices:
    """A list of which each item is one of several words."""

    values: Sequence[str]

    @property
    def allowed(self) -> str:
        """The list of the words."""
        return f"a list of {', '.join(self.values)}"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[str, ...]:
        """Return the items; an empty tuple and an issue if they are invalid."""
        if not isinstance(value, list) or any(each not in self.values for each in value):
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return ()
        return tuple(value)


@dataclass(frozen=True)
class Level:
    """0 or 1, or the word for it."""

    words: tuple[str, str] = ("low", "high")

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


@dataclass(frozen=True)
class Label:
    """A signal's value: a number in the database's unit, or a label of its value table."""

    allowed: str = "a number, or a label of the signal"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> float | str:
        """Return the number or the label; NaN and an issue if it is neither."""
        if isinstance(value, str) and value:
            return value
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if is_number and abs(value) <= sys.float_info.max:  # a whole number may be beyond it
            return float(value)
        issues.add(key, f"{show(value)}; allowed: {self.allowed}")
        issues.settle(key)
        return math.nan


@dataclass(frozen=True)
class Text:
    """Any text that is not empty; `called` says what it is."""

    called: str = "a text"

    @property
    def allowed(self) -> str:
        """A description of the text."""
        return self.called

    def read(self, issues: ConfigIssues, key: str, value: Any) -> str:
        """Return the text; "" and an issue if it is none."""
        if not isinstance(value, str) or not value.strip():
            issues.add(key, f"{show(value)}; allowed: {self.called}")
            return ""
        return value


@dataclass(frozen=True)
class Texts:
    """A list of texts, or a single text."""

    called: str

    @property
    def allowed(self) -> str:
        """A description of the texts."""
        return self.called

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[str, ...]:
        """Return the texts; an empty tuple and an issue if they are invalid."""
        given = [value] if isinstance(value, str) else value
        if not isinstance(given, list) or not all(isinstance(each, str) and each for each in given):
            issues.add(key, f"{show(value)}; allowed: {self.called}")
            return ()
        return tuple(given)


@dataclass(frozen=True)
class When:
    """A time or a condition."""

    allowed: str = f"0 to {LATEST:g} s, or a condition"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Instant:
        """Return the instant; an issue if it is neither a time nor a condition."""
        if isinstance(value, str) and value.strip():
            return Instant(math.nan, value, key=key, source=issues.source)
        if isinstance(value, bool) or not isinstance(value, int | float):
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return Instant()
        return Instant(number(issues, key, value, 0.0, LATEST, "s, or a condition"))


@dataclass(frozen=True)
class Raw:
    """Any value; its own reader validates it."""

    allowed: str

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Any:
        """Return the value as it is."""
        return value


REQUIRED = object()


@dataclass(frozen=True)
class Key:
    """A key of a table; `told` is its default in words if the value itself does not show it."""

    name: str
    kind: Kind
    meaning: str
    default: Any = REQUIRED
    told: str = ""

    @property
    def default_told(self) -> str:
        """The default in words."""
        if self.default is REQUIRED:
            return "required"
        if self.told or self.default is None or self.default == ():
            return self.told
        return f"{self.default:g}" if isinstance(self.default, float) else str(self.default)


def read_table(
    issues: ConfigIssues, prefix: str, given: Table, keys: Sequence[Key]
) -> dict[str, Any]:
    """Return the values of a table by its keys; issues are noted."""
    known_keys(issues, prefix, given, [key.name for key in keys])
    found: dict[str, Any] = {}
    for key in keys:
        dotted = f"{prefix}.{key.name}" if prefix else key.name
        if key.name in given:
            found[key.name] = key.kind.read(issues, dotted, given[key.name])
        elif key.default is REQUIRED:
            issues.add(dotted, f"missing; allowed: {key.kind.allowed}")
            found[key.name] = None
        else:
            found[key.name] = key.default
    return found


def keys_by_name(keys: Sequence[Key]) -> Mapping[str, Key]:
    """Return the keys by their names."""
    return {key.name: key for key in keys}
