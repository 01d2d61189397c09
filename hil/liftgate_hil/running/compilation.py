"""Reporting of compilations to a listener; a stop of the run ends them."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from liftgate_hil.errors import LiftgateError
from liftgate_hil.loop.listener import Listener
from liftgate_plant import compiler


class EntryPoint(NamedTuple):
    """Entry point of machine code: its module, and its name in messages to the user."""

    module: str
    called: str


# All entry points, by the names of their functions.
ENTRY_POINTS = {
    "run_realtime": EntryPoint("liftgate_hil.loop.realtime_loop", "real-time loop"),
    "run_stretch": EntryPoint("liftgate_hil.loop.closed_loop", "closed loop"),
    "scheduled_tick": EntryPoint("liftgate_hil.loop.python_loop", "loop on a bus"),
    "turn": EntryPoint("liftgate_hil.ecu.node", "ECU's side of the bus"),
    "block": EntryPoint("liftgate_hil.loop.simulation", "simulation"),
    "run": EntryPoint("liftgate_hil.identify.trajectory", "identification model"),
    "walk": EntryPoint("liftgate_hil.measurement.walk", "reader of bus logs"),
    "judge_block": EntryPoint("liftgate_hil.judging.table", "judge"),
    "note_wakeups": EntryPoint("liftgate_hil.loop.wakeups", "lateness measurement"),
    "put_lines": EntryPoint("liftgate_hil.formats.csv_text", "CSV text"),
    "put_messages": EntryPoint("liftgate_hil.formats.mcap_text", "MCAP text"),
    "play": EntryPoint("liftgate_hil.replay.player", "replay"),
    "note_truths": EntryPoint("liftgate_hil.running.recording_trigger", "trigger of the recording"),
}


def function_of(name: str) -> Callable[..., Any]:
    """Return the function of an entry point."""
    function: Callable[..., Any] = getattr(importlib.import_module(ENTRY_POINTS[name].module), name)
    return function


def _called(name: str) -> str:
    return ENTRY_POINTS[name].called if name in ENTRY_POINTS else name


class _Watcher(compiler.Watcher):
    """Reports compilations to a listener, and gives them up when the run is stopped."""

    def __init__(self, listener: Listener, stopped: Callable[[], bool]) -> None:
        self._listener = listener
        self._stopped = stopped
        self._expected: float | None = None  # s, duration of the present compilation
        self._own = ""  # the entry point that this process compiles

    def compiles(self, name: str, seconds: float) -> None:
        """Report that an entry point is being compiled, for `seconds` so far."""
        if self._stopped():
            raise compiler.GivenUpError
        if seconds == 0.0:
            self._expected = compiler.expected_s(name)
        self._own = name
        what = f"compiling the {_called(name)}"
        self._listener.compiles(what, seconds, self._expected)

    def waits(self, name: str, seconds: float) -> None:
        """Report that another process compiles the entry point, for `seconds` so far."""
        if self._stopped():
            raise compiler.GivenUpError
        what = f"waiting for another process to compile the {_called(name)}"
        self._listener.compiles(what, seconds, None)

    def ready(self, name: str, seconds: float) -> None:
        """Report that the entry point is ready, and note how long it took to compile here."""
        if self._own == name:
            compiler.note_duration(name, seconds)
            self._own = ""
        self._listener.compiled(_called(name), seconds)

    def not_kept(self, why: str) -> None:
        """Report why machine code is not kept on disk."""
        self._listener.say(f"machine code is not cached: {why}")


@contextlib.contextmanager
def reporting_compilation(listener: Listener, stopped: Callable[[], bool] = lambda: False) -> Iterator[None]:
    """Context in which compilations are reported to a listener; GivenUpError ends them when it is `stopped`.

    Raises LiftgateError where the compiler's process was killed from outside, or numba is not a known version.
    """
    watcher = _Watcher(listener, stopped)
    compiler.watch(watcher)
    try:
        yield
    except compiler.CompileError as error:
        raise LiftgateError(str(error)) from None
    finally:
        compiler.unwatch(watcher)
