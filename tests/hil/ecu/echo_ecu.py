"""ECUs in Python for the tests of adapters; `echo.c` has the same ones in C."""

from __future__ import annotations

import can
import cantools
from hil_support import both, command_payload, shipped_rig

ECHO_STEPS, ECHO_REQUEST = 0x6F0, 0x700
_ACTIONS = ("stop", "open", "close")


class Echo:
    """An ECU that sends back each frame with a 29-bit identifier; reports at time 0 how many steps it had
    made before, and each request with the time of its next step.
    """

    period_s: float | None = 0.001

    def __init__(self) -> None:
        self.steps = 0
        self._requests: list[str] = []

    def request(self, action: str) -> None:
        """Take a request of the driver."""
        self._requests.append(action)

    def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
        """Make a step, as in the interface of a Python ECU."""
        sent = [
            can.Message(arbitration_id=frame.arbitration_id, is_extended_id=True, data=frame.data)
            for frame in frames
        ]
        now = round(now_s * 1e9).to_bytes(8, "little")
        for action in self._requests:
            identifier = ECHO_REQUEST + _ACTIONS.index(action)
            sent.append(can.Message(arbitration_id=identifier, is_extended_id=False, data=now))
        self._requests.clear()
        if now_s == 0.0:
            steps = self.steps.to_bytes(4, "little")
            sent.append(can.Message(arbitration_id=ECHO_STEPS, is_extended_id=False, data=steps))
        self.steps += 1
        return sent


class Opener:
    """A minimal ECU: drives with 60 % duty after a request to open, else coasts; keeps the gate's angles [deg]."""

    def __init__(self) -> None:
        self._rig = shipped_rig()
        self._database = cantools.database.load_file(self._rig.database)
        self._is_opening = False
        self._sent = 0
        self.angles: list[float] = []

    def request(self, action: str) -> None:
        """Take a request of the driver."""
        self._is_opening = action == "open"

    def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
        """Make a step, as in the interface of a Python ECU."""
        gate = self._database.get_message_by_name("Gate")
        self.angles += [
            gate.decode(frame.data)["Angle"] for frame in frames if frame.arbitration_id == gate.frame_id
        ]  # fmt: skip
        duty = 60.0 if self._is_opening else 0.0
        payload = command_payload(
            self._rig, self._sent, **both(duty, int(self._is_opening), int(self._is_opening))
        )
        self._sent += 1
        return [can.Message(arbitration_id=0x120, is_extended_id=False, data=payload)]


class Silent:
    """An ECU that sends nothing."""

    def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
        """Make a step, as in the interface of a Python ECU."""
        return []


class Picky:
    """An ECU whose class needs an argument."""

    def __init__(self, needed: int) -> None:
        self.needed = needed
