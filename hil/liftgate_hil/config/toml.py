"""Read TOML so that all issues of a file are reported at once, each with file, key, value and what is allowed."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeGuard

from liftgate_hil.config.files import read_bytes
from liftgate_hil.errors import ConfigError, ConfigIssues, allowed_names, nearest, with_unit

Table = dict[str, Any]

# Beyond these a file is no configuration; the time of Python's parser grows with the square of a key's length.
MOST_BYTES = 2_000_000
DEEPEST = 16  # nested tables and lists, and parts of a key
# What a file is by its suffix, and where that is taken. The suffixes are those of `database` and of the formats.
NO_TOML = (
    ("a CAN database", (".dbc", ".arxml", ".kcd", ".sym"), "a rig file names the database"),
    (
        "a recording",
        (".csv", ".parquet", ".mf4", ".mcap", ".log", ".blf", ".asc", ".trc"),
        "judge, plot, convert and replay take recordings",
    ),
    ("Python code", (".py",), "pytest runs tests in Python"),
)
_MOST_KEYS = 20  # unknown keys that are reported one by one
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(  # where a key may begin
    rf"(?:^[ \t]*+\[{{0,2}}+|[{{,])[ \t]*+{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST}}}", re.MULTILINE
)


def read_text(path: Path) -> str:
    """Return the text of a TOML file, without a byte order mark. Raises ConfigError."""
    raw = read_bytes(path, MOST_BYTES)
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from error


def read_toml(path: Path) -> Table:
    """Return the parsed content of a TOML file. Raises ConfigError if it cannot be read or is not TOML."""
    suffix = path.suffix.lower()
    for what, suffixes, hint in NO_TOML:
        if suffix in suffixes:
            raise ConfigError(f"{path}: {what}; allowed: a TOML file; {hint}")
    written = read_text(path)
    too_deep = f"{path}: keys or tables deeper than {DEEPEST}; allowed: up to {DEEPEST}"
    if _LONG_KEY.search(written):
        raise ConfigError(too_deep)
    try:
        content = tomllib.loads(written)
    except ValueError as error:  # TOMLDecodeError is a ValueError
        raise ConfigError(f"{path}: not valid TOML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise ConfigError(too_deep) from error
    if _is_deeper(content, DEEPEST):
        raise ConfigError(too_deep)
    return content


def copied_table(content: Any) -> Any:
    """Return a deep copy of a file's parsed content: tables and lists are copied."""
    if isinstance(content, dict):
        return {name: copied_table(each) for name, each in content.items()}
    return list(map(copied_table, content)) if isinstance(content, list) else content


def value_at(content: Any, path: Iterable[str]) -> Any:
    """Return the value at a path of keys in nested tables; None if there is none."""
    for name in path:
        content = content.get(name) if isinstance(content, Mapping) else None
    return content


def _is_deeper(content: Table, levels: int) -> bool:
    """Whether tables and lists are nested more than `levels` deep."""
    inner: list[Any] = [content]
    for _ in range(levels):
        inner = [
            each
            for holder in inner
            for each in (holder.values() if isinstance(holder, dict) else holder)
            if isinstance(each, dict | list)
        ]
        if not inner:
            return False
    return True


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a number; a boolean is none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_whole(value: object, low: float = -math.inf, high: float = math.inf) -> TypeGuard[int]:
    """Whether a value is an integer within [low, high]; a boolean or a float such as 2.0 is none."""
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def number(
    issues: ConfigIssues, key: str, value: object, low: float, high: float, unit: str = "", least: float = 0.0
) -> float:
    """Return `value` as a float; NaN and an issue unless a number in [low, high], not between 0 and `least`."""
    begin = f"0, or {least:g}" if least else f"{low:g}"
    allowed = with_unit(f"{begin} to {high:g}", unit)
    if not is_number(value):
        issues.add(key, f"{show(value)} is not a number; allowed: {allowed}")
        return math.nan
    # True for NaN, too; whole numbers may be too large for a float.
    if not low <= value <= high or 0.0 < value < least:
        issues.add(key, f"{show(value)} is out of range; allowed: {allowed}")
        return math.nan
    return float(value)


def text(issues: ConfigIssues, key: str, value: object, allowed: Iterable[str] = ()) -> str:
    """Return `value` as a string, one of `allowed` if those are given; "" and an issue if it is invalid."""
    choices = list(allowed)
    if not isinstance(value, str) or not value or (choices and value not in choices):
        what = f"one of {', '.join(choices)}" if choices else "a text"
        issues.add(key, f"{show(value)}; allowed: {what}")
        return ""
    return value


def table(issues: ConfigIssues, key: str, value: object) -> Table:
    """Return `value` as a table; an empty one and an issue if it is no table."""
    if not isinstance(value, dict):
        issues.add(key, f"{show(value)}; allowed: a table")
        return {}
    return value


def known_keys(
    issues: ConfigIssues, prefix: str, given: Mapping[str, Any], known: Iterable[str], deeper: Iterable[str] = ()
) -> None:
    """Note an issue for each unknown key; beyond _MOST_KEYS unknown keys, only their number.

    Of `deeper`, the dotted keys of the tables in this one, those that may be meant are proposed.
    """
    names = list(known)
    start = f"{prefix}." if prefix else ""
    unknown = [key for key in given if key not in names]
    for key in unknown[:_MOST_KEYS]:
        value = "" if isinstance(given[key], dict | list) else f"{show(given[key])}: "
        short = shortened(key)
        meant = nearest(f".{key}", deeper)
        proposal = f"did you mean {' or '.join(meant)}? " if meant else ""
        issues.add(f"{start}{short}", f"{value}unknown key; {proposal}allowed: {allowed_names(short, names)}")
    if len(unknown) > _MOST_KEYS:
        issues.add(
            f"{start}{shortened(unknown[_MOST_KEYS])}", f"and {len(unknown) - _MOST_KEYS - 1} more: unknown keys"
        )


def show(value: object) -> str:
    """Return a value as text for a message: short, on one line."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write out thousands of digits
        return "a number of thousands of digits"
    return shortened(text)


def shortened(text: str) -> str:
    """Return a text, shortened to at most 60 characters."""
    return text if len(text) <= 60 else text[:57] + "..."


# Some keys of each kind, which no other kind has.
MARKS = {
    "rig": ("dbc", "inputs", "outputs"),
    "vehicle": ("drives", "motor", "gear", "spindle"),
    "scenario": ("expect", "request", "obstacle", "profile", "fault", "precondition"),
    "campaign": ("part",),
}
_SHARED = {"description"}  # keys of several kinds


def check_kind(path: Path, content: Table, kind: str, known: Collection[str]) -> None:
    """Raise ConfigError where a file has no key of `known`, its kind, but keys of another kind of file."""
    if not content.keys().isdisjoint({*known} - _SHARED):
        return
    for other, marks in MARKS.items():
        if other != kind and not content.keys().isdisjoint(marks):
            raise ConfigError(
                f"{path}: a {other} file, not a {kind}; allowed: a {kind} with {', '.join(MARKS[kind])}, …"
            )
