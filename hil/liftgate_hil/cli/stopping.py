"""Ctrl-C and SIGTERM: a run ends in order, and what hangs ends all the same."""

from __future__ import annotations

import atexit
import os
import signal
import threading
import time
from types import FrameType

from liftgate_hil.ecu.foreign import FOREIGN, NoAnswerError
from liftgate_hil.errors import LiftgateError

_PATIENCE_S = 1.0  # for an ECU's code to return after a stop; after that another signal ends the process
_LOOK_S = 0.2
_HANG_S = 1.5  # the same for an ECU in machine code


def interrupt(number: int, frame: FrameType | None) -> None:
    """Handle Ctrl-C without StopSignals: raise KeyboardInterrupt, or end the process during an import.

    Python cannot raise everywhere in an import, and nothing has been started then.
    """
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        frame = frame.f_back
    raise KeyboardInterrupt


class StoppedError(LiftgateError):
    """Raised where something failed after a stop; `exit_code` is that of the stop."""

    def __init__(self, text: str, exit_code: int) -> None:
        self.exit_code = exit_code
        super().__init__(text)


class StopSignals:
    """Flag that is set by Ctrl-C and SIGTERM, whose handlers it installs; called, it returns whether it is set.

    Further signals within a second count as the same one, since impatient users send them twice, as do a terminal
    and a service manager together; later ones end the process at once. A call of an ECU's Python code that takes
    that long is aborted, because it must return before the run can end.
    """

    def __init__(self) -> None:
        self.received = 0  # number of the signal; 0: none
        self._since = 0.0
        self._call = 0  # number of the call of the ECU's code, at the last check
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._set)

    def __call__(self) -> bool:
        """Whether the program was asked to stop."""
        return self.received != 0

    @property
    def name(self) -> str:
        """Name of the signal, SIGINT or SIGTERM; empty where there was none."""
        return signal.Signals(self.received).name if self.received else ""

    @property
    def exit_code(self) -> int:
        """Exit code of a command that was stopped before its end."""
        return 128 + self.received

    def end_machine_code(self) -> None:
        """Start a thread that ends the process if it has not ended by itself 1.5 s after a stop signal.

        While an ECU's machine code hangs in this thread, no Python signal handler can run.
        """
        heard, write_end = os.pipe()
        os.set_blocking(write_end, False)
        signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
        threading.Thread(target=_end_after, args=(heard,), name="end", daemon=True).start()

    def failure(self, text: str) -> LiftgateError:
        """Return an error with this text; after a stop signal it has the exit code of the stop."""
        return StoppedError(text, self.exit_code) if self.received else LiftgateError(text)

    def _set(self, number: int, frame: FrameType | None) -> None:
        """Handle a stop signal: the first sets the flag, one more than a second later ends the process."""
        now = time.monotonic()
        if self.received:
            if now - self._since > _PATIENCE_S:
                os.write(2, b"liftgate-hil: stopped again: ended at once\n")
                signal.signal(number, signal.SIG_DFL)
                signal.raise_signal(number)
            return
        self.received, self._since, self._call = number, now, FOREIGN.call()
        signal.signal(signal.SIGALRM, self._look)
        atexit.register(_ignore_further_signals)
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE_S, _LOOK_S)

    def _look(self, number: int, frame: FrameType | None) -> None:
        """Handle the timer: raise NoAnswerError in ECU Python code that has not returned since the last check."""
        call = FOREIGN.call()
        if call and call == self._call:
            raise NoAnswerError
        self._call = call
        if not call:
            signal.setitimer(signal.ITIMER_REAL, 0.0)


def _ignore_further_signals() -> None:
    """Ignore further signals while Python exits: without its handlers they would change the exit code."""
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _end_after(heard: int) -> None:
    """End the process 1.5 s after the number of a stop signal was read from the pipe `heard`."""
    number = 0
    while number not in (signal.SIGINT, signal.SIGTERM):
        number = os.read(heard, 1)[0]
    time.sleep(_HANG_S)
    os.write(2, b"liftgate-hil: the ECU: no response to the request to stop\n")
    os._exit(128 + number)
