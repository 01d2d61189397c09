"""Validate arguments of the API: each function returns the value, or raises ConfigError with what is allowed.

`toml` does the same for files.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from pathlib import Path

from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigError

_SEEDS = 2**32
_UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_SIZE = re.compile(r"(\d+(?:\.\d+)?) ?((?:[KMGT]?B)?)", re.IGNORECASE | re.ASCII)


def number_of(name: str, value: object, low: float, high: float, unit: str) -> float:
    """Return a number within [low, high]. Raises ConfigError."""
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if not is_number or not low <= value <= high:  # type: ignore[operator]  # Real does not compare with float
        raise ConfigError(f"`{name}` {show(value)}: allowed: {low:g} to {high:g} {unit}".rstrip())
    return float(value)  # type: ignore[arg-type]


def time_of(name: str, value: object) -> float:
    """Return a time [s] above 0, up to 1e9. Raises ConfigError."""
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if not is_number or not 0.0 < value <= 1e9:  # type: ignore[operator]
        raise ConfigError(f"`{name}` {show(value)}: allowed: above 0, up to 1e+09 s")
    return float(value)  # type: ignore[arg-type]


def whole_of(name: str, value: object, least: int) -> int:
    """Return a whole number of at least `least`. Raises ConfigError."""
    if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < least:
        raise ConfigError(f"`{name}` {show(value)}: allowed: a whole number from {least:,} on")
    return int(value)


def size_of(name: str, value: object) -> int | None:
    """Return a size in bytes from a number or a text with a unit ("500MB"); None for None. Raises ConfigError."""
    match = _SIZE.fullmatch(value) if isinstance(value, str) else None
    if match:
        return round(float(match[1]) * _UNITS[match[2].upper()])
    if value is None or (isinstance(value, Integral) and not isinstance(value, bool)):
        return None if value is None else int(value)
    raise ConfigError(f"`{name}` {show(value)}: allowed: bytes, or a size such as 500MB, 2GB")


def seed_of(value: object, name: str = "seed") -> int:
    """Return a seed, 0 to 2^32 - 1. Raises ConfigError."""
    if isinstance(value, bool) or not isinstance(value, Integral) or not 0 <= int(value) < _SEEDS:
        raise ConfigError(f"`{name}` {show(value)}: allowed: a whole number of 0 to {_SEEDS - 1}")
    return int(value)


def paths_of(name: str, values: object) -> tuple[str, ...]:
    """Return a path or a list of paths as a tuple of texts. Raises ConfigError."""
    if isinstance(values, str | Path):
        return (str(values),)
    if not isinstance(values, Sequence) or not all(isinstance(each, str | Path) for each in values):
        raise ConfigError(f"`{name}` {show(values)}: allowed: a path, or a list of them")
    return tuple(map(str, values))


def numbers_of(name: str, values: object) -> dict[str, float]:
    """Return numbers by their names as a dict, empty for None. Raises ConfigError."""
    if values is None:
        return {}
    if not isinstance(values, Mapping) or not all(isinstance(each, str) for each in values):
        raise ConfigError(f"`{name}` {show(values)}: allowed: numbers by their names")
    return dict(values)


def text_or_none(name: str, value: object) -> str | None:
    """Return a text or None. Raises ConfigError."""
    if value is not None and not isinstance(value, str):
        raise ConfigError(f"`{name}` {show(value)}: allowed: a text")
    return value


def texts_of(name: str, values: object) -> tuple[str, ...]:
    """Return a list of texts as a tuple. Raises ConfigError.

    A single text is refused, as it would be split into letters.
    """
    is_list = isinstance(values, Sequence) and not isinstance(values, str)
    if not is_list or not all(isinstance(each, str) for each in values):  # type: ignore[attr-defined]
        raise ConfigError(f"`{name}` {show(values)}: allowed: a list of texts")
    return tuple(values)  # type: ignore[arg-type]
