"""An ECU at the other end of a bus, for the loops in Python and in real time, and in a process of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.node import PORT, ask, request_table, turn
from liftgate_hil.errors import EcuError
from liftgate_plant.compiler import compiled

if TYPE_CHECKING:
    from liftgate_hil.codec.frames import Frames
    from liftgate_hil.stimuli.requests import Request
    from liftgate_hil.transport.base import Transport


class Peer:
    """An adapter's ECU at the other end of a bus, for the loops in Python and in real time."""

    def __init__(
        self, adapter: Adapter, transport: Transport, requests: Sequence[Request] = ()
    ) -> None:
        self._adapter = adapter
        self._transport = transport
        self._requests = request_table(requests)
        self._asked = 0
        self._turn = compiled(turn)

    def poll(self, now_ns: int) -> None:
        """Take and send what is there at a time [ns]. Raises EcuError."""
        adapter = self._adapter
        frames = self._transport.receive()
        self._begin(frames, now_ns)
        if self._began() >= 0:
            since = now_ns - self._began()
            self._asked = ask(adapter.node, adapter.state, self._requests, self._asked, since)
        adapter.state, sent, is_fine = self._turn(adapter.node, adapter.state, frames, now_ns)
        if not is_fine:
            raise EcuError(f"the ECU: {adapter.failure()}")
        if sent.count:
            self._transport.send(sent)

    def finish(self) -> None:
        """The last frames."""
        frames = self._adapter.last_frames()
        if frames is not None:
            self._transport.send(frames)

    def elapsed_ns(self, now_ns: int) -> int:
        """How long the ECU's clock, from which requests count, has been running at a time [ns]."""
        return now_ns - self._began() if self._began() >= 0 else 0

    def _began(self) -> int:
        return int(self._adapter.state.reference.memory.control.began_ns[0])

    def _begin(self, frames: Frames, now_ns: int) -> None:
        """The reference ECU begins by itself when it has heard all that it needs; others with the first frame."""
        if self._began() < 0 and self._adapter.kind == PORT and frames.count:
            self._adapter.state.reference.memory.control.began_ns[0] = now_ns
