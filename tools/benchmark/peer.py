"""Peer process at the other end of a benchmark's wire: it sends a command every 10.1 ms and reads all frames.

The period is not 10 ms: against feedback every 5 ms the phase would stay the same throughout a run, and the time
from command to feedback would depend on that one phase. With 10.1 ms the phase moves on by 0.1 ms per command.

python -m tools.benchmark.peer DESCRIPTOR
"""

from __future__ import annotations

import socket
import struct
import sys
import time

from liftgate_hil.codec.checksum import put_checksum
from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.plan.setup import rig_from

PERIOD = 0.0101  # s


def main() -> None:
    """Send commands and read frames until the other end is closed."""
    rig = rig_from("liftgate")
    message = rig.messages["DriveCommand"]
    bus = rig.input_config()
    frames = empty_frames(1)
    wire = socket.socket(fileno=int(sys.argv[1]))
    wire.setblocking(False)
    counter = 0
    following = time.monotonic()
    while True:
        payload = message.encode(
            {"LeftDuty": 50, "RightDuty": 50, "LeftDirection": 1, "RightDirection": 1,
             "LatchRelease": 1, "AliveCounter": counter % 16, "Checksum": 0}
        )  # fmt: skip
        frames.data[0, :8] = list(payload)
        put_checksum(bus, 0, counter % 16, frames.data, 0)
        try:
            wire.send(struct.pack("<IB3x8s", 0x120, 8, frames.data[0, :8].tobytes()))
            counter += 1
            while wire.recv(80):
                pass
            return
        except BlockingIOError:
            pass
        except OSError:
            return
        following = max(following + PERIOD, time.monotonic())
        time.sleep(max(0.0, following - time.monotonic()))


if __name__ == "__main__":
    main()
