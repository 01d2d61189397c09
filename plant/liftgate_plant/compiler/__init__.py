"""The one place that knows the compiler (numba).

A function marked `compilable` stays a plain Python function: called from Python it runs as such, so that
it can be debugged, covered and tested without a compiler. An entry point handed to `compiled` becomes
machine code that holds no interpreter lock, together with all compilable functions it calls.

`LIFTGATE_COMPILE=0` in the environment switches the compiler off: `compiled` then returns its argument.

A `System` is a function of the C library that both can call.
"""

from __future__ import annotations

import functools
import importlib.util
import os
import platform
import sys
import threading
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from liftgate_plant.compiler.calls import (
    INT_OF_LONG_INT,
    INT_OF_STEP,
    System,
    call_long_int,
    call_step,
    last_error,
)
from liftgate_plant.compiler.sources import Sources
from liftgate_plant.compiler.tuples import all_finite, fill, overlay, picked, with_item

__all__ = [
    "INT_OF_LONG_INT", "INT_OF_STEP", "System", "all_finite", "borrowed", "cache_folder", "call_long_int",
    "call_step", "compilable", "compiled", "enabled", "fill", "is_cached", "last_error", "overlay", "picked",
    "with_item",
]  # fmt: skip

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

_compilable: list[Callable[..., Any]] = []
_known_to_numba: set[Callable[..., Any]] = set()
_lock = threading.Lock()

# IEEE results instead of exceptions: a division by zero gives inf, which the loop's divergence check sees.
# No wrapper for calls from C: nothing here calls from there.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
_ENTRY_OPTIONS: dict[str, Any] = {**_OPTIONS, "nogil": True}
# A NamedTuple is passed as its scalars, over a hundred of them, so that a call may cost more than its callee.
_HELPER_OPTIONS: dict[str, Any] = {**_OPTIONS, "forceinline": True}
# Of numba's settings those that say where and how long, not what.
_NOT_IN_KEY = {"NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS"}


def compilable(function: F) -> F:
    """Mark a function as usable inside compiled code; it stays plain Python outside."""
    _compilable.append(function)
    return function


def compiled(function: F) -> F:
    """The machine code of `function`, compiled at its first call (or read from the cache)."""
    if not enabled():
        return function
    with _lock:
        return _compiled(function)  # type: ignore[return-value]


def is_cached(function: Callable[..., Any]) -> bool:
    """Whether the machine code of `function` is in the disk cache, so that it is ready at once."""
    if not enabled():
        return True
    try:
        return any(cache_folder(function).glob("*.code"))
    except OSError:  # a folder that this user may not look into
        return False


def borrowed(value: T) -> T:
    """A NamedTuple with the same arrays, whose references compiled code does not count.

    For what its caller keeps alive and what nothing returns: counting costs a third of a tick, and much of the
    compilation. Its arrays are of a type of their own in compiled code: a variable holds either borrowed ones or
    counted ones. In plain Python the value itself.
    """
    return value


def enabled() -> bool:
    """Whether `compiled` compiles."""
    said = os.environ.get("LIFTGATE_COMPILE", "1"), os.environ.get("NUMBA_DISABLE_JIT", "0")
    return said[0] != "0" and said[1] in ("", "0")


def cache_folder(function: Callable[..., Any] | None = None) -> Path:
    """Where machine code is kept, all of it or that of an entry point as its sources are now."""
    root = Path(os.environ.get("XDG_CACHE_HOME") or _home() / ".cache") / "liftgate-hil"
    return root if function is None else root / _key(function, len(_compilable))


def _home() -> Path:
    try:
        return Path.home()
    except RuntimeError:  # a user without one, as in containers: nothing can be kept there
        return Path(os.devnull)


@functools.cache
def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    _import_numba()
    import numba
    from numba.core.compiler import Compiler

    from liftgate_plant.compiler import linking, storage

    def teach() -> None:
        _teach_numba(_sources(function, len(_compilable)).functions - {function})

    if linking.is_possible():
        compiler = linking.entry_compiler(teach)
    else:
        teach()
        compiler = Compiler
    machine_code: Callable[..., Any] = numba.njit(pipeline_class=compiler, **_ENTRY_OPTIONS)(
        function
    )
    storage.keep(machine_code, cache_folder(function))
    return machine_code


def _import_numba() -> None:
    """Numba looks whether scipy has a BLAS, for products of matrices, of which there are none in compiled code:
    that imports half of scipy, a quarter of the time until machine code is read from the cache.
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


def _teach_numba(helpers: set[Callable[..., Any]]) -> None:
    """Tell numba what compiled code may call."""
    from numba.extending import register_jitable

    from liftgate_plant.compiler import extensions, linking  # noqa: F401

    options = dict(_HELPER_OPTIONS)
    if linking.is_possible():
        options["pipeline_class"] = linking.HelperCompiler
    for helper in helpers - _known_to_numba:
        register_jitable(**options)(helper)
        _known_to_numba.add(helper)


@functools.cache
def _sources(function: Callable[..., Any], registered: int) -> Sources:
    return Sources(function, _compilable)


@functools.cache
def _key(function: Callable[..., Any], registered: int) -> str:
    """A hash over all that the machine code of an entry point depends on."""
    return _sources(function, registered).digest(_environment())


@functools.cache
def _environment() -> str:
    """What else machine code depends on, as a text: compiler, its options and settings, Python, processor."""
    import llvmlite.binding as llvm  # type: ignore[import-untyped]

    own = [path.read_bytes().decode() for path in sorted(Path(__file__).parent.glob("*.py"))]
    settings = {
        name: value
        for name, value in sorted(os.environ.items())
        if name.startswith("NUMBA_") and name not in _NOT_IN_KEY
    }
    return "\0".join(
        (
            *own,
            repr((_ENTRY_OPTIONS, _HELPER_OPTIONS, settings)),
            *(version(name) for name in ("numba", "llvmlite", "numpy")),
            platform.python_implementation() + platform.python_version(),
            llvm.get_host_cpu_name(),
            llvm.get_host_cpu_features().flatten(),
        )
    )
