"""Sources that an entry point's machine code depends on, and a hash over all of them.

They are found from the entry on through the globals that its bytecode names: compilable functions and the modules
that hold them, types that annotations name or that are called as constructors, constants. Only the functions found
here are compiled with the entry, so that none can be in its machine code and not in its hash.
"""

from __future__ import annotations

import enum
import functools
import hashlib
import re
import sys
import typing
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from liftgate_compiler.calls import System

_NAME = re.compile(r"[^\W\d]\w*")


class Sources:
    """Registered functions that `entry` reaches, and what the hash covers: files, code, types, constants.

    The hash covers the text of each source file, the code as it was loaded (the file may have been edited since),
    the fields of each type, and the value of each constant. It contains no paths: it is the same wherever a
    package is installed.
    """

    def __init__(self, entry: Callable[..., Any], registered: Iterable[Callable[..., Any]]) -> None:
        self.functions: set[Callable[..., Any]] = set()
        self._registered = set(registered)
        self._packages = {_package_of(each) for each in (entry, *self._registered)}
        self._parts: set[str] = set()
        self._seen: set[Any] = set()
        self._add_function(entry)

    def digest(self, *more: str) -> str:
        """Return the hash over all sources, and over the texts `more`."""
        return _hash_of("\0".join((*sorted(self._parts), *more)).encode())[:16]

    def _add_function(self, function: Any) -> None:
        """Add a compilable function: its file, code, defaults, and all objects that it names."""
        if function in self.functions:
            return
        self.functions.add(function)
        self._add_file(function.__module__, function.__code__.co_filename)
        name = f"{function.__module__}.{function.__qualname__}"
        codes = list(_codes_in(function.__code__))
        names = {each for code in codes for each in code.co_names}
        for code in codes:
            self._parts.add(f"code {name} {_text_of_code(code)}")
        self._add_annotations(function.__annotations__, function.__globals__)
        self._add_names(names, function.__globals__)
        cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        for variable, cell in cells:
            self._add(f"{name}.{variable}", cell.cell_contents, names)
        for place, default in enumerate(function.__defaults__ or ()):
            self._add(f"{name}({place})", default, names)

    def _add_names(self, names: Iterable[str], scope: dict[str, Any]) -> None:
        """Add the objects with these names in a module's or function's globals, `scope`."""
        for name in set(names) & scope.keys():
            self._add(f"{scope.get('__name__')}.{name}", scope[name], names)

    def _add(self, name: str, value: Any, names: Iterable[str]) -> None:
        """Add an object that code names; of a module, the objects with `names` in it."""
        if isinstance(value, FunctionType):
            if value in self._registered:
                self._add_function(value)
        elif isinstance(value, ModuleType):
            visit = value, frozenset(names)
            if visit not in self._seen and value.__name__.partition(".")[0] in self._packages:
                self._seen.add(visit)
                self._add_names(names, vars(value))
        elif isinstance(value, type):
            self._add_type(value)
        else:
            if isinstance(value, tuple):
                self._add_type(type(value))
            self._parts.add(f"value {name} {_text_of(value)}")

    def _add_type(self, kind: type) -> None:
        """Add a type of this program's packages: its file, its fields, and its bases."""
        if kind in self._seen or _package_of(kind) not in self._packages:
            return
        self._seen.add(kind)
        module = sys.modules[kind.__module__]
        self._add_file(kind.__module__, getattr(module, "__file__", None))
        annotations = getattr(kind, "__annotations__", {})
        self._parts.add(f"type {kind.__module__}.{kind.__qualname__} {annotations}")
        self._add_annotations(annotations, vars(module))
        for base in kind.__mro__[1:]:
            self._add_type(base)

    def _add_annotations(self, annotations: dict[str, Any], scope: dict[str, Any]) -> None:
        """Add the types in annotations; those given as text are looked up in `scope`."""
        names: set[str] = set()
        for annotation in annotations.values():
            for each in _flat(annotation):
                if isinstance(each, type):
                    self._add_type(each)
                else:
                    names.update(_NAME.findall(str(each)))
        self._add_names(names, scope)

    def _add_file(self, module: str, file: str | None) -> None:
        """Add the hash over a module's file."""
        self._parts.add(f"file {module} {_hash_of_file(file)}")


def _package_of(thing: Any) -> str:
    """Return the name of the top-level package of a function or type."""
    return str(thing.__module__).partition(".")[0]


def _hash_of(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@functools.cache
def _hash_of_file(file: str | None) -> str:
    """Return the hash over a file's content; "": it cannot be read."""
    try:
        return _hash_of(Path(file or "").read_bytes())
    except OSError:  # not from a file, as code typed at a prompt: its bytecode is hashed anyway
        return ""


def _codes_in(code: CodeType) -> Iterator[CodeType]:
    """Yield the code object of a function and those nested in it."""
    yield code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from _codes_in(each)


def _text_of_code(code: CodeType) -> str:
    """Return a text, the same in every process, for a code object without those nested in it."""
    constants = tuple(each for each in code.co_consts if not isinstance(each, CodeType))
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    return f"{code.co_name} {code.co_code.hex()} {names} {_text_of(constants)}"


def _flat(annotation: Any) -> Iterator[Any]:
    """Yield all types, and texts with names of types, that occur in an annotation."""
    if isinstance(annotation, typing.ForwardRef):
        yield annotation.__forward_arg__
    elif typing.get_args(annotation):
        for each in typing.get_args(annotation):
            yield from _flat(each)
    else:
        yield annotation


def _text_of(value: Any) -> str:
    """Return a text, the same in every process, for a constant in compiled code."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype!r} {value.shape} {_hash_of(value.tobytes())}"
    if isinstance(value, np.generic):
        return f"{value.dtype!r} {value.tobytes().hex()}"
    if isinstance(value, tuple):
        return f"{type(value).__qualname__}({', '.join(map(_text_of, value))})"
    if isinstance(value, frozenset):
        return f"{{{', '.join(sorted(map(_text_of, value)))}}}"
    if isinstance(value, int | float | complex | str | bytes | enum.Enum | np.dtype | System | None):
        return f"{type(value).__qualname__} {value!r}"
    return type(value).__qualname__  # not a constant for numba
