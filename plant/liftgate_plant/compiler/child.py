"""Compilation in a process of its own, which can be stopped at any moment and returns machine code.

python -P -c ... PATH        the import path as JSON; a pickled Request is on stdin, a pickled Stored on stdout
"""

from __future__ import annotations

import ctypes
import json
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from liftgate_plant.compiler.kinds import Kind

_PDEATHSIG = 1  # PR_SET_PDEATHSIG
_LOOK_S = 0.1
_START = f"import sys, json; sys.path[:] = json.loads(sys.argv[1]); from {__name__} import main; sys.exit(main())"


class Request(NamedTuple):
    """Request to compile an entry point for certain kinds of arguments."""

    function: Callable[..., Any]
    kinds: tuple[Kind, ...]
    key: str  # of the caller: its code may have been loaded from files that have changed since


class CompileError(RuntimeError):
    """Raised when the compiler's process was ended before it had finished."""


def compile_apart(request: Request, look: Callable[[], None]) -> Any:
    """Return what `building.make_here` returns, made in a process of its own.

    Returns None where it can only be compiled in this process. `look` is called every 0.1 s meanwhile, and may
    raise.

    Raises CompileError where the process was ended from outside.
    """
    try:
        asked = pickle.dumps(request)
        path = json.dumps([each for each in sys.path if Path(each).is_absolute()])
        child = subprocess.Popen(
            [sys.executable, "-P", "-c", _START, path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # so that a Ctrl-C reaches this process only
        )
    except (pickle.PicklingError, AttributeError, TypeError, OSError, ValueError):
        return None
    try:
        given: bytes | None = asked
        while True:
            try:
                answer, _ = child.communicate(given, timeout=_LOOK_S)
                break
            except subprocess.TimeoutExpired:
                given = None
                look()
    finally:
        child.kill()
        child.wait()
    if child.returncode < 0:
        raise CompileError(f"the compiler's process was ended from outside (signal {-child.returncode})")
    return pickle.loads(answer) if child.returncode == 0 else None


def main() -> int:
    """Run the compiler's process; exit code 1: the caller has to compile it itself."""
    ctypes.CDLL(None).prctl(_PDEATHSIG, signal.SIGKILL, 0, 0, 0)  # ends with its parent, as nobody waits then
    try:
        request: Request = pickle.load(sys.stdin.buffer)
    except Exception:  # what cannot be imported here, the caller can still compile
        return 1
    from liftgate_plant.compiler import building

    if building.key_of(request.function) != request.key:
        return 1
    try:
        made = building.make_here(request.function, request.kinds)
        answer = pickle.dumps(made)
    except Exception:  # the caller reports it when it compiles the function itself
        return 1
    sys.stdout.buffer.write(answer)
    sys.stdout.flush()
    os._exit(0)  # a regular exit would take a while
