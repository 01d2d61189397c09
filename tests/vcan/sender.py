"""Sends frames to vcan0 at a rate, over and over, also where the interface comes and goes.

    python sender.py RATE [--count N] [--priority P] -- FRAME...      FRAME: 123#0011 (hexadecimal)

Runs as a file of its own, in a process of its own: standard library only. Prints how many it sent.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import socket
import struct
import time


def frame_of(text: str) -> bytes:
    identifier, _, data = text.partition("#")
    payload = bytes.fromhex(data)
    return struct.pack("<IBxxx8s", int(identifier, 16), len(payload), payload)


def opened(priority: int) -> socket.socket | None:
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_PRIORITY, priority)
    raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")  # hears nothing
    try:
        raw.bind(("vcan0",))
    except OSError:
        raw.close()
        return None
    return raw


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("rate", type=float)
    parser.add_argument("--count", type=int, default=2**62)
    parser.add_argument("--priority", type=int, default=0)
    parser.add_argument("frames", nargs="+")
    args = parser.parse_args()
    frames = [frame_of(text) for text in args.frames]
    stopping = False

    def stop(*_: object) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    period = max(1.0 / args.rate, 0.001)
    raw = opened(args.priority)
    start = time.monotonic()
    sent = skipped = 0
    while not stopping and sent < args.count:
        due = min(int(args.rate * (time.monotonic() - start)) + 1 - skipped, args.count)
        while sent < due:
            try:
                if raw is None:
                    raw = opened(args.priority)
                assert raw is not None
                raw.send(frames[sent % len(frames)])
            except (OSError, AssertionError) as error:
                # What could not be sent now comes at its next turn, in its place; a dead socket does not return.
                skipped += due - sent
                if raw is not None and getattr(error, "errno", None) in (6, 19):
                    raw.close()
                    raw = None
                break
            sent += 1
        turns = (time.monotonic() - start) / period
        time.sleep((1.0 - turns % 1.0) * period)
    with contextlib.suppress(BrokenPipeError):
        print(sent, flush=True)


if __name__ == "__main__":
    main()
