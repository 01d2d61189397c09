"""Dependencies of a function's machine code, its place on disk, and its compilation in this process."""

from __future__ import annotations

import functools
import importlib.util
import os
import platform
import re
import sys
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from liftgate_compiler import storage
from liftgate_compiler.kinds import Kind, text_of
from liftgate_compiler.sources import Sources
from liftgate_compiler.storage import Stored

compilable_functions: list[Callable[..., Any]] = []
outlined_functions: set[Callable[..., Any]] = set()  # the subset that is not inlined

# The lowest and the highest version of numba that were tried: of its inside, docs/compiler.md names what is used.
NUMBA = "0.66", "0.68.1"

# Settings of numba that affect where and how long it compiles, but not the machine code.
_NOT_IN_KEY = {"NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS"}


class CompileError(RuntimeError):
    """Raised if no machine code can be made: the compiler's process was ended, or numba is unsuitable."""


def check_numba() -> None:
    """Check that the installed numba is a supported version. Raises CompileError."""
    lowest, highest = NUMBA
    try:
        installed = metadata.version("numba") or ""  # None: what a failed removal has left
    except metadata.PackageNotFoundError:
        installed = ""
    if not _numbers_of(lowest) <= _numbers_of(installed) <= _numbers_of(highest):
        found = f"numba {installed} is installed" if installed else "numba is not installed"
        wanted = f"{lowest} to {highest} (python -m pip install 'numba>={lowest},<={highest}')"
        raise CompileError(f"{found}; allowed: {wanted}")


def _numbers_of(version: str) -> tuple[int, ...]:
    """Return the first three numbers in a version text, or as many as there are."""
    return tuple(int(each) for each in re.findall(r"\d+", version)[:3])


def make_here(function: Callable[..., Any], kinds: Sequence[Kind]) -> Stored:
    """Compile an entry point in this process; return its machine code to be stored. Raises what numba raises."""
    _import_numba()
    from liftgate_compiler import making

    helpers = _sources(function, len(compilable_functions)).functions
    return making.make(function, kinds, helpers, helpers & outlined_functions)


def file_of(function: Callable[..., Any], kinds: Sequence[Kind]) -> Path:
    """Return the path of the stored machine code for arguments of these kinds."""
    return storage.path_of(folder_of(function), ",".join(text_of(kind) for kind in kinds))


def folder_of(function: Callable[..., Any]) -> Path:
    """Return the folder of an entry point's stored machine code, by a hash of its present sources."""
    return storage.root() / key_of(function)


def key_of(function: Callable[..., Any]) -> str:
    """Return the hash over all dependencies of an entry point's machine code."""
    return _key(function, len(compilable_functions))


@functools.cache
def _sources(function: Callable[..., Any], registered: int) -> Sources:
    """Return the sources of an entry point, cached while the number of compilable functions is `registered`."""
    return Sources(function, compilable_functions)


@functools.cache
def _key(function: Callable[..., Any], registered: int) -> str:
    """Return what `key_of` returns, cached while the number of compilable functions is `registered`."""
    return _sources(function, registered).digest(_environment())


@functools.cache
def _environment() -> str:
    """Return as text the dependencies of machine code other than its sources.

    These are the compiler, its options and settings, Python, and the processor.
    """
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
    """Return the processor for which machine code is made: its name and its features."""
    import llvmlite.binding as llvm  # type: ignore[import-untyped]

    return llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


def _numba_version() -> str:
    """Return the text of numba's file _version.py, which states its version; "" if it is not installed.

    It is read without importing numba: that would take longer than all else until machine code runs.
    """
    found = importlib.util.find_spec("numba")
    if found is None or found.origin is None:
        return ""
    return Path(found.origin).with_name("_version.py").read_bytes().decode()


def _import_numba() -> None:
    """Import numba, skipping its check whether scipy has a BLAS.

    The check imports half of scipy, which takes half a second; it is for products of matrices, of which there are
    none in compiled code.
    """
    probe = "scipy.linalg.cython_blas"
    if "numba.np.arraymath" in sys.modules or "scipy.linalg" in sys.modules:
        return
    sys.modules[probe] = None  # type: ignore[assignment]
    try:
        import numba.np.arraymath as asked
    finally:
        del sys.modules[probe]
    if hasattr(asked, "_HAVE_BLAS"):  # others may compile such products: numba checks again when they do
        asked._HAVE_BLAS = importlib.util.find_spec("scipy") is not None
