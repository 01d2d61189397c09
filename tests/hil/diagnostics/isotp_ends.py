"""Two ISO-TP nodes that exchange frames directly: our implementation, and can-isotp on a simulated clock."""

from __future__ import annotations

from collections import deque
from typing import Any

import isotp
import numpy as np
from hil_support import frames_of, rows_of

from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.diagnostics.isotp import MOST_SPOKEN, hear, is_sending, message_in, new_link, put_message, speak

REQUEST, RESPONSE = 0x7A0, 0x7A8
TICK_NS = 1_000_000


class Clock:
    """A stand-in for the module `time`, as used by can-isotp's timers."""

    def __init__(self) -> None:
        self.now_ns = 0

    def perf_counter_ns(self) -> int:
        return self.now_ns


class Ours:
    """Our node: sends on REQUEST, receives on RESPONSE."""

    def __init__(self, **said: int) -> None:
        self.link = new_link(REQUEST, RESPONSE, **said)
        self.got: list[bytes] = []

    @property
    def is_idle(self) -> bool:
        return not is_sending(self.link) and not self.link.head.is_receiving[0]

    def send(self, message: bytes) -> None:
        put_message(self.link, message)

    def take(self, payload: bytes, now_ns: int, identifier: int = RESPONSE) -> None:
        length = hear(self.link, frames_of([(identifier, payload)]), 0, now_ns)
        if length:
            self.got.append(message_in(self.link, length))

    def poll(self, now_ns: int) -> list[bytes]:
        room = empty_frames(MOST_SPOKEN)
        rows = rows_of(room._replace(count=speak(self.link, room, 0, now_ns)))
        assert all(identifier == REQUEST for identifier, _ in rows)
        return [payload for _, payload in rows]


class Theirs:
    """The node of can-isotp: sends on RESPONSE, receives on REQUEST; its errors are in `errors`."""

    def __init__(self, **said: Any) -> None:
        self.inbox: deque[bytes] = deque()
        self.outbox: list[bytes] = []
        self.errors: list[Exception] = []
        self.got: list[bytes] = []
        address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=RESPONSE, rxid=REQUEST)
        self.layer = isotp.TransportLayerLogic(
            self._read, self._write, address, self.errors.append, params={"wftmax": 10, **said}
        )

    def _read(self, timeout: float) -> isotp.CanMessage | None:
        if not self.inbox:
            return None
        return isotp.CanMessage(arbitration_id=REQUEST, data=self.inbox.popleft())

    def _write(self, message: isotp.CanMessage) -> None:
        self.outbox.append(bytes(message.data))

    def send(self, message: bytes) -> None:
        self.layer.send(message)

    def take(self, payload: bytes) -> None:
        self.inbox.append(payload)

    def poll(self) -> list[bytes]:
        self.layer.process()
        while (message := self.layer.recv()) is not None:
            self.got.append(bytes(message))
        said, self.outbox = self.outbox, []
        return said


def random_bytes(rng: np.random.Generator, length: int) -> bytes:
    return rng.integers(0, 256, length, dtype=np.uint8).tobytes()
