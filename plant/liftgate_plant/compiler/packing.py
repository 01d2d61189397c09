"""Arguments into the memory that machine code reads, and results out of what it wrote.

A number takes 8 bytes, an array the address of its Python object: machine code reads where its data are, and looks
whether it is of the kind that the code was made for. Two addresses go first, those of the types of arrays that it
accepts. What takes a tuple apart, and puts one together, is Python generated for its kind.
"""

from __future__ import annotations

import ctypes
import struct
from _ctypes import PyObj_FromPtr
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from liftgate_plant.compiler.kinds import Array, Kind, Nothing, Tuple

# Of PyArrayObject_fields (numpy/ndarraytypes.h), in bytes from the object's address; `is_as_expected` looks.
TYPE, DATA, NDIM, SHAPE, STRIDES, DTYPE, FLAGS = 8, 16, 24, 32, 40, 56, 64
# Of PyArray_Descr of numpy 2.
TYPE_NUMBER, ITEM_SIZE = 28, 40
BYTE_ORDER = 26
C_CONTIGUOUS, F_CONTIGUOUS, ALIGNED, WRITABLE = 0x1, 0x2, 0x100, 0x400

ACCEPTED = (np.ndarray, np.recarray)  # types of arrays
HEAD = len(ACCEPTED)  # slots before the arguments

_FORMATS = {"f": "d", "i": "q", "b": "?7x"}


def is_as_expected() -> bool:
    """Whether numpy lays arrays out as is taken for granted here."""
    for array in (np.arange(6, dtype=np.int32).reshape(2, 3), np.zeros(3).view(np.recarray)):
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
        ):
            return False
    return True


def _word(address: int) -> int:
    return ctypes.c_int64.from_address(address).value


def slots_of(kind: Kind) -> int:
    """How many times 8 bytes it takes."""
    if isinstance(kind, Tuple):
        return sum(map(slots_of, kind.parts))
    return int(not isinstance(kind, Nothing))


def packer(kinds: Sequence[Kind]) -> Callable[[tuple[Any, ...]], bytes | None]:
    """A function that packs arguments of these kinds; it gives None where they are of others."""
    code = _Packing()
    patterns = [code.pattern(each) for each in kinds]
    checks = [f"type(arguments[{place}]) is not T{place}" for place, each in enumerate(kinds)
              if isinstance(each, Tuple)]  # fmt: skip
    checks.append(f"len(arguments) != {len(kinds)}")
    absent = [f"{name} is not None" for name in code.absent]
    lines = [
        "def pack(arguments):",
        "    try:",
        f"        if {' or '.join(reversed(checks))}: return None",
        f"        ({''.join(f'{each}, ' for each in patterns)}) = arguments",
        *([f"        if {' or '.join(absent)}: return None"] if absent else []),
        f"        return write(HEAD, {', '.join(code.values)})"
        if code.values
        else "        return write(HEAD)",
        "    except (TypeError, ValueError, error): return None",
    ]
    head = struct.pack(f"<{HEAD}q", *(id(each) for each in ACCEPTED))
    scope = {
        "write": struct.Struct(f"<{len(head)}s" + "".join(code.formats)).pack,
        "HEAD": head,
        "error": struct.error,
        **{f"T{place}": each.type or tuple for place, each in enumerate(kinds)
           if isinstance(each, Tuple)},
    }  # fmt: skip
    exec("\n".join(lines), scope)
    made: Callable[[tuple[Any, ...]], bytes | None] = scope["pack"]  # type: ignore[assignment]
    return made


class _Packing:
    """The parts of the generated function, in the order of the slots."""

    def __init__(self) -> None:
        self.values: list[str] = []
        self.formats: list[str] = []
        self.absent: list[str] = []

    def pattern(self, kind: Kind) -> str:
        """What takes a value of the kind apart."""
        if isinstance(kind, Tuple):
            return f"({''.join(f'{self.pattern(each)}, ' for each in kind.parts)})"
        name = f"v{len(self.values)}"
        if isinstance(kind, Nothing):
            name = f"n{len(self.absent)}"
            self.absent.append(name)
        elif isinstance(kind, Array):
            self.values.append(f"id({name})")
            self.formats.append("q")
        else:
            self.values.append(name)
            self.formats.append(_FORMATS[kind.letter])
        return name


def unpacker(kind: Kind) -> tuple[int, Callable[[bytes], Any]]:
    """The size [bytes] of a result, and a function that makes it of the bytes."""
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
