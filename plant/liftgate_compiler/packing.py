"""Packing of arguments into memory for machine code, and unpacking of its results.

A number takes 8 bytes, an array the address of its Python object: machine code reads where its data are, and
checks whether it is of the kind that the code was made for. The first two slots hold the addresses of the array
types that it accepts. The code that takes a tuple apart, or builds one, is Python generated for its kind.
"""

from __future__ import annotations

import ctypes
import struct
import sys
from _ctypes import PyObj_FromPtr
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from liftgate_compiler.kinds import Array, Kind, Nothing, Tuple

# Offsets [bytes] in PyArrayObject_fields (numpy/ndarraytypes.h); `is_as_expected` checks them.
TYPE, DATA, NDIM, SHAPE, STRIDES, DTYPE, FLAGS = 8, 16, 24, 32, 40, 56, 64
# Offsets [bytes] in PyArray_Descr of numpy 2.
TYPE_NUMBER, ITEM_SIZE = 28, 40
BYTE_ORDER = 26  # a character
C_CONTIGUOUS, F_CONTIGUOUS, ALIGNED, WRITABLE = 0x1, 0x2, 0x100, 0x400

SWAPPED = "><"[sys.byteorder == "big"]  # in a dtype: the byte order that is not native

ACCEPTED = (np.ndarray, np.recarray)  # types of arrays that machine code accepts
HEAD = len(ACCEPTED)  # slots before the arguments

_FORMATS = {"f": "d", "i": "q", "b": "?7x"}


def is_as_expected() -> bool:
    """Whether numpy's memory layout of arrays is as assumed in this module."""
    for array in (
        np.arange(6, dtype=np.int32).reshape(2, 3),
        np.zeros(3).view(np.recarray),
        np.zeros(3, SWAPPED + "f8"),
    ):
        base = id(array)
        kind = _word(base + DTYPE)
        if (
            _word(base + TYPE) != id(type(array))
            or _word(base + DATA) != array.ctypes.data
            or ctypes.c_int.from_address(base + NDIM).value != array.ndim
            or _word(_word(base + SHAPE)) != array.shape[0]
            or _word(_word(base + STRIDES)) != array.strides[0]
            or kind != id(array.dtype)
            or ctypes.c_int.from_address(base + FLAGS).value & 0x7 != array.flags.num & 0x7
            or ctypes.c_int.from_address(kind + TYPE_NUMBER).value != array.dtype.num
            or _word(kind + ITEM_SIZE) != array.dtype.itemsize
            or ctypes.c_char.from_address(kind + BYTE_ORDER).value.decode() != array.dtype.byteorder
        ):
            return False
    return True


def _word(address: int) -> int:
    """Return the 64-bit integer at an address in memory."""
    return ctypes.c_int64.from_address(address).value


def packer(kinds: Sequence[Kind]) -> Callable[[tuple[Any, ...]], bytes | None]:
    """Return a function that packs arguments of these kinds into bytes, and returns None for other arguments."""
    code = _Packing()
    arguments = "".join(f"{code.add_argument(each)}, " for each in kinds)
    lines = [
        "def pack(arguments):",
        "    try:",
        f"        ({arguments}) = arguments",
        *(f"        {each}" for each in code.steps),
        *([f"        if {' or '.join(code.checks)}: return None"] if code.checks else []),
        f"        return write({', '.join(['HEAD', *code.values])})",
        "    except (TypeError, ValueError, AttributeError, error): return None",
    ]
    head = struct.pack(f"<{HEAD}q", *(id(each) for each in ACCEPTED))
    scope = {
        "write": struct.Struct(f"<{len(head)}s" + "".join(code.formats)).pack,
        "HEAD": head,
        "error": struct.error,
        **code.known,
    }
    exec("\n".join(lines), scope)
    made: Callable[[tuple[Any, ...]], bytes | None] = scope["pack"]
    return made


class _Packing:
    """Source text of a packing function under construction, in the order of the memory slots.

    A tuple is taken apart only where its type is the expected one: the items of any other iterable might be gone
    before machine code reads them.
    """

    def __init__(self) -> None:
        self.values: list[str] = []
        self.formats: list[str] = []
        self.steps: list[str] = []  # statements that take tuples apart
        self.checks: list[str] = []  # conditions under which a value is of another kind
        # Not `array.dtype`, which a record array looks up in Python.
        self.known: dict[str, Any] = {"BOOLS": (bool, np.bool_), "dtype_of": np.ndarray.dtype.__get__}
        self._names = 0

    def add_argument(self, kind: Kind) -> str:
        """Add an argument of a kind to the packing function; return its variable's name.

        This adds the argument's checks, its values and their format to the function.
        """
        name = f"v{self._names}"
        self._names += 1
        if isinstance(kind, Tuple):
            self._take_apart(name, kind)
        elif isinstance(kind, Nothing):
            self.checks.append(f"{name} is not None")
        elif isinstance(kind, Array):
            self.values.append(f"id({name})")
            self.formats.append("q")
            if kind.dtype.names is not None:  # machine code checks the types of numbers only
                dtype = self._constant(kind.dtype)
                self.checks.append(f"(dtype_of({name}) is not {dtype} and dtype_of({name}) != {dtype})")
        else:
            self.values.append(name)
            self.formats.append(_FORMATS[kind.letter])
            if kind.letter == "b":  # struct would convert any object to a bool
                self.checks.append(f"type({name}) not in BOOLS")
        return name

    def _take_apart(self, name: str, kind: Tuple) -> None:
        """Add the type check and the parts of the tuple in the variable `name`."""
        self.steps.append(f"if type({name}) is not {self._constant(kind.type or tuple)}: return None")
        place = len(self.steps)
        self.steps.append("")  # placeholder: this step goes before those of its parts
        parts = "".join(f"{self.add_argument(each)}, " for each in kind.parts)
        self.steps[place] = f"({parts}) = {name}"

    def _constant(self, value: Any) -> str:
        """Make an object available to the packing function; return its variable's name."""
        name = f"K{len(self.known)}"
        self.known[name] = value
        return name


def unpacker(kind: Kind) -> tuple[int, Callable[[bytes], Any]]:
    """Return the size [bytes] of a result of a kind, and a function that builds it from the bytes."""
    formats: list[str] = []
    scope: dict[str, Any] = {"object": PyObj_FromPtr, "new": tuple.__new__}

    def expression(part: Kind) -> str:
        if isinstance(part, Nothing):
            return "None"
        if isinstance(part, Tuple):
            items = "".join(f"{expression(each)}, " for each in part.parts)
            if part.type is None:
                return f"({items})"
            name = f"T{len(scope)}"
            scope[name] = part.type
            return f"new({name}, ({items}))"
        formats.append("q" if isinstance(part, Array) else _FORMATS[part.letter])
        name = f"r{len(formats) - 1}"
        return f"object({name})" if isinstance(part, Array) else name

    made = expression(kind)
    names = "".join(f"r{place}, " for place in range(len(formats)))
    source = f"def unpack(content):\n    ({names}) = read(content)\n    return {made}"
    form = struct.Struct("<" + "".join(formats))
    scope["read"] = form.unpack
    exec(source, scope)
    return form.size, scope["unpack"]
