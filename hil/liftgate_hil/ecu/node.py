"""The ECU under test as a node on the bus of the closed loop, which is called after every tick."""

from __future__ import annotations

from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_hil.codec.frames import Frames
from liftgate_hil.ecu import reference
from liftgate_hil.ecu.reference import EcuConfig, EcuState
from liftgate_hil.ecu.wire import Port, PortState, call_port, request_of_port
from liftgate_hil.stimuli.moments import Moments
from liftgate_hil.stimuli.requests import RESET, Requests, first_open, is_due, note_made

# Kinds of ECU; NO_ECU: the frames in `port.sent` go to the gate, and nothing replies.
NO_ECU, REFERENCE, PORT = 0, 1, 2


class Node(NamedTuple):
    """Constants of the ECU under test; `kind` selects the reference ECU or a port to foreign code."""

    kind: int
    reference: EcuConfig
    port: Port


class NodeState(NamedTuple):
    """State of the ECU under test."""

    reference: EcuState
    port: PortState


@compilable
def ask(node: Node, state: NodeState, requests: Requests, moments: Moments, now_ns: int, gate_ns: int) -> bool:
    """Pass the ECU the requests that are due: at a time by the ECU's clock, or at a moment by the gate's.

    Returns whether an ECU reset is due first; after it, this function is called again.
    """
    if node.kind == REFERENCE and state.reference.server.head[0].is_resetting != 0:
        return True
    place = first_open(requests, now_ns)
    while place < len(requests.rows):
        if is_due(requests, place, moments, now_ns, gate_ns):
            note_made(requests, place)
            request = requests.rows[place]
            if request.action == RESET:
                return True
            if node.kind == REFERENCE:
                state.reference.memory.control[0].request = request.action
            elif node.kind == PORT:
                request_of_port(node.port, request.action)
        place += 1
    return False


@compilable
def outgoing(node: Node, state: NodeState, count: int) -> Frames:
    """Return the first `count` frames that the ECU sent in its last turn."""
    frames = state.reference.frames if node.kind == REFERENCE else state.port.sent
    return Frames(count, frames.identifiers, frames.lengths, frames.data)


@compilable
def turn(node: Node, state: NodeState, frames: Frames, now_ns: int) -> tuple[NodeState, Frames, bool]:
    """Run the ECU for one tick; return its state, the frames it sends, and whether the call succeeded."""
    if node.kind == REFERENCE:
        after, sent = reference.step(node.reference, state.reference, frames, now_ns)
        return NodeState(after, state.port), sent, True
    if node.kind == PORT:
        count = call_port(node.port, state.port, frames, now_ns)
        return state, outgoing(node, state, max(count, 0)), count >= 0
    return state, node.reference.nothing, True
