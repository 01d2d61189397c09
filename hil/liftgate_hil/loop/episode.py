"""The closed loop in machine code: gate and ECU, tick by tick, without coming back to Python.

A bus with two nodes. What the gate sends in tick k the ECU reads in tick k; what it answers the gate reads in
tick k + 1. The same `tick` and the same `reference.step` as everywhere else.
"""

from __future__ import annotations

from typing import NamedTuple

from liftgate_hil.ecu.node import Node, NodeState, ask, outgoing, turn
from liftgate_hil.ecu.wire import CAPACITY
from liftgate_hil.loop.rings import Shared, count_bits, note_frames, note_row
from liftgate_hil.loop.row import is_sound
from liftgate_hil.loop.tick import LoopConfig, LoopState, in_force, tick
from liftgate_hil.signals import ON_TIME
from liftgate_hil.stimuli.mailbox import take_letters
from liftgate_hil.stimuli.outside import outside_at
from liftgate_hil.stimuli.scene import Scene, note_tick, received, sent, turns
from liftgate_plant.compiler import compilable

# How a stretch of an episode ended.
DONE, DIVERGED, BAD_ECU, RESET = 0, 1, 2, 3

ANY = 2**62  # as many edges as come


class Script(NamedTuple):
    """What acts on the closed loop."""

    scene: Scene
    ticks: int  # at which the stretch ends
    is_last: int  # 1: one more tick, with the motors off
    is_recorded: int  # 1: frames go into the ring
    edges: int  # the stretch ends after so many Hall edges, which their ring is to have room for


class Stretch(NamedTuple):
    """Where a stretch of an episode ended."""

    loop: LoopState
    node: NodeState
    has_begun: int  # 0: the ECU speaks before the first tick
    pending: int  # frames that the ECU sent and the gate has not read
    outcome: int


@compilable
def most_frames(config: LoopConfig) -> int:
    """How many frames a tick may bring, either way."""
    return CAPACITY + len(config.outputs.messages)


@compilable
def run_stretch(  # noqa: PLR0915
    config: LoopConfig, node: Node, start: Stretch, script: Script, shared: Shared
) -> Stretch:
    """Run on from where the last stretch ended: until `script.ticks`, until a ring of `shared` could overflow, or
    until its `stop` is set.
    """
    loop, state = start.loop, start.node
    has_begun, to_gate = start.has_begun, outgoing(node, state, start.pending)
    control = shared.control[0]
    room = len(shared.frames) - 2 * most_frames(config) - control.frames
    rows = len(shared.rows) - control.rows
    edges = loop.sensors.edges.written
    last, most_edges = script.ticks + script.is_last, edges[0] + script.edges
    outcome, scene, is_over = DONE, script.scene, False
    origin = scene.origin[0]
    while not is_over:
        gate = in_force(
            config, scene.faults.row
        )  # apart, so that what follows from it is calculated once
        while True:
            stopping = loop.tick >= script.ticks
            is_full = rows <= 0 or room <= 0 or edges[0] > most_edges
            is_stopped = control.stop != 0 and not stopping
            is_over = outcome != DONE or loop.tick >= last or is_full or is_stopped
            now = (loop.tick - origin) * config.step
            if is_over or turns(scene, now):
                break
            heard, now_ns = config.nothing, 0
            if has_begun != 0 or stopping:
                rows -= 1
                take_letters(shared.box, scene.held)
                outside = outside_at(scene, now, config.step, 0, False, stopping)
                given, start_ns = config.nothing, loop.tick * config.step_ns
                if not stopping:
                    given = received(scene, config.inputs, to_gate, start_ns, config.seed)
                loop, heard, truth, sensed = tick(gate, loop, given, outside)
                now_ns = loop.tick * config.step_ns
                if not stopping:
                    heard = sent(scene, heard, loop.tick, config.step_ns, config.seed)
                place = note_row(shared, truth, sensed, ON_TIME)
                note_tick(scene, shared.rows[place : place + 1], given, heard)
                if given.count + heard.count > 0:
                    count_bits(shared, given)
                    count_bits(shared, heard)
                    if script.is_recorded:
                        time_ns = now_ns - origin * config.step_ns
                        note_frames(shared, given, time_ns, 0)
                        note_frames(shared, heard, time_ns, 1)
                        room -= given.count + heard.count
                control.sent += heard.count
                control.tick = loop.tick - origin
                if not is_sound(truth):
                    outcome = DIVERGED
            if outcome == DONE and not stopping:
                has_begun = 1
                time_ns = now_ns - origin * config.step_ns
                if ask(node, state, scene.requests, scene.moments, time_ns, time_ns):
                    outcome, to_gate = RESET, config.nothing
                else:
                    state, to_gate, is_fine = turn(node, state, heard, now_ns)
                    outcome = outcome if is_fine else BAD_ECU
    return Stretch(
        loop=loop,
        node=state,
        has_begun=has_begun,
        pending=to_gate.count,
        outcome=outcome,
    )
