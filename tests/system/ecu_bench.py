"""A kinematic gate on a bus of frames in memory, with an ECU library."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cantools
from c_ecu import Frame, LibraryEcu
from hil_support import COMMAND, GATE, LEFT_DRIVE, RIGHT_DRIVE, j1850, with_checksum

DATABASE = cantools.database.load_file(Path(__file__).parents[2] / "dbc" / "liftgate.dbc")
MS = 1_000_000
END_STOP = 2000.0  # counts
FULL_SPEED = 620.0  # counts/s


def drive(identifier: int, current: float, count: int, alive: int = 0) -> Frame:
    name = "LeftDrive" if identifier == LEFT_DRIVE else "RightDrive"
    signals = {"MotorCurrent": current, "HallCount": count, "HallSpeed": 0}
    payload = DATABASE.encode_message(name, {**signals, "AliveCounter": alive % 16, "Checksum": 0})
    return Frame(identifier, with_checksum(identifier, payload))


def gate_frame(latched: bool) -> Frame:
    signals = {"Angle": 0.0, "LatchState": int(latched), "TerminalVoltage": 12.0}
    return Frame(GATE, DATABASE.encode_message("Gate", signals))


def whole_gate(current: float, count: int, latched: bool) -> list[Frame]:
    drives = [drive(identifier, current, count) for identifier in (LEFT_DRIVE, RIGHT_DRIVE)]
    return [*drives, gate_frame(latched)]


def decode(frame: Frame) -> dict[str, float]:
    """Decode a DriveCommand after checking its frame."""
    assert (frame.identifier, len(frame.data), frame.flags) == (COMMAND, 8, 0)
    assert frame.data[7] == j1850(COMMAND, frame.data, 7)
    return dict(DATABASE.decode_message(COMMAND, frame.data, decode_choices=False))


def duty_of(frame: Frame) -> float:
    """Signed duty of a command; asserts that both drives get the same."""
    signals = decode(frame)
    assert signals["LeftDuty"] == signals["RightDuty"]
    assert signals["LeftDirection"] == signals["RightDirection"]
    return {0: 0.0, 1: 0.01, 2: -0.01}[signals["LeftDirection"]] * signals["LeftDuty"]


class Gate:
    """Gate that moves in proportion to the duty and latches; below the count `trap` an obstacle resists."""

    def __init__(self, count: float = 0.0, trap: float | None = None) -> None:
        self.count = count
        self.latched = count == 0.0
        self.trap = trap
        self._duty = 0.0
        self._release = False

    def take(self, command: Frame) -> None:
        self._duty = duty_of(command)
        self._release = decode(command)["LatchRelease"] == 1

    def advance(self, seconds: float) -> None:
        self.latched = self.latched and not self._release
        if not self.latched:
            count = self.count + FULL_SPEED * self._duty * seconds
            self.count = min(max(count, 0.0), END_STOP)
            self.latched = count <= 0.0 and not self._release

    def frames(self) -> list[Frame]:
        trapped = self._duty < 0.0 and self.trap is not None and self.count < self.trap
        current = -5.0 if trapped else 1.5 * (self._duty > 0.0) - 1.5 * (self._duty < 0.0)
        return whole_gate(current, round(self.count), self.latched)


class Bench:
    """An ECU and a gate that sends every 5 ms; `noise` goes before and after its frames."""

    def __init__(self, ecu: LibraryEcu, gate: Gate, noise: Sequence[Frame] = (), tick_ns: int = MS) -> None:
        self.ecu, self.gate, self.noise = ecu, gate, noise
        self.now_ns = 0
        self._tick_ns = tick_ns
        self.sent: list[tuple[int, Frame]] = []

    def run(self, seconds: float) -> None:
        end = self.now_ns + round(seconds * 1e9)
        while self.now_ns < end:
            is_due = self.now_ns % (5 * MS) < self._tick_ns
            frames = [*self.noise, *self.gate.frames(), *self.noise] if is_due else []
            for frame in self.ecu.step(self.now_ns, frames):
                self.sent.append((self.now_ns, frame))
                self.gate.take(frame)
            self.gate.advance(self._tick_ns * 1e-9)
            self.now_ns += self._tick_ns

    def press(self, action: int, then: float) -> None:
        self.ecu.request(action)
        self.run(then)

    def duties(self, start: float = 0.0) -> list[float]:
        return [duty_of(frame) for now, frame in self.sent if now >= start * 1e9]
