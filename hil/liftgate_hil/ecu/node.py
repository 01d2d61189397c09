"""The ECU under test as the closed loop sees it: a node of the bus that has its turn after every tick."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from liftgate_hil.codec.frames import Frames
from liftgate_hil.ecu import reference
from liftgate_hil.ecu.memory import ACTIONS
from liftgate_hil.ecu.reference import EcuConfig, EcuState
from liftgate_hil.ecu.wire import Port, PortState, call_port, request_of_port
from liftgate_hil.stimuli.requests import Request
from liftgate_plant.compiler import compilable

# What the ECU is; NO_ECU: what is in `port.sent` goes to the gate, and nobody answers.
NO_ECU, REFERENCE, PORT = 0, 1, 2

REQUEST = np.dtype([("time_ns", "i8"), ("action", "i8")])


def request_table(requests: Sequence[Request]) -> Any:
    """Requests as a table (n,) REQUEST for the loop."""
    rows = [(round(each.time * 1e9), ACTIONS.index(each.action)) for each in requests]
    rows.sort(key=lambda row: row[0])  # of those at one time the order stays
    return np.array(rows, dtype=REQUEST).view(np.recarray)


class Node(NamedTuple):
    """Of the two parts the one that `kind` names is used."""

    kind: int
    reference: EcuConfig
    port: Port


class NodeState(NamedTuple):
    """What it remembers."""

    reference: EcuState
    port: PortState


@compilable
def ask(node: Node, state: NodeState, requests: Any, asked: int, now_ns: int) -> int:
    """Make the requests (n,) REQUEST whose time has come; how many were made so far."""
    while asked < len(requests) and requests[asked].time_ns <= now_ns:
        action = requests[asked].action
        if node.kind == REFERENCE:
            state.reference.memory.control[0].request = action
        elif node.kind == PORT:
            request_of_port(node.port, action)
        asked += 1
    return asked


@compilable
def outgoing(node: Node, state: NodeState, count: int) -> Frames:
    """The first `count` frames that the ECU sent last."""
    frames = state.reference.frames if node.kind == REFERENCE else state.port.sent
    return Frames(count, frames.identifiers, frames.lengths, frames.data)


@compilable
def turn(
    node: Node, state: NodeState, frames: Frames, now_ns: int
) -> tuple[NodeState, Frames, bool]:
    """The ECU's turn: what it sends, and whether it did what an ECU may."""
    if node.kind == REFERENCE:
        after, sent = reference.step(node.reference, state.reference, frames, now_ns)
        return NodeState(after, state.port), sent, True
    if node.kind == PORT:
        count = call_port(node.port, state.port, frames, now_ns)
        return state, outgoing(node, state, max(count, 0)), count >= 0
    return state, node.reference.nothing, True
