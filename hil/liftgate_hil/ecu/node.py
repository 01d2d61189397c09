"""The reference ECU on a bus: the same rig as the emulator's, seen from the other side."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.codec.receive import NO_COUNTS, nothing_received, receive
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.codec.transmit import encode
from liftgate_hil.config.rig import COMMANDS, Rig
from liftgate_hil.ecu.controller import Controller, DriveCommand, Feedback
from liftgate_hil.signals import BUS_INPUTS, IN, OUT, OUTPUT_COUNT
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.transport.base import Transport

_SIDES = ("left", "right")
_HOME_DEG = 0.0
_OPEN, _CLOSE, _BRAKE, _COAST = 1.0, 2.0, 3.0, 0.0


class EcuNode:
    """Polls its transport; once a cycle it computes a command and sends it."""

    def __init__(
        self,
        rig: Rig,
        transport: Transport,
        controller: Controller,
        drives: int,
        requests: Sequence[Request] = (),
    ) -> None:
        self.controller = controller
        self.elapsed = 0.0  # s since the gate was first heard; requests count from there
        self._transport = transport
        self._sides = _SIDES[:drives]
        self._requests = list(requests)
        self._inputs: BusConfig = rig.output_config(sending=False)
        self._outputs: BusConfig = rig.input_config(sending=False)
        self._has_latch = "latch_state" in {wire.quantity for wire in rig.outputs}
        self._signed = "left_direction" not in {wire.quantity for wire in rig.inputs}
        self._commands = _command_rows(rig, self._outputs)
        self._reception = nothing_received(self._inputs, OUTPUT_COUNT)
        self._counts = NO_COUNTS
        self._sent = 0
        self._cycle_ns = round(rig.command_cycle_ms() * 1e6)
        self._next_ns = 0
        self._start_ns: int | None = None

    def poll(self, now_ns: int) -> None:
        """Take what has come; send a command where one is due."""
        self._reception, self._counts = receive(
            self._inputs, self._reception, self._counts, self._transport.receive(), now_ns
        )
        if now_ns < self._next_ns:
            return
        self._next_ns += self._cycle_ns * (1 + (now_ns - self._next_ns) // self._cycle_ns)
        feedback = self._feedback()
        if feedback is None:  # nothing heard yet
            self._send(DriveCommand([None] * len(self._sides)))
            return
        if self._start_ns is None:
            self._start_ns = now_ns
        now = self.elapsed = (now_ns - self._start_ns) * 1e-9
        command = self.controller.update(now, feedback)
        while self._requests and self._requests[0].time <= now:
            self.controller.request(self._requests.pop(0).action)
        self._send(command)

    def finish(self) -> None:
        """The last frame says motors off."""
        self._send(DriveCommand([None] * len(self._sides)))

    def _value(self, name: str) -> float:
        return float(self._reception.values[getattr(OUT, name)])

    def _feedback(self) -> Feedback | None:
        currents = [self._value(f"{side}_current") for side in self._sides]
        counts = [self._value(f"{side}_hall_count") for side in self._sides]
        latched = self._latched()
        if any(math.isnan(value) for value in (*currents, *counts, latched)):
            return None
        voltage = self._value("terminal_voltage")
        return Feedback(currents, counts, latched > 0.5, 12.0 if math.isnan(voltage) else voltage)

    def _latched(self) -> float:
        """The latch switch; a rig without one has the angle say when the gate is home."""
        if self._has_latch:
            return self._value("latch_state")
        angle = self._value("gate_angle")
        return float(angle <= _HOME_DEG)  # an angle that is not there is not home

    def _send(self, command: DriveCommand) -> None:
        values = np.full(len(BUS_INPUTS), np.nan)
        for side, duty in zip(self._sides, command.duties, strict=True):
            direction = _COAST if duty is None else _BRAKE
            if duty:
                direction = _OPEN if duty > 0.0 else _CLOSE
            percent = 100.0 * (duty or 0.0)
            values[getattr(IN, f"{side}_duty")] = percent if self._signed else abs(percent)
            values[getattr(IN, f"{side}_direction")] = direction
        values[IN.latch_release] = 1.0 if command.latch_release else 0.0
        frames = empty_frames(len(self._commands))
        for row, message in enumerate(self._commands):
            encode(self._outputs, message, values, self._sent, frames, row)
        self._sent += 1
        self._transport.send(frames._replace(count=len(self._commands)))


def _command_rows(rig: Rig, bus: BusConfig) -> list[int]:
    """The messages that an ECU sends; the test bench's are not its own."""
    names = list(dict.fromkeys(wire.message for wire in rig.inputs))
    ours = {wire.message for wire in rig.inputs if wire.quantity in (*COMMANDS, "latch_release")}
    return [row for row, name in enumerate(names) if name in ours]
