"""A listener that is told of compilations, which end when the run is stopped."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from liftgate_hil.errors import LiftgateError
from liftgate_hil.listener import Listener
from liftgate_plant import compiler

# What entry points are called where users read of them.
_CALLED = {
    "run_realtime": "real-time loop",
    "run_stretch": "closed loop",
    "scheduled_tick": "loop on a bus",
    "turn": "ECU's side of the bus",
    "block": "simulation",
    "run": "model of identification",
    "walk": "reading of bus logs",
    "note_wakeups": "measurement of lateness",
    "put_lines": "CSV text",
    "put_messages": "MCAP text",
    "play": "replay",
    "note_truths": "trigger of the recording",
}


class _Watcher(compiler.Watcher):
    """Tells a listener of compilations, and gives them up when the run is stopped."""

    def __init__(self, listener: Listener, stopped: Callable[[], bool]) -> None:
        self._listener = listener
        self._stopped = stopped
        self._expected: float | None = None  # s, of what is being compiled
        self._own = ""  # what this process compiles

    def compiles(self, name: str, seconds: float) -> None:
        """See Watcher."""
        if self._stopped():
            raise compiler.GivenUpError
        if seconds == 0.0:
            self._expected = compiler.expected_s(name)
        self._own = name
        told = f"compiling the {_CALLED.get(name, name)}"
        self._listener.compiles(told, seconds, self._expected)

    def waits(self, name: str, seconds: float) -> None:
        """See Watcher."""
        if self._stopped():
            raise compiler.GivenUpError
        told = f"waiting for another process to compile the {_CALLED.get(name, name)}"
        self._listener.compiles(told, seconds, None)

    def ready(self, name: str, seconds: float) -> None:
        """See Watcher."""
        if self._own == name:
            compiler.note_duration(name, seconds)
            self._own = ""
        self._listener.compiled(_CALLED.get(name, name), seconds)

    def not_kept(self, why: str) -> None:
        """See Watcher."""
        self._listener.say(f"machine code is not kept: {why}")


@contextlib.contextmanager
def told_of_compiling(
    listener: Listener, stopped: Callable[[], bool] = lambda: False
) -> Iterator[None]:
    """Within it a listener is told of compilations, which GivenUpError ends when it is `stopped`.

    Raises LiftgateError where another ends a compilation.
    """
    watcher = _Watcher(listener, stopped)
    compiler.watch(watcher)
    try:
        yield
    except compiler.CompileError as error:
        raise LiftgateError(str(error)) from None
    finally:
        compiler.unwatch(watcher)
