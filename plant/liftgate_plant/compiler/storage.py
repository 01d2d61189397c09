# mypy: allow-untyped-calls
"""Machine code on disk: a file for each signature of an entry point, in the entry point's own folder."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import pickle
from pathlib import Path
from typing import IO, Any

import numba
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

SUFFIX = ".code"
_DIGEST_BYTES = hashlib.sha256().digest_size

types: Any = numba.types


def keep(machine_code: Any, folder: Path) -> None:
    """Let numba keep the machine code of an entry point in `folder`, which is its own.

    What cannot be read, or not be kept, is compiled afresh.
    """
    cache = _EntryCache(folder)
    compile_here = machine_code.compile

    def compile_in_turn(signature: Any) -> Any:
        try:
            return compile_here(signature)
        finally:
            cache.release()

    machine_code._cache = cache
    machine_code.compile = compile_in_turn


class _EntryCache:
    """In the place of numba's, which may fall back to other folders, looks at less than our key does, and has what
    is wrong with a file end the run. One process at a time compiles; others wait, and load.
    """

    def __init__(self, folder: Path) -> None:
        self.cache_path = str(folder)
        self._folder = folder
        self._lock: IO[bytes] | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What is kept for the signature; where there is None it is this process's turn to compile."""
        target_context.refresh()
        found = self._load(sig, target_context)
        if found is None and self._lock is None:
            # Without locks, or in a folder that this user may not write to, each compiles by itself.
            with contextlib.suppress(OSError):
                self._folder.mkdir(parents=True, exist_ok=True)
                self._lock = (self._folder / "lock").open("ab")
                fcntl.flock(self._lock, fcntl.LOCK_EX)
                found = self._load(sig, target_context)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep it, whole or not at all; a full disk costs the next start its time, but this one goes on."""
        content = dumps(data._reduce())
        path = self._path(sig)
        draft = path.with_suffix(f".{os.getpid()}")
        try:
            draft.write_bytes(hashlib.sha256(content).digest() + content)
            draft.replace(path)
        except OSError:
            with contextlib.suppress(OSError):
                draft.unlink()

    def release(self) -> None:
        """Let another process have its turn."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _load(self, sig: Any, context: Any) -> Any:
        try:
            content = self._path(sig).read_bytes()
        except OSError:
            return None
        digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
        if hashlib.sha256(content).digest() != digest:  # cut short, or not ours
            return None
        return CompileResult._rebuild(context, *pickle.loads(content))

    def _path(self, sig: Any) -> Path:
        # To numba a NamedTuple with the same types of fields is the same, whatever their names.
        fields = tuple(_fields_of(kind) for kind in getattr(sig, "args", sig))
        name = hashlib.sha256(f"{sig} {fields}".encode()).hexdigest()[:16]
        return self._folder / (name + SUFFIX)


def _fields_of(kind: Any) -> Any:
    if isinstance(kind, types.BaseTuple):
        return (*getattr(kind, "fields", ()), *(_fields_of(each) for each in kind))
    return None
