"""Compilation in a process of its own, which can be stopped at any moment and returns machine code.

python -P -c ... PATH        the import path as JSON

A pickled Request on stdin, behind its length, is answered on stdout by what `building.make_here` returns for it,
or by None: the caller has to compile it itself.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import pickle
import select
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

from liftgate_plant.compiler import building
from liftgate_plant.compiler.building import CompileError
from liftgate_plant.compiler.kinds import Kind

_PDEATHSIG = 1  # PR_SET_PDEATHSIG
_LOOK_S = 0.1
_LENGTH = struct.Struct("<Q")
_START = f"import sys, json; sys.path[:] = json.loads(sys.argv[1]); from {__name__} import main; sys.exit(main())"


class Request(NamedTuple):
    """Request to compile an entry point for certain kinds of arguments."""

    function: Callable[..., Any]
    kinds: tuple[Kind, ...]
    key: str  # of the caller: its code may have been loaded from files that have changed since


class _Compiler:
    """The compiler's process, which answers one request after the other."""

    def __init__(self) -> None:
        """Start it. Raises OSError, ValueError."""
        self.owner = os.getpid()
        path = json.dumps([each for each in sys.path if Path(each).is_absolute()])
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _START, path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            bufsize=0,
            start_new_session=True,  # so that a Ctrl-C reaches this process only
        )

    def is_running(self) -> bool:
        """Whether the process has not ended, as with the thread that started it."""
        return self._process.poll() is None

    def answer(self, request: bytes, look: Callable[[], None]) -> Any:
        """Return the answer to a pickled Request; None where there is none.

        `look` is called every 0.1 s meanwhile. Raises CompileError where the process was ended from outside, and
        what `look` raises.
        """
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended, as its return code tells
            _put(stdin, request)
        poll = select.poll()
        poll.register(stdout, select.POLLIN)
        received = b""
        while len(received) < _LENGTH.size or len(received) < _LENGTH.size + _LENGTH.unpack_from(received)[0]:
            if not poll.poll(1e3 * _LOOK_S):
                look()
            elif part := stdout.read(1 << 20):
                received += part
            elif (code := self._process.wait()) < 0:
                raise CompileError(f"the compiler's process was ended from outside (signal {-code})")
            else:
                return None
        return pickle.loads(received[_LENGTH.size :])

    def end(self) -> None:
        """End the process."""
        with self._process:  # closes its pipes and waits
            self._process.kill()


class _Shared:
    """The compiler's process that serves all requests within `sharing`."""

    users = 0
    compiler: _Compiler | None = None


@contextlib.contextmanager
def sharing() -> Iterator[None]:
    """Let one process compile all entry points within the context.

    It infers the types of a helper once, and lowers it once, for all entry points that call it.
    """
    _Shared.users += 1
    try:
        yield
    finally:
        _Shared.users -= 1
        if not _Shared.users:
            _end_shared()


def _end_shared() -> None:
    """End the shared process, unless it is that of the parent of a forked process."""
    if _Shared.compiler is not None and _Shared.compiler.owner == os.getpid():
        _Shared.compiler.end()
    _Shared.compiler = None


def compile_apart(request: Request, look: Callable[[], None]) -> Any:
    """Return what `building.make_here` returns, made in another process.

    Returns None where it can only be compiled in this process. `look` is called every 0.1 s meanwhile, and may
    raise.

    Raises CompileError where the process was ended from outside.
    """
    try:
        asked = pickle.dumps(request)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    if _has_shared() and (answer := _answered(asked, look)) is not None:
        return answer
    # One that has served others may have been started before a folder was on the path, or a file was edited.
    try:
        _Shared.compiler = _Compiler()
    except (OSError, ValueError):
        return None
    return _answered(asked, look)


def _has_shared() -> bool:
    """Whether a process is kept for this one; one that is not is ended."""
    kept = _Shared.compiler
    if kept is not None and kept.owner == os.getpid() and kept.is_running():
        return True
    _end_shared()
    return False


def _answered(request: bytes, look: Callable[[], None]) -> Any:
    """Return the answer of the process; it is ended unless it is shared and has given one."""
    assert _Shared.compiler is not None
    is_kept = False
    try:
        answer = _Shared.compiler.answer(request, look)
        is_kept = answer is not None and _Shared.users > 0
        return answer
    finally:
        if not is_kept:
            _end_shared()


def main() -> int:
    """Run the compiler's process until its input ends."""
    ctypes.CDLL(None).prctl(_PDEATHSIG, signal.SIGKILL, 0, 0, 0)  # ends with its parent, as nobody waits then
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb", buffering=0)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    while head := _taken(sys.stdin.buffer, _LENGTH.size):
        _put(answers, pickle.dumps(_made(_taken(sys.stdin.buffer, *_LENGTH.unpack(head)))))
    os._exit(0)  # a regular exit would take a while


def _made(request: bytes) -> Any:
    """Return the answer to a pickled Request; None where only the caller can compile it, or report why not."""
    with contextlib.suppress(Exception):
        asked: Request = pickle.loads(request)
        if building.key_of(asked.function) == asked.key:
            return building.make_here(asked.function, asked.kinds)
    return None


def _taken(stream: IO[bytes], count: int) -> bytes:
    """Return as many bytes; none at the end of the stream."""
    taken = stream.read(count)
    return taken if len(taken) == count else b""


def _put(stream: IO[bytes], message: bytes) -> None:
    """Write a message behind its length, whole."""
    rest = memoryview(_LENGTH.pack(len(message)) + message)
    while rest:
        rest = rest[stream.write(rest) :]
