"""Validate arguments of the API: each function returns the value, or raises ConfigError with what is allowed.

`toml` does the same for files.
"""

from __future__ import annotations

from liftgate_hil.config.described import value_of
from liftgate_hil.config.kinds import SEED, Number


def number_of(name: str, value: object, low: float, high: float, unit: str) -> float:
    """Return a number within [low, high]. Raises ConfigError."""
    return float(value_of(name, value, Number(low, high, unit)))


def seed_of(value: object, name: str = "seed") -> int:
    """Return a seed. Raises ConfigError."""
    return int(value_of(name, value, SEED))
