"""From a function and the kinds of its arguments to machine code: from the disk, or compiled and kept there."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import os
import platform
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from liftgate_plant.compiler import storage
from liftgate_plant.compiler.child import Request, compile_apart
from liftgate_plant.compiler.kinds import Kind, text_of
from liftgate_plant.compiler.loading import MachineCode
from liftgate_plant.compiler.sources import Sources
from liftgate_plant.compiler.storage import Stored
from liftgate_plant.compiler.watching import watcher

compilable_functions: list[Callable[..., Any]] = []
outlined_functions: set[Callable[..., Any]] = set()  # of these, those that are not inlined
_lock = threading.Lock()

_LOOK_S = 0.1
# Of numba's settings those that say where and how long, not what.
_NOT_IN_KEY = {"NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS"}


def machine_code_of(function: Callable[..., Any], kinds: tuple[Kind, ...]) -> MachineCode:
    """For arguments of these kinds. Raises what numba raises, CompileError, and what the watcher raises."""
    began = time.monotonic()
    while not _lock.acquire(timeout=_LOOK_S):  # another thread compiles
        watcher().waits(function.__qualname__, time.monotonic() - began)
    try:
        stored = _from_disk(function, kinds)
    finally:
        _lock.release()
    return MachineCode(function.__qualname__, stored.code, kinds, stored.result)


def _from_disk(function: Callable[..., Any], kinds: tuple[Kind, ...]) -> Stored:
    """Kept, or compiled and kept; what is wrong with the disk costs time, and is told."""
    path = file_of(function, kinds)
    with contextlib.ExitStack() as stack:
        try:
            if stored := storage.read(path):
                return stored
            turn = stack.enter_context(storage.turn(path.parent))
        except OSError as error:
            watcher().not_kept(_reason(error))
            return _compiled(function, kinds)
        return _in_turn(function, kinds, path, turn)


def _in_turn(
    function: Callable[..., Any], kinds: tuple[Kind, ...], path: Path, turn: storage.Turn
) -> Stored:
    began = time.monotonic()
    while not turn.taken():
        watcher().waits(function.__qualname__, time.monotonic() - began)
        time.sleep(_LOOK_S)
    with contextlib.suppress(OSError):  # told when it cannot be kept, either
        if stored := storage.read(path):  # by the one that had its turn before
            watcher().ready(function.__qualname__, time.monotonic() - began)
            return stored
    stored = _compiled(function, kinds)
    try:
        storage.keep(path, stored)
    except OSError as error:
        watcher().not_kept(_reason(error))
    return stored


def _reason(error: OSError) -> str:
    if isinstance(error, storage.NotOursError):
        return str(error)
    return f"{storage.root()}: {error.strerror or error}"


def _compiled(function: Callable[..., Any], kinds: tuple[Kind, ...]) -> Stored:
    name, began = function.__qualname__, time.monotonic()

    def look() -> None:
        watcher().compiles(name, time.monotonic() - began)

    look()
    made = None
    if function.__module__ != "__main__":
        made = compile_apart(Request(function, kinds, key_of(function)), look)
    if made is None:
        made = make_here(function, kinds)
    watcher().ready(name, time.monotonic() - began)
    return made


def make_here(function: Callable[..., Any], kinds: Sequence[Kind]) -> Stored:
    """Compile in this process. Raises what numba raises."""
    _import_numba()
    from liftgate_plant.compiler import making

    helpers = _sources(function, len(compilable_functions)).functions
    return making.make(function, kinds, helpers, helpers & outlined_functions)


def file_of(function: Callable[..., Any], kinds: Sequence[Kind]) -> Path:
    """Where the machine code for arguments of these kinds is kept."""
    return storage.path_of(folder_of(function), ",".join(text_of(kind) for kind in kinds))


def folder_of(function: Callable[..., Any]) -> Path:
    """Where machine code of an entry point is kept, as its sources are now."""
    return storage.root() / key_of(function)


def key_of(function: Callable[..., Any]) -> str:
    """A hash over all that the machine code of an entry point depends on."""
    return _key(function, len(compilable_functions))


@functools.cache
def _sources(function: Callable[..., Any], registered: int) -> Sources:
    return Sources(function, compilable_functions)


@functools.cache
def _key(function: Callable[..., Any], registered: int) -> str:
    return _sources(function, registered).digest(_environment())


@functools.cache
def _environment() -> str:
    """What else machine code depends on, as a text: compiler, its options and settings, Python, processor."""
    import llvmlite  # type: ignore[import-untyped]
    import numpy

    own = [path.read_bytes().decode() for path in sorted(Path(__file__).parent.glob("*.py"))]
    settings = {
        name: value
        for name, value in sorted(os.environ.items())
        if name.startswith("NUMBA_") and name not in _NOT_IN_KEY
    }
    return "\0".join(
        (
            *own,
            repr(settings),
            _numba_version(),
            llvmlite.__version__,
            numpy.__version__,
            platform.python_implementation() + platform.python_version(),
            *processor(),
        )
    )


def processor() -> tuple[str, str]:
    """What machine code is made for: the processor's name, and its features."""
    import llvmlite.binding as llvm  # type: ignore[import-untyped]

    return llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


def _numba_version() -> str:
    """As its files say: importing it takes longer than all else until machine code runs."""
    found = importlib.util.find_spec("numba")
    if found is None or found.origin is None:
        return ""
    return Path(found.origin).with_name("_version.py").read_bytes().decode()


def _import_numba() -> None:
    """Numba looks whether scipy has a BLAS, for products of matrices, of which there are none in compiled code:
    that imports half of scipy, half a second.
    """
    probe = "scipy.linalg.cython_blas"
    if "numba.np.arraymath" in sys.modules or "scipy.linalg" in sys.modules:
        return
    sys.modules[probe] = None  # type: ignore[assignment]
    try:
        import numba.np.arraymath as asked
    finally:
        del sys.modules[probe]
    if hasattr(
        asked, "_HAVE_BLAS"
    ):  # others may compile such products: numba looks again when they do
        asked._HAVE_BLAS = importlib.util.find_spec("scipy") is not None
