"""Adapter of an ECU in Python: an object that machine code calls once a control cycle."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_compiler import INT_OF_LONG_INT, INT_OF_STEP
from liftgate_hil.ecu import wire
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.foreign import FOREIGN, NoAnswerError
from liftgate_hil.ecu.node import PORT
from liftgate_hil.errors import ConfigError, EcuError, place_of, shown, text_of
from liftgate_hil.stimuli.requests import ACTIONS

if TYPE_CHECKING:
    import can

    from liftgate_hil.config.rig import Rig


class PythonEcu(Adapter):
    """Adapter of an object with `step(now_s, frames) -> frames`, and optionally with `request(action)`.

    `step` is called every `period_s` (the object's own attribute, else the rig's command cycle) with all frames
    since the last call. `another` makes a new object for an ECU reset; without it the object's own `reset()` is
    called, where it has one. Messages call the ECU `name`; without it they show the object. Raises ConfigError.
    """

    kind = PORT

    def __init__(
        self,
        ecu: Any,
        rig: Rig,
        drives: int,
        shares_clock: bool = True,
        another: Callable[[], Any] | None = None,
        name: str = "",
    ) -> None:
        from liftgate_hil.transport.messages import message_of_fields

        super().__init__(rig, drives, shares_clock)
        self._ecu = ecu
        self._name = name
        self._error: BaseException | None = None
        self._reason = ""
        self._message_of = message_of_fields
        if isinstance(ecu, type) or not callable(self._attribute("step")):
            what = f"a class; its object is needed, {ecu.__name__}()" if isinstance(ecu, type) else "no step()"
            raise self._refusal(f"{what}; allowed: an object with step(now_s, frames) -> frames")
        if inspect.iscoroutinefunction(self._attribute("step")):
            raise self._refusal("its step is async; allowed: def step(now_s, frames) -> frames")
        self._request: Callable[[str], object] | None = self._attribute("request")
        period = self._attribute("period_s")
        seconds = rig.command_cycle_ms() * 1e-3 if period is None else period
        if not isinstance(seconds, int | float) or not 1e-6 <= seconds <= 60.0:
            raise self._refusal(f"period_s {shown(period)}; allowed: 1e-6 to 60 s")
        self._another = another
        self._callbacks = INT_OF_STEP(self._on_step), INT_OF_LONG_INT(self._on_request)
        step, request = (wire.address_of(each) for each in self._callbacks)
        port = wire.Port(step, request if self._request else 0, 0, round(seconds * 1e9))
        self.node = self.node._replace(port=port)

    def takes(self, action: str) -> bool:
        """Whether the ECU accepts a request; a reset requires `another` or the object's own `reset()`."""
        can_reset = self._another is not None or callable(self._attribute("reset"))
        return can_reset if action == "reset" else super().takes(action)

    def reset(self) -> None:
        """Reset the ECU: make a new object, or call the object's own `reset()`. Raises EcuError."""
        own = self._attribute("reset")
        if not self.takes("reset"):
            raise EcuError(
                f"the ECU {self._called()} cannot be reset; allowed: MODULE:CLASS, or an object with reset()"
            )
        try:
            with FOREIGN:
                if self._another is not None:
                    self._ecu = self._another()
                elif callable(own):
                    own()
        except (EcuError, NoAnswerError, KeyboardInterrupt):
            raise
        except Exception as error:  # a user's object may raise anything
            raise EcuError(
                f"the ECU's reset: {type(error).__name__}: {text_of(error)}{place_of(error)}"
            ) from error
        self._request = self._attribute("request")
        head = self.state.port.head[0]
        head.waiting = head.next_ns = 0

    def failure(self) -> str:
        """Return as text why the last call of the ECU's code failed.

        Raises KeyboardInterrupt where one reached the ECU's code: it was meant for the user who runs it.
        """
        if self._reason:
            return self._reason
        if isinstance(self._error, KeyboardInterrupt):
            raise self._error
        if isinstance(self._error, NoAnswerError):
            return f"no response to the request to stop{place_of(self._error)}"
        if self._error is not None:
            place = place_of(self._error)
            is_call = isinstance(self._error, TypeError) and not place  # which the ECU's methods do not take
            allowed = "; allowed: step(now_s, frames) and request(action)" if is_call else ""
            return f"{type(self._error).__name__}: {text_of(self._error)}{place}{allowed}"
        return super().failure()

    def close(self) -> None:
        """Release the ECU object, whose finalizer may run code."""
        with FOREIGN:
            self._ecu = self._another = self._request = None

    def _called(self) -> str:
        return self._name or shown(self._ecu)

    def _refusal(self, text: str) -> ConfigError:
        return ConfigError(f"`ecu` {self._called()}: {text}")

    def _attribute(self, attribute: str) -> Any:
        """Return an attribute of the ECU object; None: it has none. Raises ConfigError where reading it fails."""
        try:
            with FOREIGN:
                return getattr(self._ecu, attribute, None)
        except Exception as error:  # a property may raise anything
            text = f"{type(error).__name__}: {text_of(error)}{place_of(error)}"
            raise self._refusal(f"{attribute}: {text}; allowed: attributes that can be read") from error

    def _on_request(self, instance: int, action: int) -> int:
        try:
            if self._request is not None and self._error is None:
                with FOREIGN:
                    self._request(ACTIONS[action])
        except BaseException as error:  # reported after the episode has ended
            self._error = error
        return 0

    def _on_step(self, instance: int, now_ns: int, inbox: int, count: int, outbox: int, capacity: int) -> int:
        try:
            if self._error is not None:
                return wire.BAD_COUNT
            rows = self.state.port.inbox[:count].tolist()
            frames = [
                self._message_of(identifier, length, flags, data, now_ns * 1e-9)
                for identifier, length, flags, data in rows
            ]
            with FOREIGN:
                answer = self._ecu.step(now_ns * 1e-9, frames)
            return self._send(answer, capacity)
        except BaseException as error:  # reported after the episode has ended
            self._error = error
            return wire.BAD_COUNT

    def _send(self, answer: Sequence[can.Message] | None, capacity: int) -> int:
        """Write the frames that `step` returned into the outbox; return their number, or BAD_COUNT: invalid."""
        from liftgate_hil.transport.messages import NotAFrameError, fields_of

        if answer is None:
            return 0
        if not isinstance(answer, list | tuple):
            self._reason = f"its step gave {shown(answer)}; allowed: a list of can.Message, or None"
            return wire.BAD_COUNT
        if len(answer) > capacity:
            self._reason = f"its step gave {len(answer)} frames; allowed: up to {capacity}"
            return wire.BAD_COUNT
        outbox = self.state.port.outbox.view(np.ndarray)
        for place, message in enumerate(answer):
            try:
                identifier, length, flags, data = fields_of(message)
            except NotAFrameError as error:
                self._reason = f"its step gave {error}"
                return wire.BAD_COUNT
            outbox["id"][place], outbox["length"][place] = identifier, length
            outbox["format"][place] = flags
            outbox["payload"][place, : len(data)] = np.frombuffer(data, dtype=np.uint8)
        return len(answer)
