"""Distinct values for every field of a NamedTuple."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from typing import Any, get_type_hints


def distinct(kind: type[Any], numbers: Iterator[float] | None = None) -> Any:
    """A value of this type whose numbers, nested ones too, all differ: the next of `numbers`, or 1.5, 2.5, …"""
    numbers = count(1.5) if numbers is None else numbers
    hints = get_type_hints(kind)
    return kind(
        **{
            name: distinct(hints[name], numbers) if hasattr(hints[name], "_fields") else next(numbers)
            for name in kind._fields
        }
    )
