"""Obtain machine code of a function for kinds of arguments: read from disk, or compiled and stored.

Watchers are informed while something is being compiled, which takes seconds.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from liftgate_compiler import building, storage
from liftgate_compiler.child import CompileRequest, compile_apart
from liftgate_compiler.kinds import Kind
from liftgate_compiler.loading import MachineCode, StandIns
from liftgate_compiler.storage import Stored


class GivenUpError(Exception):
    """Raised by a watcher to end a compilation, as nobody waits for the machine code any more."""


class Watcher:
    """Base class of watchers, which are informed of compilations; its methods do nothing.

    An exception of its methods (GivenUpError) ends the waiting and the compilation.
    """

    def compiles(self, name: str, seconds: float) -> None:
        """Called every 0.1 s, from 0 on: `name` has been compiling for `seconds`."""

    def waits(self, name: str, seconds: float) -> None:
        """Called every 0.1 s: `name` has waited `seconds` for another process or thread to compile."""

    def ready(self, name: str, seconds: float) -> None:
        """Called when a compilation, or the wait for another process's, has ended after `seconds`."""

    def not_kept(self, why: str) -> None:
        """Called with the reason if machine code is neither read from disk nor stored there."""


_watchers = [Watcher()]


def watch(watcher: Watcher) -> None:
    """Inform this watcher of compilations from now on, instead of the previous one.

    Only the watcher added last is informed; `unwatch` removes it.
    """
    _watchers.append(watcher)


def unwatch(watcher: Watcher) -> None:
    """Remove a watcher; watchers need not be removed in the order in which they were added."""
    _watchers.remove(watcher)


def watcher() -> Watcher:
    """Return the current watcher: the last one added."""
    return _watchers[-1]


_lock = threading.Lock()


def _renew_lock() -> None:
    """Give a forked process a new lock, as a thread of its parent may hold the old one."""
    global _lock  # noqa: PLW0603
    _lock = threading.Lock()


os.register_at_fork(after_in_child=_renew_lock)

_LOOK_S = 0.1
_is_compiling = threading.Event()  # a thread of this process compiles


def machine_code_of(
    function: Callable[..., Any], kinds: tuple[Kind, ...], stand_ins: StandIns | None = None
) -> MachineCode:
    """Return machine code of `function` for arguments of these kinds, in which `stand_ins` replace their Systems.

    Raises what numba raises, CompileError, and what the watcher raises.
    """
    began = time.monotonic()
    lock = _lock
    while not lock.acquire(timeout=_LOOK_S):  # another thread loads code, or compiles
        if _is_compiling.is_set():
            watcher().waits(function.__qualname__, time.monotonic() - began)
    try:
        stored = _read_or_compiled(function, kinds)
    finally:
        lock.release()
    return MachineCode(function.__qualname__, stored.code, kinds, stored.result, stand_ins)


def _read_or_compiled(function: Callable[..., Any], kinds: tuple[Kind, ...]) -> Stored:
    """Return machine code stored on disk, or compile and store it; disk errors are only reported."""
    path = building.file_of(function, kinds)
    with contextlib.ExitStack() as stack:
        try:
            if stored := storage.read(path):
                return stored
            turn = stack.enter_context(storage.turn(path.parent))
        except OSError as error:
            watcher().not_kept(_reason(error))
            return _compiled(function, kinds)
        return _in_turn(function, kinds, path, turn)


def _in_turn(function: Callable[..., Any], kinds: tuple[Kind, ...], path: Path, turn: storage.Turn) -> Stored:
    """Wait for the turn to compile; return what another process has stored meanwhile, or compile and store it."""
    began = time.monotonic()
    while not turn.taken():
        watcher().waits(function.__qualname__, time.monotonic() - began)
        time.sleep(_LOOK_S)
    with contextlib.suppress(OSError):  # reported below if the code cannot be stored either
        if stored := storage.read(path):  # by the process that had its turn before
            watcher().ready(function.__qualname__, time.monotonic() - began)
            return stored
    stored = _compiled(function, kinds)
    try:
        storage.keep(path, stored)
    except OSError as error:
        watcher().not_kept(_reason(error))
    return stored


def _reason(error: OSError) -> str:
    """Return in words why machine code cannot be read or stored."""
    if isinstance(error, storage.NotOursError):
        return str(error)
    return f"{storage.root()}: {error.strerror or error}"


def _compiled(function: Callable[..., Any], kinds: tuple[Kind, ...]) -> Stored:
    """Compile an entry point, in a separate process where possible, and inform the watcher meanwhile."""
    name, began = function.__qualname__, time.monotonic()

    def look() -> None:
        watcher().compiles(name, time.monotonic() - began)

    building.check_numba()
    look()
    made = None
    _is_compiling.set()
    try:
        if function.__module__ != "__main__":
            made = compile_apart(CompileRequest(function, kinds, building.key_of(function)), look)
        if made is None:
            made = building.make_here(function, kinds)
    finally:
        _is_compiling.clear()
    watcher().ready(name, time.monotonic() - began)
    return made
