"""The closed loop in machine code: gate and ECU, tick by tick, without coming back to Python.

A bus with two nodes. What the gate sends in tick k the ECU reads in tick k; what it answers the gate reads in
tick k + 1. The same `tick` and the same `reference.step` as everywhere else.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import Frames
from liftgate_hil.ecu import reference
from liftgate_hil.ecu.reference import EcuConfig, EcuState
from liftgate_hil.ecu.wire import CAPACITY, Port, PortState, call_port, request_of_port
from liftgate_hil.loop.rings import Shared, note_frames, note_row
from liftgate_hil.loop.row import is_sound
from liftgate_hil.loop.tick import LoopConfig, LoopState, tick, with_arrays
from liftgate_hil.stimuli.mailbox import take_letters
from liftgate_hil.stimuli.outside import outside_at
from liftgate_hil.stimuli.timeline import Timeline
from liftgate_plant.compiler import borrowed, compilable

# How a stretch of an episode ended.
DONE, DIVERGED, BAD_ECU = 0, 1, 2
# What the ECU is.
NO_ECU, REFERENCE, PORT = 0, 1, 2

REQUEST = np.dtype([("time_ns", "i8"), ("action", "i8")])


class Node(NamedTuple):
    """The ECU under test: of the two parts the one that `kind` names is used."""

    kind: int
    reference: EcuConfig
    port: Port


class NodeState(NamedTuple):
    """What it remembers."""

    reference: EcuState
    port: PortState


class Script(NamedTuple):
    """What acts on the closed loop."""

    timeline: Timeline
    held: NDArray[np.float64]  # what was posted, see mailbox
    requests: Any  # (n,) REQUEST, in the order of time
    ticks: int  # at which the stretch ends
    is_last: int  # 1: one more tick, with the motors off
    is_recorded: int  # 1: frames go into the ring


class Stretch(NamedTuple):
    """Where a stretch of an episode ended."""

    loop: LoopState
    node: NodeState
    asked: int  # requests made; -1: not begun, the ECU speaks before the first tick
    pending: int  # frames that the ECU sent and the gate has not read
    outcome: int


@compilable
def ask(script: Script, node: Node, state: NodeState, asked: int, now_ns: int) -> int:
    """Make the requests whose time has come; how many were made so far."""
    while asked < len(script.requests) and script.requests[asked].time_ns <= now_ns:
        action = script.requests[asked].action
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
    node: Node, state: NodeState, frames: Frames, now_ns: int, nothing: Frames
) -> tuple[NodeState, Frames, bool]:
    """The ECU's turn: what it sends, and whether it did what an ECU may."""
    if node.kind == REFERENCE:
        after, sent = reference.step(node.reference, state.reference, frames, now_ns)
        return NodeState(after, state.port), sent, True
    if node.kind == PORT:
        count = call_port(node.port, state.port, frames, now_ns)
        if count < 0:
            return state, nothing, False
        return state, outgoing(node, state, count), True
    return state, nothing, True


@compilable
def run_stretch(
    config: LoopConfig, node: Node, start: Stretch, script: Script, shared: Shared
) -> Stretch:
    """Run from where the last stretch ended until `script.ticks`, or until a ring of `shared` could overflow."""
    config, node, script, shared = borrowed((config, node, script, shared))
    loop, state = borrowed((start.loop, start.node))
    asked, to_gate = start.asked, outgoing(node, state, start.pending)
    control = shared.control[0]
    stamps = np.zeros(CAPACITY + len(config.outputs.messages), dtype=np.int64)
    room = len(shared.frames) - 2 * len(stamps) - control.frames
    rows = len(shared.rows) - control.rows
    outcome = DONE
    if asked < 0:
        asked = ask(script, node, state, 0, 0)
        state, to_gate, is_fine = turn(node, state, config.nothing, 0, config.nothing)
        outcome = DONE if is_fine else BAD_ECU
    while outcome == DONE and loop.tick < script.ticks + script.is_last and rows > 0 and room > 0:
        rows -= 1
        stopping = loop.tick >= script.ticks
        take_letters(shared.box, script.held)
        outside = outside_at(
            script.timeline, script.held, loop.tick * config.step, 0, False, stopping
        )
        given = config.nothing if stopping else to_gate
        loop, replies, truth, sensed = tick(config, loop, given, outside)
        now_ns = loop.tick * config.step_ns
        note_row(shared, truth, sensed)
        if given.count + replies.count > 0 and script.is_recorded:
            note_frames(shared, given, stamps, 0, now_ns)
            note_frames(shared, replies, stamps, 0, now_ns)
            room -= given.count + replies.count
        control.sent += replies.count
        if not is_sound(truth):
            outcome = DIVERGED
        elif not stopping:
            asked = ask(script, node, state, asked, now_ns)
            state, to_gate, is_fine = turn(node, state, replies, now_ns, config.nothing)
            if not is_fine:
                outcome = BAD_ECU
    control.tick = loop.tick
    return Stretch(
        loop=with_arrays(loop, start.loop),
        node=NodeState(
            reference.with_arrays(state.reference, start.node.reference), start.node.port
        ),
        asked=asked,
        pending=to_gate.count,
        outcome=outcome,
    )
