"""The closed loop in machine code: gate and ECU, tick by tick, without coming back to Python.

A bus with two nodes. What the gate sends in tick k the ECU reads in tick k; what it answers the gate reads in
tick k + 1. The same `tick` and the same `reference.step` as everywhere else.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.ecu.node import Node, NodeState, ask, outgoing, turn
from liftgate_hil.ecu.wire import CAPACITY
from liftgate_hil.loop.rings import Shared, count_bits, note_frames, note_row
from liftgate_hil.loop.row import is_sound
from liftgate_hil.loop.tick import LoopConfig, LoopState, tick
from liftgate_hil.stimuli.mailbox import take_letters
from liftgate_hil.stimuli.outside import outside_at
from liftgate_hil.stimuli.timeline import Timeline
from liftgate_plant.compiler import compilable

# How a stretch of an episode ended.
DONE, DIVERGED, BAD_ECU = 0, 1, 2

ANY = 2**62  # as many edges as come


class Script(NamedTuple):
    """What acts on the closed loop."""

    timeline: Timeline
    held: NDArray[np.float64]  # what was posted, see mailbox
    requests: Any  # (n,) node.REQUEST, in the order of time
    ticks: int  # at which the stretch ends
    is_last: int  # 1: one more tick, with the motors off
    is_recorded: int  # 1: frames go into the ring
    edges: int  # the stretch ends after so many Hall edges, which their ring is to have room for


class Stretch(NamedTuple):
    """Where a stretch of an episode ended."""

    loop: LoopState
    node: NodeState
    asked: int  # requests made; -1: not begun, the ECU speaks before the first tick
    pending: int  # frames that the ECU sent and the gate has not read
    outcome: int


@compilable
def most_frames(config: LoopConfig) -> int:
    """How many frames a tick may bring, either way."""
    return CAPACITY + len(config.outputs.messages)


@compilable
def run_stretch(
    config: LoopConfig, node: Node, start: Stretch, script: Script, shared: Shared
) -> Stretch:
    """Run on from where the last stretch ended: until `script.ticks`, until a ring of `shared` could overflow, or
    until its `stop` is set.
    """
    loop, state = start.loop, start.node
    asked, to_gate = start.asked, outgoing(node, state, start.pending)
    control = shared.control[0]
    room = len(shared.frames) - 2 * most_frames(config) - control.frames
    rows = len(shared.rows) - control.rows
    edges = loop.sensors.edges.written
    last, most_edges = script.ticks + script.is_last, edges[0] + script.edges
    outcome = DONE
    while outcome == DONE and loop.tick < last and rows > 0 and room > 0 and edges[0] <= most_edges:
        stopping = loop.tick >= script.ticks
        if control.stop != 0 and not stopping:
            break
        heard, now_ns = config.nothing, 0
        if asked >= 0 or stopping:
            rows -= 1
            take_letters(shared.box, script.held)
            now = loop.tick * config.step
            outside = outside_at(script.timeline, script.held, now, config.step, 0, False, stopping)
            given = config.nothing if stopping else to_gate
            loop, heard, truth, sensed = tick(config, loop, given, outside)
            now_ns = loop.tick * config.step_ns
            note_row(shared, truth, sensed)
            if given.count + heard.count > 0:
                count_bits(shared, given)
                count_bits(shared, heard)
                if script.is_recorded:
                    note_frames(shared, given, now_ns, 0)
                    note_frames(shared, heard, now_ns, 1)
                    room -= given.count + heard.count
            control.sent += heard.count
            control.tick = loop.tick
            if not is_sound(truth):
                outcome = DIVERGED
        if outcome == DONE and not stopping:
            asked = ask(node, state, script.requests, max(asked, 0), now_ns)
            state, to_gate, is_fine = turn(node, state, heard, now_ns)
            if not is_fine:
                outcome = BAD_ECU
    return Stretch(
        loop=loop,
        node=state,
        asked=asked,
        pending=to_gate.count,
        outcome=outcome,
    )
