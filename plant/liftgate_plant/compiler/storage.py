# mypy: allow-untyped-calls
"""Where numba keeps machine code on disk."""

from __future__ import annotations

import contextlib
import fcntl
from pathlib import Path
from typing import IO, Any

import numba
from numba.core.caching import FunctionCache

types: Any = numba.types


def keep(machine_code: Any, folder: Path) -> None:
    """Let numba keep the machine code of an entry point in `folder`, which is its own.

    Where no such folder can be made it compiles afresh each time.
    """
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
        cache = _EntryCache(machine_code.py_func, folder / "lock")
    except (OSError, RuntimeError):  # RuntimeError: numba finds no place, or no source file
        return
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
    compile_here = machine_code.compile

    def compile_in_turn(signature: Any) -> Any:
        try:
            return compile_here(signature)
        finally:
            cache.release()

    machine_code._cache = cache
    machine_code.compile = compile_in_turn


class _EntryCache(FunctionCache):
    """numba's disk cache of a function, in which one process at a time compiles; others wait and load.

    numba's own would have each of them compile, and may mix up what they save at the same time: each reads the
    index, and takes the next free name in it for its file.
    """

    def __init__(self, function: Any, path: Path) -> None:
        super().__init__(function)
        self._path = path
        self._lock: IO[bytes] | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What is kept for the signature; where there is None it is this process's turn to compile."""
        found = super().load_overload(sig, target_context)
        if found is None and self._lock is None:
            # Without locks, or in a folder that this user may not write to, each compiles by itself.
            with contextlib.suppress(OSError):
                self._lock = self._path.open("ab")
                fcntl.flock(self._lock, fcntl.LOCK_EX)
                found = super().load_overload(sig, target_context)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep it; a full disk costs the next start its time, but this one goes on."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)

    def release(self) -> None:
        """Let another process have its turn."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        """To numba a NamedTuple with the same types of fields is the same, whatever their names."""
        fields = tuple(_fields_of(kind) for kind in getattr(sig, "args", sig))
        return (*super()._index_key(sig, codegen), fields)


def _fields_of(kind: Any) -> Any:
    if isinstance(kind, types.BaseTuple):
        return (*getattr(kind, "fields", ()), *(_fields_of(each) for each in kind))
    return None
