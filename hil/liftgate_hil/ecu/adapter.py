"""Adapters that connect an ECU of any kind to the closed loop.

An adapter provides the loop with a `Node` and its `NodeState`. The compiled episode calls the node from machine
code; `peer.Peer` calls the same node for the loops that run on a bus. `find.adapter_for` returns the adapter of an
ECU.
"""

from __future__ import annotations

import hashlib
from types import TracebackType
from typing import TYPE_CHECKING

from liftgate_hil.ecu import wire
from liftgate_hil.ecu.calibration import CALIBRATED, Calibration
from liftgate_hil.ecu.events import Event, events_since
from liftgate_hil.ecu.memory import command_course, note_course
from liftgate_hil.ecu.node import NO_ECU, PORT, REFERENCE, Node, NodeState
from liftgate_hil.ecu.reference import check_rig, ecu_config, last_frames, new_ecu
from liftgate_hil.ecu.status import begin_cycle

if TYPE_CHECKING:
    from liftgate_hil.codec.frames import Frames
    from liftgate_hil.config.rig import Rig


class Adapter:
    """Base class of adapters for an ECU in this process; used alone, it is no ECU, and its bus is silent.

    Use it as a context manager, or call `close`.
    """

    kind = NO_ECU
    request_name = "request"  # of its function for requests, as its developer writes it

    def __init__(
        self, rig: Rig, drives: int, shares_clock: bool = True, calibration: Calibration = CALIBRATED
    ) -> None:
        config = ecu_config(rig, drives, calibration)
        self.shares_clock = shares_clock  # ECU time is the gate's, else it begins when the gate is first heard
        self._began = 0.0  # s of the ECU's clock, from which the times of events count
        self.in_flight = 0  # frames that it had sent at that time, and that the gate will not receive
        self.node = Node(self.kind, config, wire.NO_PORT)
        self.state = NodeState(new_ecu(config, shares_clock), wire.new_port_state())

    def __enter__(self) -> Adapter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def events(self, since: int = 0) -> list[Event]:
        """Return the ECU's events after the first `since` ones; the base class reports none."""
        return []

    def begins_anew(self, time: float, in_flight: int) -> None:
        """Count event times from a time [s] of the ECU's clock; `in_flight`: its frames on the bus then, lost."""
        self._began, self.in_flight = time, in_flight

    def failure(self) -> str:
        """Return as text why the last call of the ECU's code failed."""
        answer = int(self.state.port.head.answer[0])
        if answer:
            return f"its step returned {answer}; allowed: 0 to {wire.CAPACITY} frames"
        return (
            "it wrote an invalid frame; allowed: a length of up to 8 bytes, with CAN FD 64; an identifier of "
            "11 bits, with LIFTGATE_ID_EXTENDED 29"
        )

    def dropped(self) -> int:
        """Return the number of received frames dropped so far because the ECU's inbox was full."""
        return int(self.state.port.head.dropped[0])

    def digest(self) -> str:
        """Return a digest (SHA-256) of the ECU's whole memory; "": unknown, as of a foreign ECU."""
        return ""

    def command_digest(self) -> str:
        """Return a digest (SHA-256) of all commands that the ECU has sent so far; "": unknown."""
        return ""

    def last_frames(self) -> Frames | None:
        """Return the frames that the ECU sends last, when it is switched off; None: it sends none."""
        return None

    def takes(self, action: str) -> bool:
        """Whether the ECU accepts a request: open, close, stop or reset."""
        return action == "reset" or self.node.kind != PORT or self.node.port.request != 0

    def reset(self) -> None:
        """Reset the ECU to the state in which it is switched on. Raises EcuError."""
        self.state = NodeState(new_ecu(self.node.reference, self.shares_clock), wire.new_port_state())

    def close(self) -> None:
        """Release the resources of the adapter."""


class ReferenceEcu(Adapter):
    """Adapter of the reference ECU."""

    kind = REFERENCE

    def __init__(
        self, rig: Rig, drives: int, shares_clock: bool = True, calibration: Calibration = CALIBRATED
    ) -> None:
        check_rig(rig, drives)
        super().__init__(rig, drives, shares_clock, calibration)

    def begins_anew(self, time: float, in_flight: int) -> None:
        """Count event times from a time [s] of the ECU's clock, and discard the events so far."""
        super().begins_anew(time, in_flight)
        control = self.state.reference.memory.control
        control.events[:] = control.noted[:] = 0

    def events(self, since: int = 0) -> list[Event]:
        """Return the ECU's events after the first `since` ones, as far as its ring buffer still holds them."""
        found = events_since(self.state.reference.memory, since)
        return [each._replace(time=each.time - self._began) for each in found]

    def reset(self) -> None:
        """Reset the ECU; its events and, as in non-volatile memory, its trouble codes are kept."""
        before = self.state.reference.memory
        note_course(before, True)  # the reset clears learned loads that are not in the course yet
        super().reset()
        after = self.state.reference.memory
        after.events[:] = before.events
        after.course[:] = before.course
        after.control.events[:] = after.control.noted[:] = before.control.events
        after.control.began_ns[:] = before.control.began_ns
        after.statuses[:] = before.statuses
        begin_cycle(after.statuses)

    def digest(self) -> str:
        """Return a digest of the ECU's memory: state, learned loads, timers, events, trouble codes and course."""
        return hashlib.sha256(b"".join(each.tobytes() for each in self.state.reference.memory)).hexdigest()

    def command_digest(self) -> str:
        """Return a digest of the commands in all control cycles so far."""
        return hashlib.sha256(command_course(self.state.reference.memory).tobytes()).hexdigest()

    def last_frames(self) -> Frames | None:
        """Return the ECU's command frames with the motors off, which it sends last."""
        frames: Frames = last_frames(self.node.reference, self.state.reference)
        return frames
