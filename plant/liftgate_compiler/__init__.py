"""Interface to the compiler of machine code; nothing outside this package depends on numba.

A function marked `compilable` stays a plain Python function: called from Python it runs as such, so that it can be
debugged, covered and tested without a compiler. An entry point passed to `compiled` becomes machine code that
holds no interpreter lock, together with all compilable functions it calls.

    sources     what an entry point is made from, and a hash over it        ┐
    obtaining   machine code from the disk, or compiled and stored there    │
    building    keys and files of machine code, compilation in this process ├ without numba
    storage, child, kinds, packing, loading                                 ┘
    making, linking, extensions     numba, in a process of its own

What these three use of numba's inside, and with which versions that was tried, stands in docs/compiler.md.

`LIFTGATE_COMPILE=0` in the environment switches the compiler off: `compiled` then returns its argument.

A `System` is a function of the C library that both plain Python and compiled code can call.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from liftgate_compiler import building, obtaining, packing, storage
from liftgate_compiler.building import CompileError, check_numba
from liftgate_compiler.calls import INT_OF_LONG_INT, INT_OF_STEP, System, call_long_int, call_step, last_error
from liftgate_compiler.child import sharing
from liftgate_compiler.kinds import Kind, kind_of
from liftgate_compiler.loading import MachineCode
from liftgate_compiler.obtaining import GivenUpError, Watcher, unwatch, watch
from liftgate_compiler.storage import expected_s, note_duration
from liftgate_compiler.tuples import all_finite, fill, overlay, picked, put_text, unflattened, with_item

__all__ = [
    "INT_OF_LONG_INT", "INT_OF_STEP", "CompileError", "GivenUpError", "System", "Watcher",
    "all_finite", "cache_folder", "call_long_int", "call_step", "check_numba", "compilable", "compiled", "enabled",
    "expected_s", "fill", "is_cached", "last_error", "note_duration", "outlined", "overlay",
    "picked", "processor", "put_text", "sharing", "unflattened", "unwatch", "watch", "with_item",
]  # fmt: skip

F = TypeVar("F", bound=Callable[..., Any])


def compilable(function: F) -> F:
    """Mark a function as callable from compiled code; elsewhere it stays plain Python."""
    building.compilable_functions.append(function)
    return function


def outlined(function: F) -> F:
    """Mark a compilable function as called, instead of inlined, in machine code.

    This suits a function of few arguments, where a call costs less than another copy of its code.
    """
    building.outlined_functions.add(function)
    return compilable(function)


def compiled(function: F) -> F:
    """Return `function` as machine code, compiled or read from disk at its first call; unchanged if disabled."""
    if not enabled():
        return function
    return _entry(function)  # type: ignore[return-value]


def is_cached(function: Callable[..., Any]) -> bool:
    """Whether machine code of `function` is in the cache, for some kinds of arguments.

    Also true if the compiler is switched off; false if this user may not read the cache.
    """
    if not enabled():
        return True
    folder = cache_folder(function)
    try:
        storage.check_ours(folder.parent)
        storage.check_ours(folder)
        return any(folder.glob("*" + storage.SUFFIX))
    except OSError:  # a folder that this user may not access
        return False


def processor() -> tuple[str, str]:
    """Return name and features of the processor for which machine code is made."""
    return building.processor()


def enabled() -> bool:
    """Whether the compiler is enabled, by the environment."""
    switches = os.environ.get("LIFTGATE_COMPILE", "1"), os.environ.get("NUMBA_DISABLE_JIT", "0")
    return switches[0] != "0" and switches[1] in ("", "0")


def cache_folder(function: Callable[..., Any] | None = None) -> Path:
    """Return the folder of all machine code, or that of one entry point with its present sources."""
    return storage.root() if function is None else building.folder_of(function)


class Entry:
    """Entry point: a function compiled to machine code separately for each combination of argument kinds."""

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)
        self._function = function
        self._last: MachineCode | None = None
        self._all: dict[tuple[Any, ...], MachineCode] = {}

    @property
    def kinds(self) -> list[tuple[Kind, ...]]:
        """Combinations of argument kinds for which this process has loaded machine code."""
        return list(self._all)

    def is_ready_for(self, *arguments: Any) -> bool:
        """Whether the last used machine code accepts arguments of these kinds."""
        return self._last is not None and self._last.takes(arguments)

    def __call__(self, *arguments: Any) -> Any:
        """Call the function's machine code with these arguments, after loading or compiling it if needed.

        Raises TypeError for arguments that machine code does not accept, and what numba raises.
        """
        code = self._last  # other threads may set it meanwhile
        if code is not None:
            fits, result = code.call(arguments)
            if fits:
                return result
        kinds = tuple(kind_of(each) for each in arguments)
        if kinds not in self._all:
            self._all[kinds] = obtaining.machine_code_of(self._function, kinds)
        self._last = code = self._all[kinds]
        fits, result = code.call(arguments)
        if not fits:
            raise TypeError(
                f"{self._function.__qualname__}: an array of a type that machine code does not know, or a whole "
                "number of more than 64 bits"
            )
        return result


@functools.cache
def _entry(function: Callable[..., Any]) -> Entry:
    """Return the only Entry of a function. Raises RuntimeError for a numpy whose arrays have another layout."""
    if not packing.is_as_expected():
        raise RuntimeError("numpy has another array layout than 2.x; allowed: numpy 2.x")
    return Entry(function)
