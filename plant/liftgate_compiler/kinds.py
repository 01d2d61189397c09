"""Kinds (types) of arguments and results of machine code: numbers, arrays, tuples of these."""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple, TypeAlias

import numpy as np


class NumberKind(NamedTuple):
    """Kind of a number: "f" float, "i" int of 64 bits, "b" bool."""

    letter: str


class Nothing(NamedTuple):
    """Kind of the value None."""


class Array(NamedTuple):
    """Kind of an array; `layout` is "C", "F" or "A" (any)."""

    dtype: np.dtype[Any]
    ndim: int
    layout: str
    is_writable: bool


class Tuple(NamedTuple):
    """Kind of a tuple; `type` is the class of a NamedTuple, None for a plain tuple."""

    type: type[Any] | None
    parts: tuple[Kind, ...]


Kind: TypeAlias = NumberKind | Nothing | Array | Tuple


def kind_of(value: Any) -> Kind:
    """Return the kind of a value. Raises TypeError for values that machine code does not accept."""
    if isinstance(value, bool | np.bool_):
        return NumberKind("b")
    if isinstance(value, int | np.integer):
        return NumberKind("i")
    if isinstance(value, float):  # also numpy's
        return NumberKind("f")
    if value is None:
        return Nothing()
    if isinstance(value, np.ndarray):
        flags = value.flags
        layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return Array(value.dtype, value.ndim, layout, flags.writeable)
    if isinstance(value, tuple):
        named = type(value) if hasattr(value, "_fields") else None
        return Tuple(named, tuple(kind_of(each) for each in value))
    raise TypeError(
        f"machine code was given {type(value).__name__}; allowed: int, float, bool, None, arrays, tuples of them"
    )


def text_of(kind: Kind) -> str:
    """Return a text for a kind that is the same in every process."""
    if isinstance(kind, Tuple):
        # The fields' names are included: for a type that no annotation names, nothing else tells their order.
        names = getattr(kind.type, "_fields", ("",) * len(kind.parts))
        parts = (f"{name} {text_of(each)}" for name, each in zip(names, kind.parts, strict=True))
        return f"{_name_of(kind.type)}({','.join(parts)})"
    if isinstance(kind, Array):
        return f"{kind.dtype!r}[{kind.ndim}{kind.layout}{'w' if kind.is_writable else 'r'}]"
    return kind.letter if isinstance(kind, NumberKind) else "n"


def _name_of(named: type[Any] | None) -> str:
    """Return module and name of a NamedTuple's class as text; "": a plain tuple."""
    return "" if named is None else f"{named.__module__}:{named.__qualname__}"


def plain(kind: Kind) -> Any:
    """Return the kind of a result as a value that JSON can store; of an array, only that it is one.

    Arrays in a result are those of the arguments, so that their kinds are known.
    """
    if isinstance(kind, Tuple):
        return [_name_of(kind.type), [plain(each) for each in kind.parts]]
    return "a" if isinstance(kind, Array) else text_of(kind)


def from_plain(value: Any) -> Kind:
    """Return the kind that `plain` has converted to `value`.

    Raises LookupError, ImportError, AttributeError where a type is not found.
    """
    if isinstance(value, list):
        module, _, name = value[0].partition(":")
        named = importlib.import_module(module) if module else None
        for part in name.split(".") if module else ():
            named = getattr(named, part)
        return Tuple(named, tuple(from_plain(each) for each in value[1]))  # type: ignore[arg-type]
    if value == "a":
        return Array(np.dtype("f8"), 0, "A", False)
    return Nothing() if value == "n" else NumberKind(value)
