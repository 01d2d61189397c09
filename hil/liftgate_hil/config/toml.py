"""Reading TOML so that all faults of a file come out at once, each with file, key, value and what is allowed."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from liftgate_hil.errors import ConfigError
from liftgate_hil.issues import ConfigIssues

Table = dict[str, Any]


def read_toml(path: Path) -> Table:
    """The file's content. Raises ConfigError where it cannot be read or is not TOML."""
    try:
        with path.open("rb") as stream:
            return tomllib.load(stream)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # TOMLDecodeError and UnicodeDecodeError are such
        raise ConfigError(f"{path}: not valid TOML: {' '.join(str(error).split())}") from error


def number(
    issues: ConfigIssues, key: str, value: object, low: float, high: float, unit: str = ""
) -> float:
    """`value` as a float within [low, high]; a fault and NaN where it is not."""
    allowed = f"{low:g} to {high:g}{' ' + unit if unit else ''}"
    if isinstance(value, bool) or not isinstance(value, int | float):
        issues.add(key, f"{show(value)} is not a number; allowed: {allowed}")
        return math.nan
    if not low <= value <= high:  # NaN is not; whole numbers may be too large for a float
        issues.add(key, f"{show(value)} is out of range; allowed: {allowed}")
        return math.nan
    return float(value)


def text(issues: ConfigIssues, key: str, value: object, allowed: Iterable[str] = ()) -> str:
    """`value` as a string, one of `allowed` where that is given; a fault and "" where it is not."""
    choices = list(allowed)
    if not isinstance(value, str) or not value or (choices and value not in choices):
        said = f"one of {', '.join(choices)}" if choices else "a text"
        issues.add(key, f"{show(value)}; allowed: {said}")
        return ""
    return value


def table(issues: ConfigIssues, key: str, value: object) -> Table:
    """`value` as a table; a fault and an empty one where it is not."""
    if not isinstance(value, dict):
        issues.add(key, f"{show(value)}; allowed: a table")
        return {}
    return value


def known_keys(
    issues: ConfigIssues, prefix: str, given: Mapping[str, Any], known: Iterable[str]
) -> None:
    """A fault for each key that does not exist."""
    names = list(known)
    for key, value in given.items():
        if key not in names:
            dotted = f"{prefix}.{key}" if prefix else key
            issues.add(dotted, f"{show(value)}: unknown key; allowed: {', '.join(names)}")


def show(value: object) -> str:
    """A value as it may stand in a message: short, on one line."""
    try:
        said = repr(value)
    except ValueError:  # Python refuses to write out thousands of digits
        return "a number of thousands of digits"
    return said if len(said) <= 60 else said[:57] + "..."
