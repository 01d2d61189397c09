"""Validate arguments of the API: each function returns the value, or raises ConfigError with what is allowed.

`toml` does the same for files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from liftgate_hil.config.described import value_of
from liftgate_hil.config.kinds import SEED, Number
from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigError


def number_of(name: str, value: object, low: float, high: float, unit: str) -> float:
    """Return a number within [low, high]. Raises ConfigError."""
    return float(value_of(name, value, Number(low, high, unit)))


def seed_of(value: object, name: str = "seed") -> int:
    """Return a seed. Raises ConfigError."""
    return int(value_of(name, value, SEED))


def numbers_of(name: str, values: object) -> dict[str, float]:
    """Return numbers by their names as a dict, empty for None. Raises ConfigError."""
    if values is None:
        return {}
    if not isinstance(values, Mapping) or not all(isinstance(each, str) for each in values):
        raise ConfigError(f"`{name}` {show(values)}: allowed: a mapping of names to numbers")
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
