"""Compilation in a separate process, which can be stopped at any moment and returns machine code.

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

from liftgate_compiler import building
from liftgate_compiler.building import CompileError
from liftgate_compiler.kinds import Kind

_PDEATHSIG = 1  # PR_SET_PDEATHSIG
_LOOK_S = 0.1
_LENGTH = struct.Struct("<Q")
_START = f"import sys, json; sys.path[:] = json.loads(sys.argv[1]); from {__name__} import main; sys.exit(main())"


class CompileRequest(NamedTuple):
    """Request to compile an entry point for certain kinds of arguments."""

    function: Callable[..., Any]
    kinds: tuple[Kind, ...]
    key: str  # of the caller: its code may have been loaded from files that have changed since


class _Compiler:
    """Compiler in a separate process, which answers one request after the other."""

    def __init__(self) -> None:
        """Start the process. Raises OSError, ValueError."""
        path = json.dumps([each for each in sys.path if Path(each).is_absolute()])
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _START, path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            bufsize=0,
            start_new_session=True,  # so that a Ctrl-C reaches this process only
        )

    def answer(self, request: bytes, look: Callable[[], None]) -> Any:
        """Return the answer to a pickled CompileRequest; None: the process gave none, and has been ended.

        `look` is called every 0.1 s meanwhile. Raises CompileError where the process was ended from outside, and
        what `look` raises.
        """
        answer = None
        try:
            answer = self._answer(request, look)
            return answer
        finally:
            if answer is None:
                self.end()

    def _answer(self, request: bytes, look: Callable[[], None]) -> Any:
        """Send a request and return its answer; None: the process ended by itself. Raises as `answer` does."""
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        os.set_blocking(stdin.fileno(), False)
        poll = select.poll()
        poll.register(stdin, select.POLLOUT)
        poll.register(stdout, select.POLLIN)
        rest, received = memoryview(_LENGTH.pack(len(request)) + request), b""
        while len(received) < _LENGTH.size or len(received) < _LENGTH.size + _LENGTH.unpack_from(received)[0]:
            ready = dict(poll.poll(1e3 * _LOOK_S))
            if not ready:
                look()
            if stdin.fileno() in ready:
                try:
                    rest = rest[os.write(stdin.fileno(), rest) :]
                except BrokenPipeError:  # it has ended, as its return code tells
                    rest = rest[:0]
                if not rest:
                    poll.unregister(stdin)
            if stdout.fileno() in ready:
                part = stdout.read(1 << 20)
                received += part
                if not part:
                    code = self._process.wait()
                    if code < 0:
                        raise CompileError(f"the compiler's process was ended from outside (signal {-code})")
                    return None
        return pickle.loads(received[_LENGTH.size :])

    def end(self) -> None:
        """End the compiler's process."""
        with self._process:  # closes its pipes and waits
            self._process.kill()


class _Kept:
    """Compiler process that is kept between requests within `sharing`."""

    users = 0
    compiler: _Compiler | None = None

    @classmethod
    def taken(cls) -> _Compiler | None:
        """Return the kept process, which is then kept no longer; None if there is none."""
        compiler, cls.compiler = cls.compiler, None
        return compiler

    @classmethod
    def keep(cls, compiler: _Compiler) -> None:
        """Keep a process for the next request, or end it if there is no `sharing` context."""
        if cls.users:
            cls.compiler = compiler
        else:
            compiler.end()


@contextlib.contextmanager
def sharing() -> Iterator[None]:
    """Context in which one process compiles all entry points.

    The process infers the types of a helper once, and lowers it once, for all entry points that call it.
    """
    _Kept.users += 1
    try:
        yield
    finally:
        _Kept.users -= 1
        if not _Kept.users and (compiler := _Kept.taken()) is not None:
            compiler.end()


# The process of a parent that was forked is the parent's.
os.register_at_fork(after_in_child=_Kept.taken)


def compile_apart(request: CompileRequest, look: Callable[[], None]) -> Any:
    """Return the result of `building.make_here` from a separate process; None where only this one can compile.

    `look` is called every 0.1 s meanwhile, and may raise. Raises CompileError where the process was ended from
    outside.
    """
    try:
        asked = pickle.dumps(request)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    compiler, answer = _Kept.taken(), None
    if compiler is not None:
        with contextlib.suppress(CompileError):  # it ends with the thread that has started it
            answer = compiler.answer(asked, look)
    if answer is None:
        # One that has served others may have been started before a folder was on the path, or a file was edited.
        try:
            compiler = _Compiler()
        except (OSError, ValueError):
            return None
        answer = compiler.answer(asked, look)
    if answer is not None:
        assert compiler is not None
        _Kept.keep(compiler)
    return answer


def main() -> int:
    """Run the compiler's process: answer requests until its input ends, then end the process itself."""
    ctypes.CDLL(None).prctl(_PDEATHSIG, signal.SIGKILL, 0, 0, 0)  # ends with its parent, as nobody waits then
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb", buffering=0)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    while head := _taken(sys.stdin.buffer, _LENGTH.size):
        _put(answers, pickle.dumps(_made(_taken(sys.stdin.buffer, *_LENGTH.unpack(head)))))
    os._exit(0)  # a regular exit would take a while


def _made(request: bytes) -> Any:
    """Return the answer to a pickled CompileRequest; None where only the caller can compile or report errors."""
    with contextlib.suppress(Exception):
        asked: CompileRequest = pickle.loads(request)
        if building.key_of(asked.function) == asked.key:
            return building.make_here(asked.function, asked.kinds)
    return None


def _taken(stream: IO[bytes], count: int) -> bytes:
    """Return `count` bytes of a stream; b"" at its end."""
    taken = stream.read(count)
    return taken if len(taken) == count else b""


def _put(stream: IO[bytes], message: bytes) -> None:
    """Write a message to a stream, preceded by its length."""
    rest = memoryview(_LENGTH.pack(len(message)) + message)
    while rest:
        rest = rest[stream.write(rest) :]
