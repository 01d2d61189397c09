"""Operations on all numbers of a NamedTuple, or on bytes of text, for code that is compiled."""

from __future__ import annotations

import math
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T", bound=tuple[Any, ...])


def fill(target: Any, at: int, numbers: tuple[float, ...]) -> None:
    """Write a NamedTuple of floats into an array (n,) from index `at` on.

    Machine code does one store after the other; a loop over a tuple would look each value up in a jump table.
    """
    target[at : at + len(numbers)] = numbers


def picked(source: Any, places: T) -> T:
    """Return the values of an array (n,) at the indices `places`, in a NamedTuple of the type of `places`."""
    kind: Any = type(places)
    return kind(*(source[place] for place in places))  # type: ignore[no-any-return]


def unflattened(row: Any, like: T) -> T:
    """Return a (nested) NamedTuple of floats, built from an array (n,) of all its numbers in order.

    `like` determines the type; its numbers do not matter.
    """
    numbers = iter(row.tolist())

    def made(part: Any) -> Any:
        if isinstance(part, tuple):
            kind: Any = type(part)
            return kind(*map(made, part))
        return next(numbers)

    return made(like)  # type: ignore[no-any-return]


def with_item(numbers: T, place: int, value: float) -> T:
    """Return a NamedTuple of floats with another value at one index."""
    kind: Any = type(numbers)
    return kind(  # type: ignore[no-any-return]
        *(value if at == place else each for at, each in enumerate(numbers))
    )


def overlay(upper: T, lower: T) -> T:
    """Return a NamedTuple of floats: the values of `upper`, and where these are NaN those of `lower`."""
    kind: Any = type(lower)
    return kind(  # type: ignore[no-any-return]
        *(below if math.isnan(above) else above for above, below in zip(upper, lower, strict=True))
    )


def all_finite(numbers: tuple[float, ...]) -> bool:
    """Whether a NamedTuple of floats contains neither infinity nor NaN."""
    return all(math.isfinite(number) for number in numbers)


ROOM = 32  # bytes that machine code copies at once


def put_text(target: NDArray[np.uint8], at: int, source: NDArray[np.uint8], start: int, length: int) -> None:
    """Copy `length` bytes of `source` (m,) from `start` on to `target` (n,) from `at` on.

    The source may lie before the target in the same array. Of the target's ROOM bytes from `at` on, those behind
    the copied ones may hold anything afterwards.
    """
    target[at : at + length] = source[start : start + length]
