"""An ECU in Python that knows nothing but the database: cantools packs its command and unpacks what it hears.

It runs below, in the demo and on a bus; from docs/examples, where the class is:

    liftgate-hil demo --clock free --no-record --ecu python_ecu:Ecu
    liftgate-hil ecu --bus socketcan:vcan0 --ecu python_ecu:Ecu
"""

from collections.abc import Sequence
from pathlib import Path

import can
import cantools

import liftgate_hil as lh

HERE = Path(__file__).parent
DATABASE = HERE.parents[1] / "dbc" / "liftgate.dbc"
DUTY = {"open": 100.0, "close": 70.0, "brake": 0.0, "coast": 0.0}  # %
TRAPPED = 2.5  # A, mean of both motors
SEAL = 150  # Hall counts above closed: more current is no surprise there
BLANKING = 1.0  # s after a start
REVERSAL = 1.0  # s


class Ecu:
    """Opens and closes, and turns back for a second where the current says that something is trapped."""

    period_s = 0.010  # how often it is called; without it: the command's cycle in the rig

    def __init__(self) -> None:
        database = cantools.database.load_file(DATABASE)
        self._command = database.get_message_by_name("DriveCommand")
        self._drives = {
            message.frame_id: message for message in map(database.get_message_by_name, ("LeftDrive", "RightDrive"))
        }
        self._heard: dict[str, dict[str, float]] = {}  # message: values
        self._direction = "coast"
        self._now = self._since = 0.0
        self._alive = 0
        self._is_reversing = False

    def request(self, action: str) -> None:
        """The driver's button: open, close or stop."""
        self._go({"open": "open", "close": "close", "stop": "brake"}[action])

    def step(self, now_s: float, frames: Sequence[can.Message]) -> list[can.Message]:
        """What it sends, after all frames since the last call."""
        self._now = now_s
        for frame in frames:
            if frame.arbitration_id in self._drives:  # all that is on the bus comes here
                message = self._drives[frame.arbitration_id]
                self._heard[message.name] = message.decode(frame.data, decode_choices=False)
        is_moving = DUTY[self._direction] > 0.0 and now_s - self._since > BLANKING
        if is_moving and len(self._heard) == len(self._drives):
            self._look()
        return [self._frame()]

    def _look(self) -> None:
        """Where a motion has to end."""
        left, right = self._heard["LeftDrive"], self._heard["RightDrive"]
        current = (left["MotorCurrent"] + right["MotorCurrent"]) / 2.0  # positive opens
        is_free = self._direction == "close" and left["HallCount"] > SEAL
        if is_free and -current > TRAPPED:
            print(f"{self._now:6.2f} s  trapped at {-current:.2f} A: reversing")
            self._go("open")
            self._is_reversing = True
        elif self._is_reversing and self._now - self._since > REVERSAL:
            self._go("brake")
        elif left["HallSpeed"] == right["HallSpeed"] == 0:
            # At an end stop. Without current an open gate would sink a little.
            self._go("brake" if self._direction == "open" else "coast")

    def _go(self, direction: str) -> None:
        self._direction, self._since, self._is_reversing = direction, self._now, False

    def _frame(self) -> can.Message:
        is_release = self._direction == "open" and self._now - self._since < 1.0
        payload = self._command.encode(
            {
                "LeftDuty": DUTY[self._direction],
                "RightDuty": DUTY[self._direction],
                "LeftDirection": self._direction,
                "RightDirection": self._direction,
                "LatchRelease": "release" if is_release else "hold",
                "AliveCounter": self._alive,
                "Checksum": 0,
            }
        )
        self._alive = (self._alive + 1) % 16
        identifier = self._command.frame_id
        data = payload[:7] + bytes([crc8_j1850(identifier.to_bytes(2, "little") + payload[:7])])
        return can.Message(arbitration_id=identifier, data=data, is_extended_id=False)


def crc8_j1850(data: bytes) -> int:
    """CRC-8 SAE J1850: polynomial 0x1D, start 0xFF, final XOR 0xFF."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1) ^ 0x1D if crc & 0x80 else crc << 1
        crc &= 0xFF
    return crc ^ 0xFF


def main() -> None:
    """Close the gate onto a rod."""
    result = lh.run(HERE / "rod.toml", ecu=Ecu())
    force, lowest = result.maxima["pinch_force_n"], result.minima["gate_angle_deg"]
    print(f"{force:.0f} N on the rod; {result.summary.received.accepted} commands accepted")
    assert result.verdict == "pass", result.reason
    assert force > 0.0
    assert lowest > 30.0  # it turned back at the rod
    assert result.summary.command_timeouts == 0


if __name__ == "__main__":
    main()
