"""Peer: runs an ECU's code as the node at the other end of the gate's bus.

The Python loop and the real-time loop have peers in their process; `liftgate-hil ecu` is a process with one.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_compiler import compiled
from liftgate_hil.codec.frames import ERROR, FD_FLAGS, REMOTE, empty_frames
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.node import NO_ECU, REFERENCE, ask, turn
from liftgate_hil.errors import EcuError
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import Request, by_the_clock

if TYPE_CHECKING:
    from liftgate_hil.codec.frames import Frames
    from liftgate_hil.stimuli.moments import Moments
    from liftgate_hil.stimuli.requests import Requests
    from liftgate_hil.transport.base import Transport


def machine_code(adapter: Adapter) -> Callable[..., Any]:
    """Return an ECU's `turn` compiled to machine code, so that compiling does not count as the ECU's time."""
    code: Callable[..., Any] = compiled(turn)
    code(adapter.node._replace(kind=NO_ECU), adapter.state, empty_frames(0), 0)
    return code


class Peer:
    """Node at the other end of a bus that runs an adapter's ECU, for the Python loop and the real-time loop.

    Requests are made by the ECU's own clock; those that wait for a moment need the loop's own moments. The ECU's
    code runs within a `guard`. The scenario's time 0 is at `before_ns` of the gate's clock.
    """

    def __init__(
        self,
        adapter: Adapter,
        transport: Transport,
        asked: tuple[Requests, Moments] | None = None,
        guard: Callable[[], AbstractContextManager[None]] = nullcontext,
        before_ns: int = 0,
    ) -> None:
        self._adapter = adapter
        self._transport = transport
        self._asked = asked or by_the_clock(())
        self._heard_ns = 0 if adapter.shares_clock else -1
        self.first_other = -1  # identifier of the first frame of others before the gate is heard; -1: none
        self._guard = guard
        self._before_ns = before_ns
        self._commanded: list[tuple[Requests, Moments]] = []
        self._turn = machine_code(adapter)

    def request(self, action: str) -> bool:
        """Request open, close, stop or reset at the next turn; False: the ECU does not accept it."""
        if not self._adapter.takes(action):
            return False
        self._commanded.append(by_the_clock([Request(Instant(), action)]))
        return True

    @property
    def is_ours(self) -> bool:
        """Whether the peer runs the reference ECU, not a user's ECU."""
        return self._adapter.kind == REFERENCE

    @property
    def dropped(self) -> int:
        """Number of frames that were dropped before this process could read them."""
        return self._transport.counts().dropped

    def poll(self, now_ns: int) -> None:
        """Receive frames, run the ECU at a time [ns], and send its frames. Raises EcuError."""
        adapter = self._adapter
        frames = self._transport.receive()
        if self._heard_ns < 0:
            self._note_senders(frames, now_ns)
        began = self._began_ns()
        with self._guard():
            while self._commanded:
                if ask(adapter.node, adapter.state, *self._commanded[0], 0, 0):
                    adapter.reset()
                    return
                del self._commanded[0]
            if began >= 0 and ask(
                adapter.node,
                adapter.state,
                *self._asked,
                now_ns - began - self._before_ns,
                now_ns - self._before_ns,
            ):
                adapter.reset()
                return
            adapter.state, sent, is_fine = self._turn(adapter.node, adapter.state, frames, now_ns)
        if not is_fine:
            raise EcuError(f"the ECU at {now_ns * 1e-9:.3f} s: {adapter.failure()}")
        if sent.count:
            self._transport.send(sent)

    def finish(self) -> None:
        """Send the ECU's last frames, with the motors off."""
        frames = self._adapter.last_frames()
        if frames is not None:
            self._transport.send(frames)

    @property
    def has_received(self) -> bool:
        """Whether a gate frame, valid or not, has been received; always True where the ECU shares its clock."""
        return self._heard_ns >= 0

    @property
    def has_heard_the_gate(self) -> bool:
        """Whether a valid gate frame (user's ECU: any) was received; always True where the clock is shared."""
        return self._began_ns() >= 0

    def _note_senders(self, frames: Frames, now_ns: int) -> None:
        """Record when the gate's first frame arrived, and the identifier of another sender's first frame."""
        identifiers = frames.identifiers[: frames.count]
        theirs = identifiers[identifiers & (ERROR | REMOTE) == 0] & ~FD_FLAGS
        are_gates = np.isin(theirs, self._adapter.node.reference.inputs.messages.identifier)
        if self.first_other < 0 and not are_gates.all():
            self.first_other = int(theirs[~are_gates][0])
        if are_gates.any():
            self._heard_ns = now_ns

    def _began_ns(self) -> int:
        """Return the start [ns] of the clock by which the ECU gets requests; -1: not started yet."""
        adapter = self._adapter
        if adapter.node.kind == REFERENCE:
            return int(adapter.state.reference.memory.control.began_ns[0])
        return self._heard_ns
