"""Report compilations of machine code to a listener; a stop of the run aborts them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import liftgate_compiler as compiler
from liftgate_hil.errors import LiftgateError
from liftgate_hil.loop.listener import Listener

# Names in messages, and modules, of all entry points of machine code, by their functions.
ENTRY_POINTS = {
    "run_realtime": ("real-time loop", "liftgate_hil.loop.realtime_loop"),
    "run_stretch": ("closed loop", "liftgate_hil.loop.episode"),
    "scheduled_tick": ("loop on a bus", "liftgate_hil.loop.python_loop"),
    "turn": ("ECU's side of the bus", "liftgate_hil.ecu.node"),
    "block": ("simulation", "liftgate_hil.loop.simulation"),
    "run": ("identification model", "liftgate_hil.identification.trajectory"),
    "walk": ("reader of bus logs", "liftgate_hil.measurement.walk"),
    "judge_block": ("evaluation of expectations", "liftgate_hil.judging.table"),
    "note_wakeups": ("lateness measurement", "liftgate_hil.loop.wakeups"),
    "put_lines": ("CSV text", "liftgate_hil.formats.csv_writer"),
    "play": ("replay", "liftgate_hil.playback.player"),
    "note_truths": ("trigger of the recording", "liftgate_hil.plan.recording_trigger"),
}


class _Watcher(compiler.Watcher):
    """Reports compilations to a listener, and aborts them when the run is stopped."""

    def __init__(self, listener: Listener, stopped: Callable[[], bool]) -> None:
        self._listener = listener
        self._stopped = stopped
        self._expected: float | None = None  # s, duration of the present compilation
        self._own = ""  # the entry point that this process compiles

    def compiles(self, name: str, seconds: float) -> None:
        """Report that an entry point is being compiled, for `seconds` so far."""
        if seconds == 0.0:
            self._expected = compiler.expected_s(name)
        self._own = name
        self._report("compiling", name, seconds, self._expected)

    def waits(self, name: str, seconds: float) -> None:
        """Report that another process compiles the entry point, for `seconds` so far."""
        self._report("waiting for another process to compile", name, seconds, None)

    def _report(self, doing: str, name: str, seconds: float, expected: float | None) -> None:
        if self._stopped():
            raise compiler.GivenUpError
        self._listener.compiles(f"{doing} the {_name_of(name)}", seconds, expected)

    def ready(self, name: str, seconds: float) -> None:
        """Report that the entry point is ready, and store how long [s] this process took to compile it."""
        if self._own == name:
            compiler.note_duration(name, seconds)
            self._own = ""
        self._listener.compiled(_name_of(name), seconds)

    def not_kept(self, why: str) -> None:
        """Report why machine code is not cached on disk."""
        self._listener.say(f"machine code is not cached: {why}")


def _name_of(name: str) -> str:
    return ENTRY_POINTS[name][0] if name in ENTRY_POINTS else name


@contextlib.contextmanager
def reporting_compilation(listener: Listener, stopped: Callable[[], bool] = lambda: False) -> Iterator[None]:
    """Context in which compilations are reported to a listener; `stopped` aborts them with GivenUpError.

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
