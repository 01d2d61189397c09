"""Translation of functions in the plant's subset of Python to readable C99, as a C programmer would write it.

    NamedTuple, tuple       struct; as an argument `const T *`, as a result by value
    float, int, bool        double, int64_t, bool
    function                static function, named module_function
    module constant         its value

Statements: assignment, if, for over range, return, break. Functions may call each other, NamedTuples, and the
functions in `names.BUILT_IN`. All else is refused with its file and line.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable
from typing import Any

from tools.c_translator.errors import NotInSubsetError, Refused
from tools.c_translator.names import SCALARS, c_name, fields_of, is_struct, type_name
from tools.c_translator.statements import Function
from tools.c_translator.values import POSTFIX, UNARY, Place, Value

__all__ = ["NotInSubsetError", "translate"]

# Of two equal or unordered values Python's min and max return the first, unlike fmin and fmax.
HEADER = """\
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

static inline double min_of(double a, double b) { return b < a ? b : a; }
static inline double max_of(double a, double b) { return b > a ? b : a; }
"""
WIDTH = 100


def translate(entry: Callable[..., Any]) -> str:
    """Return the C99 source of a function and of all functions that it calls."""
    it = Translation()
    it.function(entry)
    parts = [HEADER, *it.structs.values(), *it.constants.values(), *it.functions.values()]
    return "".join(f"{line}\n" for long in "\n".join(parts).splitlines() for line in wrapped(long))


def wrapped(line: str) -> list[str]:
    """Return a line of C, broken into lines of at most WIDTH columns where possible."""
    if len(line) <= WIDTH:
        return [line]
    indent = " " * (len(line) - len(line.lstrip()) + 8)
    return textwrap.wrap(line, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


class Translation:
    """Definitions in C that are reachable so far, each written at its first use, callees before callers."""

    def __init__(self) -> None:
        self.structs: dict[str, str] = {}
        self.constants: dict[str, str] = {}
        self.functions: dict[str, str] = {}
        self._known: dict[str, Any] = {}

    def _is_new(self, name: str, thing: Any) -> bool:
        new = name not in self._known
        if self._known.setdefault(name, thing) != thing:
            raise Refused(f"two different things are called {name}")
        return new

    def type(self, kind: Any) -> str:
        """Return a type's name in C, and define its struct at the first use. Raises Refused."""
        if kind not in SCALARS and not is_struct(kind):
            raise Refused(f"values of type {kind}")
        name = type_name(kind)
        if is_struct(kind) and self._is_new(name, kind):
            members = [f"    {self.type(t)} {c_name(n)};\n" for n, t in fields_of(kind).items()]
            self.structs[name] = f"typedef struct {{\n{''.join(members)}}} {name};\n"
        return name

    def constant(self, value: Any, name: str) -> Value:
        """Return a constant's value in C; a NamedTuple becomes a C constant called `name`. Raises Refused."""
        if isinstance(value, bool):
            return Value(repr(value).lower(), bool)
        if isinstance(value, int | float) and math.isfinite(value):
            return Value(repr(value), type(value), UNARY if repr(value)[0] == "-" else POSTFIX)
        if not is_struct(type(value)):
            raise Refused(f"a constant of type {type(value).__name__}: {value!r}")
        kind = self.type(type(value))
        if self._is_new(name, value):
            members = ", ".join(self.constant(member, "").text for member in value)
            self.constants[name] = f"static const {kind} {name} = {{{members}}};\n"
        return Value(name, type(value), place=Place.CONSTANT)

    def function(self, function: Callable[..., Any]) -> str:
        """Return a function's name in C, and translate it at the first use. Raises Refused."""
        name = f"{function.__module__.rpartition('.')[2]}_{function.__name__}"
        if self._is_new(name, function):
            self.functions[name] = Function(self, function, name).definition()
        elif name not in self.functions:
            raise Refused(f"a recursive call of {function.__name__}")
        return name
