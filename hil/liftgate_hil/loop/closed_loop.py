"""The closed loop in machine code: gate and ECU, tick by tick, without returning to Python.

A bus with two nodes. What the gate sends in tick k the ECU reads in tick k; what it replies the gate reads in tick
k + 1. The same `tick` and the same `reference.step` as everywhere else.
"""

from __future__ import annotations

from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_hil.codec.frames import Frames
from liftgate_hil.ecu.node import Node, NodeState, ask, outgoing, turn
from liftgate_hil.ecu.wire import CAPACITY
from liftgate_hil.loop.advance import advance
from liftgate_hil.loop.rings import Shared, count_bits, next_row, note_frames
from liftgate_hil.loop.tick import LoopConfig, LoopState, in_force
from liftgate_hil.signals import ON_TIME
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan, received, turns

# How a stretch of an episode ended.
DONE, DIVERGED, BAD_ECU, RESET = 0, 1, 2, 3

ANY = 2**62  # no limit to the number of edges


class Script(NamedTuple):
    """Stimuli of one stretch (call of `run_stretch`) of the closed loop, and the conditions that end it."""

    stimuli: StimulusPlan
    ticks: int  # the loop's tick at which the stretch ends
    is_last: int  # 1: one more tick, with the motors off
    is_recorded: int  # 1: frames go into the ring
    edges: int  # Hall edges after which the stretch ends; their ring must have room for them


class Stretch(NamedTuple):
    """State of an episode's closed loop at the end of a stretch (call of `run_stretch`)."""

    loop: LoopState
    node: NodeState
    has_begun: int  # 0: the ECU has a turn before the first tick
    pending: int  # frames that the ECU sent and the gate has not read
    outcome: int  # DONE, DIVERGED, BAD_ECU or RESET


@compilable
def most_frames(config: LoopConfig) -> int:
    """Return the maximum number of frames that the gate, or the ECU, sends in one tick."""
    return CAPACITY + len(config.outputs.messages)


@compilable
def note_exchange(shared: Shared, given: Frames, heard: Frames, time_ns: int, is_recorded: int) -> None:
    """Count the bits of a tick's frames in both directions; if `is_recorded`, write the frames to the ring."""
    count_bits(shared, given)
    count_bits(shared, heard)
    if is_recorded:
        note_frames(shared, given, time_ns, 0)
        note_frames(shared, heard, time_ns, 1)


@compilable
def run_stretch(config: LoopConfig, node: Node, start: Stretch, script: Script, shared: Shared) -> Stretch:
    """Continue the closed loop from the state `start` until it has to return to Python; return the state there.

    It ends at `script.ticks`, where a ring of `shared` could overflow, when its `stop` is set, or with an outcome
    other than DONE.
    """
    loop, state = start.loop, start.node
    has_begun, to_gate = start.has_begun, outgoing(node, state, start.pending)
    control = shared.control[0]
    room = len(shared.frames) - 2 * most_frames(config) - control.frames
    rows = len(shared.rows) - control.rows
    edges = loop.sensors.edges.written
    last, most_edges = script.ticks + script.is_last, edges[0] + script.edges
    outcome, stimuli, is_over = DONE, script.stimuli, False
    origin = stimuli.origin[0]
    while not is_over:
        # Outside the inner loop, so that what follows from it is calculated once.
        gate = in_force(config, stimuli.faults.row)
        while True:
            stopping = loop.tick >= script.ticks
            is_full = rows <= 0 or room <= 0 or edges[0] > most_edges
            is_stopped = control.stop != 0 and not stopping
            is_over = outcome != DONE or loop.tick >= last or is_full or is_stopped
            now = (loop.tick - origin) * config.step
            if is_over or turns(stimuli, now):
                break
            heard, now_ns = config.nothing, 0
            if has_begun != 0 or stopping:
                rows -= 1
                given, start_ns = config.nothing, loop.tick * config.step_ns
                if not stopping:
                    given = received(stimuli, config.inputs, to_gate, start_ns, config.seed)
                place = next_row(shared)
                row = shared.rows[place : place + 1]
                loop, heard, is_sound = advance(gate, loop, stimuli, given, row, ON_TIME, False, stopping)
                control.rows += 1
                now_ns = loop.tick * config.step_ns
                if given.count + heard.count > 0:
                    time_ns = now_ns - origin * config.step_ns
                    note_exchange(shared, given, heard, time_ns, script.is_recorded)
                    room -= script.is_recorded * (given.count + heard.count)
                control.sent += heard.count
                control.tick = loop.tick - origin
                if not is_sound:
                    outcome = DIVERGED
            if outcome == DONE and not stopping:
                has_begun = 1
                time_ns = now_ns - origin * config.step_ns
                if ask(node, state, stimuli.requests, stimuli.moments, time_ns, time_ns):
                    outcome, to_gate = RESET, config.nothing
                else:
                    state, to_gate, is_fine = turn(node, state, heard, now_ns)
                    outcome = outcome if is_fine else BAD_ECU
    return Stretch(loop, state, has_begun, to_gate.count, outcome)
