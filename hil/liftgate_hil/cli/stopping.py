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

_PATIENCE_S = 1.0  # for an ECU's code that is to stop; from then on another signal ends the process
_LOOK_S = 0.2
_HANG_S = 1.5  # for one in machine code


def interrupt(number: int, frame: FrameType | None) -> None:
    """A Ctrl-C for what has no StopSignals: a KeyboardInterrupt. While a module is imported it ends the process,
    since Python cannot raise everywhere in there; nothing has been begun then.
    """
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        frame = frame.f_back
    raise KeyboardInterrupt


class StoppedError(LiftgateError):
    """What was stopped did not end in order."""

    def __init__(self, text: str, exit_code: int) -> None:
        self.exit_code = exit_code
        super().__init__(text)


class StopSignals:
    """Ctrl-C and SIGTERM set a flag. More of them within a second are the same one, since they are sent twice by
    who is impatient, and by a terminal and a service manager each; later ones end the process as it stands.

    A call of an ECU's Python code that lasts that long is given up; it has to come back for the run to end.
    """

    def __init__(self) -> None:
        self.received = 0  # the signal's number
        self._since = 0.0
        self._call = 0  # of the ECU's code, at the last look
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._set)

    def __call__(self) -> bool:
        """Whether to stop."""
        return self.received != 0

    @property
    def name(self) -> str:
        """SIGINT or SIGTERM; empty where there was none."""
        return signal.Signals(self.received).name if self.received else ""

    @property
    def exit_code(self) -> int:
        """For what was to come to an end, and was stopped before."""
        return 128 + self.received

    def end_machine_code(self) -> None:
        """Where an ECU's machine code runs in this thread, no Python handler comes through while it hangs: another
        thread ends the process if it has not ended by itself.
        """
        heard, told = os.pipe()
        os.set_blocking(told, False)
        signal.set_wakeup_fd(told, warn_on_full_buffer=False)
        threading.Thread(target=_end_after, args=(heard,), name="end", daemon=True).start()

    def failure(self, text: str) -> LiftgateError:
        """What went wrong; after a stop it has that exit code."""
        return StoppedError(text, self.exit_code) if self.received else LiftgateError(text)

    def _set(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if self.received:
            if now - self._since > _PATIENCE_S:
                os.write(2, b"liftgate-hil: stopped again: ended at once\n")
                signal.signal(number, signal.SIG_DFL)
                signal.raise_signal(number)
            return
        self.received, self._since, self._call = number, now, FOREIGN.call()
        signal.signal(signal.SIGALRM, self._look)
        atexit.register(_ended)
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE_S, _LOOK_S)

    def _look(self, number: int, frame: FrameType | None) -> None:
        """Give up a call that is still the same one."""
        call = FOREIGN.call()
        if call and call == self._call:
            raise NoAnswerError
        self._call = call
        if not call:
            signal.setitimer(signal.ITIMER_REAL, 0.0)


def _ended() -> None:
    """What has ended in order has that exit code: Python gives its handlers up when it ends, and the alarm, or the
    same signal once more, would kill the process then.
    """
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _end_after(heard: int) -> None:
    """End the process some time after a signal has come out of a pipe."""
    number = 0
    while number not in (signal.SIGINT, signal.SIGTERM):
        number = os.read(heard, 1)[0]
    time.sleep(_HANG_S)
    os.write(2, b"liftgate-hil: the ECU: no answer when it was to stop\n")
    os._exit(128 + number)
