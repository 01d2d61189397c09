"""What connects an ECU to the closed loop, whatever it is.

An adapter gives the loop a `Node` and its `NodeState`; the compiled episode calls it from machine code,
`peer.Peer` calls the same node for the loops that run on a bus. `find.adapter_for` knows which adapter is meant.
"""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING

from liftgate_hil.ecu import wire
from liftgate_hil.ecu.calibration import CALIBRATED, Calibration
from liftgate_hil.ecu.events import Event, events_since
from liftgate_hil.ecu.needs import check_rig
from liftgate_hil.ecu.node import NO_ECU, PORT, REFERENCE, Node, NodeState
from liftgate_hil.ecu.reference import ecu_config, last_frames, new_ecu
from liftgate_hil.ecu.status import begin_cycle

if TYPE_CHECKING:
    from liftgate_hil.codec.frames import Frames
    from liftgate_hil.config.rig import Rig


class Adapter:
    """An ECU in this process; this one is no ECU at all, a silent bus. Use it as a context, or `close` it."""

    kind = NO_ECU

    def __init__(
        self,
        rig: Rig,
        drives: int,
        shares_clock: bool = True,
        calibration: Calibration = CALIBRATED,
    ) -> None:
        config = ecu_config(rig, drives, calibration)
        self.shares_clock = (
            shares_clock  # its time is the gate's, else begins when the gate is heard
        )
        self._began = 0.0  # s
        self.node = Node(self.kind, config, wire.NO_PORT)
        self.state = NodeState(new_ecu(config, shares_clock), wire.new_port_state())

    def __enter__(self) -> Adapter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def events(self, told: int = 0) -> list[Event]:
        """What the ECU has told after the first `told`, as far as it tells anything."""
        return []

    def begins_anew(self, time: float) -> None:
        """What it tells from now on counts from a time [s] of its clock."""
        self._began = time

    def failure(self) -> str:
        """Why a turn of the ECU went wrong."""
        answer = int(self.state.port.head.answer[0])
        if answer:
            return f"its step returned {answer}; allowed: 0 to {wire.CAPACITY} frames"
        return "it wrote a frame that is none; allowed: a length of up to 8 bytes, with CAN FD 64"

    def dropped(self) -> int:
        """Frames for which it had no room so far."""
        return int(self.state.port.head.dropped[0])

    def last_frames(self) -> Frames | None:
        """What it sends when it is switched off."""
        return None

    def takes(self, action: str) -> bool:
        """Whether the driver can ask for open, close, stop or reset here."""
        return action == "reset" or self.node.kind != PORT or self.node.port.request != 0

    def reset(self) -> None:
        """Make the ECU anew, as one that is switched on. Raises EcuError."""
        self.state = NodeState(
            new_ecu(self.node.reference, self.shares_clock), wire.new_port_state()
        )

    def close(self) -> None:
        """Give back what it holds."""


class ReferenceEcu(Adapter):
    """Our own."""

    kind = REFERENCE

    def __init__(
        self,
        rig: Rig,
        drives: int,
        shares_clock: bool = True,
        calibration: Calibration = CALIBRATED,
    ) -> None:
        check_rig(rig, drives)
        super().__init__(rig, drives, shares_clock, calibration)

    def begins_anew(self, time: float) -> None:
        """See Adapter."""
        super().begins_anew(time)
        control = self.state.reference.memory.control
        control.events[:] = control.noted[:] = 0

    def events(self, told: int = 0) -> list[Event]:
        """See Adapter."""
        found = events_since(self.state.reference.memory, told)
        return [each._replace(time=each.time - self._began) for each in found]

    def reset(self) -> None:
        """See Adapter; what it has told stays told, and its trouble codes are kept without supply."""
        before = self.state.reference.memory
        super().reset()
        after = self.state.reference.memory
        after.events[:] = before.events
        after.control.events[:] = after.control.noted[:] = before.control.events
        after.control.began_ns[:] = before.control.began_ns
        after.statuses[:] = before.statuses
        begin_cycle(after.statuses)

    def last_frames(self) -> Frames | None:
        """See Adapter."""
        frames: Frames = last_frames(self.node.reference, self.state.reference)
        return frames
