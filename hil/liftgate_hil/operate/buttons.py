"""The driver's buttons, as a rig's [requests] and [reset] define them, pressed while a run goes on."""

from __future__ import annotations

import contextlib
import math

from liftgate_hil.config.restbus import Press
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError
from liftgate_hil.operate.loop_target import Target


class ButtonPresser:
    """Presses a rig's buttons, and releases them after their hold time."""

    def __init__(self, rig: Rig, target: Target) -> None:
        self._rig, self._target = rig, target
        self._pressed: dict[str, tuple[float, Press]] = {}  # by signal, until when [s]

    @property
    def next_release(self) -> float:
        """Time [s] of the next release of a button; inf: no button is pressed."""
        return min((when for when, _ in self._pressed.values()), default=math.inf)

    def request(self, action: str, now: float) -> None:
        """Press the button for open, close, stop or reset at `now` [s], or reset directly. Raises ConfigError."""
        driver = self._rig.driver
        press = driver.buttons.get(action)
        if action == "reset" and driver.reset is not None:
            press = driver.reset.press
            if press is None:
                self._target.reset()
                return
        if press is None:
            where = "[reset]" if action == "reset" else f"[requests] {action}"
            raise ConfigError(f"request {action}; allowed with {where} in the rig {self._rig.source}")
        self._target.set_signals({press.signal: press.value}, rest=press.rest)
        self._pressed[press.signal] = (now + press.hold, press)

    def release(self, now: float) -> None:
        """Release the buttons whose hold time is over at a time [s]."""
        for signal, (when, press) in list(self._pressed.items()) if self._pressed else ():
            if now >= when - 1e-9:
                with contextlib.suppress(ConfigError):  # no room now: then at the next call
                    own = {"instead_of": press.value, "rest": press.rest}
                    self._target.set_signals({signal: math.nan}, **own)
                    del self._pressed[signal]

    def has(self, signal: str) -> bool:
        """Whether the button of a signal is pressed."""
        return signal in self._pressed

    def forget(self, signal: str) -> None:
        """Cancel the release of a button whose signal was set to another value, which stays."""
        self._pressed.pop(signal, None)
