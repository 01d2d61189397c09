"""Names of types, functions and locals in C."""

from __future__ import annotations

import math
import typing
from typing import Any

SCALARS: dict[Any, str] = {float: "double", int: "int64_t", bool: "bool"}
# Names in C by function and number of arguments, all floats.
BUILT_IN: dict[tuple[Any, int], str] = {
    (abs, 1): "fabs",
    (math.sqrt, 1): "sqrt",
    (math.exp, 1): "exp",
    (math.log, 1): "log",
    (math.expm1, 1): "expm1",
    (math.log1p, 1): "log1p",
    (math.sin, 1): "sin",
    (math.cos, 1): "cos",
    (math.copysign, 2): "copysign",
    (min, 2): "min_of",
    (max, 2): "max_of",
}
C_WORDS = """
    auto bool case char const default do double enum extern float goto inline int long register
    restrict short signed sizeof static struct switch typedef union unsigned void volatile
"""
# Names that a Python local may have and a C local may not.
RESERVED = {*C_WORDS.split(), *BUILT_IN.values()}


def is_struct(kind: Any) -> bool:
    """Return whether values of a type are structs in C."""
    return typing.get_origin(kind) is tuple or hasattr(kind, "_fields")


def fields_of(kind: Any) -> dict[str, Any]:
    """Return the types of a struct's members by name; a scalar has no members."""
    if typing.get_origin(kind) is tuple:
        return {f"item{k}": item for k, item in enumerate(typing.get_args(kind))}
    return typing.get_type_hints(kind) if is_struct(kind) else {}


def type_name(kind: Any) -> str:
    """Return a type's name in C."""
    if typing.get_origin(kind) is tuple:
        return "_".join(["Tuple", *map(type_name, typing.get_args(kind))])
    return SCALARS[kind] if kind in SCALARS else str(kind.__name__)


def c_name(name: str) -> str:
    """Return the name in C of a local or a member."""
    return f"{name}_" if name in RESERVED else name
