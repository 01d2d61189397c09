"""Compiling in a process of its own, which can be stopped at any moment: machine code comes back from it.

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
_START = (
    "import sys, json; sys.path[:] = json.loads(sys.argv[1]); "
    f"from {__name__} import main; sys.exit(main())"
)


class Request(NamedTuple):
    """What to compile."""

    function: Callable[..., Any]
    kinds: tuple[Kind, ...]
    key: str  # as the caller has it: what it was loaded from may differ from what is in the files now


class CompileError(RuntimeError):
    """The compiler's process did not come to its end."""


def compile_apart(request: Request, look: Callable[[], None]) -> Any:
    """What `building.make_here` gives; None where it can only be compiled in this process. `look` is called all
    the time, and may raise.

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
            start_new_session=True,  # a Ctrl-C is for this process
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
        name = signal.Signals(-child.returncode).name
        raise CompileError(f"the compiler's process was ended from outside ({name})")
    return pickle.loads(answer) if child.returncode == 0 else None


def main() -> int:
    """The process; exit code 1: not here."""
    ctypes.CDLL(None).prctl(_PDEATHSIG, signal.SIGKILL, 0, 0, 0)  # nobody is left who waits
    try:
        request: Request = pickle.load(sys.stdin.buffer)
    except Exception:  # what cannot be imported here can still be compiled there
        return 1
    from liftgate_plant.compiler import building

    if building.key_of(request.function) != request.key:
        return 1
    try:
        made = building.make_here(request.function, request.kinds)
        answer = pickle.dumps(made)
    except Exception:  # told where it is asked for, by compiling it there
        return 1
    sys.stdout.buffer.write(answer)
    sys.stdout.flush()
    os._exit(0)  # taking everything down takes a while
