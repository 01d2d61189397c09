"""C functions callable from compilable code: those of the C library by name, others by address."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from typing import Any

_KINDS = {"i": ctypes.c_int, "l": ctypes.c_long}


class System:
    """A function of the C library that compilable code may call, with numbers as arguments and result.

    `result` and `arguments` are "i" for int and "l" for long, size_t and addresses (`array.ctypes.data`).
    """

    def __init__(self, name: str, result: str, arguments: str) -> None:
        self.name = name
        self.result = result
        self.arguments = arguments

    @functools.cached_property
    def _plain(self) -> Callable[..., int]:
        """The C function by ctypes, for calls from plain Python."""
        function = getattr(ctypes.CDLL(None, use_errno=True), self.name)
        function.restype = _KINDS[self.result]
        function.argtypes = [_KINDS[kind] for kind in self.arguments]
        return function  # type: ignore[no-any-return]

    def __call__(self, *arguments: int) -> int:
        """Call the C function from plain Python."""
        return self._plain(*(int(argument) for argument in arguments))

    def thunk(self, function: Callable[..., int]) -> Any:
        """Return a C function with this signature that calls a Python function; errno is passed on."""
        kinds = [_KINDS[kind] for kind in self.arguments]
        return ctypes.CFUNCTYPE(_KINDS[self.result], *kinds, use_errno=True)(function)

    def __repr__(self) -> str:
        return f"System({self.name!r}, {self.result!r}, {self.arguments!r})"


# C functions at addresses that are known only at run time; ctypes makes callbacks of the same kinds.
INT_OF_LONG_INT = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int64, ctypes.c_int)
INT_OF_STEP = ctypes.CFUNCTYPE(
    ctypes.c_int,
    ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int, ctypes.c_int64, ctypes.c_int,
)  # fmt: skip


def call_long_int(address: int, a: int, b: int) -> int:
    """Call the C function `int f(int64_t or pointer, int)` at an address."""
    return int(INT_OF_LONG_INT(address)(a, b))


def call_step(address: int, a: int, b: int, c: int, d: int, e: int, f: int) -> int:
    """Call the C function `int f(pointer, int64_t, pointer, int, pointer, int)` at an address."""
    return int(INT_OF_STEP(address)(a, b, c, d, e, f))


def last_error() -> int:
    """Return the error number (errno) of this thread's last System call that failed."""
    return ctypes.get_errno()
