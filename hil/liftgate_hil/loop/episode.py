"""An episode: the closed loop of gate and ECU in machine code, which returns to Python to empty its rings.

A bus with two nodes. What the gate sends in tick k the ECU reads in tick k; what it replies the gate reads in tick
k + 1. The same `tick` and the same `reference.step` as everywhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from liftgate_compiler import compilable, compiled
from liftgate_hil.codec.frames import Frames
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.node import NO_ECU, Node, NodeState, ask, outgoing, turn
from liftgate_hil.ecu.wire import CAPACITY
from liftgate_hil.errors import EcuError, PlantDivergedError
from liftgate_hil.loop.advance import advance
from liftgate_hil.loop.observers import Sink
from liftgate_hil.loop.progress_monitor import Moment, ProgressMonitor
from liftgate_hil.loop.rings import Memory, Shared, count_bits, next_row, note_frames
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.loop.tick import LoopConfig, LoopState, copied, in_force
from liftgate_hil.signals import ON_TIME
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan, received, turns
from liftgate_hil.transport.base import NO_ERRORS

ROWS = 4096  # rows of a stretch, few enough to stay in the processor's cache
FRAMES = 16384
# How a stretch of an episode ended.
DONE, DIVERGED, BAD_ECU, RESET = 0, 1, 2, 3

ANY = 2**62  # no limit to the number of edges


class LoopStart(NamedTuple):
    """Constants, initial state and stimuli of a loop."""

    config: LoopConfig
    state: LoopState
    stimuli: StimulusPlan

    def with_own_arrays(self) -> LoopStart:
        """Return a copy that shares no arrays with this one, so that a loop on one leaves the other alone."""
        return LoopStart(self.config, copied(self.state), copied(self.stimuli))


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


class Episode:
    """Closed loop of gate and ECU in this process, in machine code, which runs as fast as possible.

    `memory` may be read by others; a stretch of machine code ends after so many Hall `edges`. Raises ValueError if
    the memory's ring of frames has no room for two ticks.
    """

    def __init__(
        self,
        start: LoopStart,
        adapter: Adapter,
        sinks: Sequence[Sink] = (),
        is_recorded: bool = True,
        memory: Memory | None = None,
        edges: int = ANY,
    ) -> None:
        self.config = config = start.config
        least = 2 * most_frames(config)
        if memory is not None and memory.sizes[1] <= least:
            raise ValueError(f"a ring of {memory.sizes[1]} frames; allowed: more than {least}")
        self.memory = memory or Memory(ROWS, FRAMES)
        self._owns_memory = memory is None
        self._adapter = adapter
        self._sinks = sinks
        self._script = Script(start.stimuli, ticks=0, is_last=0, is_recorded=int(is_recorded), edges=edges)
        # After a precondition the ECU has already had its turn at this time; none has one where there is no ECU.
        has_begun = int(start.stimuli.origin[0] > 0 or adapter.kind == NO_ECU)
        self._now = Stretch(start.state, adapter.state, has_begun=has_begun, pending=0, outcome=DONE)
        self._run = compiled(run_stretch)
        self.monitor: ProgressMonitor | None = None
        self.bits = 0

    @property
    def state(self) -> LoopState:
        """State of the loop after the last tick."""
        return self._now.loop

    @property
    def stimuli(self) -> StimulusPlan:
        """Stimulus plan that the loop uses."""
        return self._script.stimuli

    @property
    def in_flight(self) -> int:
        """Number of frames that the ECU has sent and the gate has not received yet."""
        return int(self._now.pending)

    @property
    def ticks(self) -> int:
        """Number of plant steps done since the scenario's time 0."""
        return int(self._now.loop.tick - self._script.stimuli.origin[0])

    @property
    def time(self) -> float:
        """Model time [s] since the scenario's time 0."""
        return self.ticks * self.config.step

    def begin(self) -> None:
        """Compile the loop's code, or load it from the cache, before the run begins."""
        is_ready_for = getattr(self._run, "is_ready_for", None)  # there is none where the compiler is off
        if is_ready_for and is_ready_for(
            self.config, self._adapter.node, self._now, self._script, self.memory.shared
        ):
            return
        script = self._script._replace(ticks=0, stimuli=copied(self._script.stimuli))
        self._run(self.config, self._adapter.node, self._now._replace(has_begun=1), script, self.memory.shared)

    def run(self, ticks: int, stopped: Callable[[], bool] = lambda: False) -> None:
        """Run until `ticks` ticks are done in all, or `stopped()`. Raises PlantDivergedError, EcuError."""
        self.advance(ticks - self.ticks, stopped)

    def advance(self, ticks: int, stopped: Callable[[], bool] = lambda: False) -> None:
        """Run for `ticks` more ticks, or until `stopped()`. Raises PlantDivergedError, EcuError."""
        self._stretches(self._script._replace(ticks=self.state.tick + ticks), stopped)

    def follow(self, stimuli: StimulusPlan) -> None:
        """Replace the stimulus plan from the next tick on."""
        self._script = self._script._replace(stimuli=stimuli)

    def give(self, frames: Sequence[tuple[int, int, bytes]]) -> None:
        """Have the gate receive frames (identifier with flags, length, data), not the ECU's, in the next tick.

        They come instead of what the ECU has sent in the last one.
        """
        sent = self._now.node.port.sent
        for place, (identifier, length, data) in enumerate(frames):
            sent.identifiers[place], sent.lengths[place] = identifier, length
            sent.data[place, : len(data)] = np.frombuffer(data, dtype=np.uint8)
        self._now = self._now._replace(pending=len(frames))

    def finish(self) -> None:
        """Run the last tick, with the motors off, in which every message is sent."""
        self._stretches(self._script._replace(ticks=self.state.tick, is_last=1), lambda: False)

    def complete(self, ticks: int, stopped: Callable[[], bool] = lambda: False) -> None:
        """Run until `ticks` ticks are done, then one with the motors off; less if `stopped()`. Raises as `run`."""
        last = self.state.tick + ticks - self.ticks
        self._stretches(self._script._replace(ticks=last, is_last=1), stopped)

    def close(self) -> None:
        """Release the shared memory, unless the caller provided it."""
        if self._owns_memory:
            self.memory.close()

    def summary(self, bitrate: float) -> Summary:
        """Return the summary of the run so far; the bitrate [bit/s] is for the bus load."""
        seconds = self.time
        load = 100.0 * self.bits / (bitrate * seconds) if seconds > 0.0 else 0.0
        return Summary(
            clock="free",
            ticks=self.ticks,
            model_time_s=seconds,
            bus_load_percent=load,
            frames_sent=int(self.memory.shared.control.sent[0]),
            command_timeouts=self.state.timeouts,
            received=self.state.counts,
        )

    def _stretches(self, script: Script, stopped: Callable[[], bool]) -> None:
        """Run stretches until the script's end or `stopped()`; after each, empty rings, reset the ECU if due."""
        shared = self.memory.shared
        last = script.ticks + script.is_last
        while self.state.tick < last and not stopped():
            self._now = self._run(self.config, self._adapter.node, self._now, script, shared)
            self._adapter.state = self._now.node
            self._empty_rings()
            if self._now.outcome == RESET:
                self._adapter.reset()
                self._now = self._now._replace(node=self._adapter.state, outcome=DONE)
            if self._now.outcome == DIVERGED:
                raise PlantDivergedError.at(self.time)
            if self._now.outcome == BAD_ECU:
                raise EcuError(f"the ECU at {self.time:.3f} s: {self._adapter.failure()}")

    def _empty_rings(self) -> None:
        """Pass the rows and frames in the rings to the sinks and the monitor, and empty the rings."""
        control = self.memory.shared.control[0]
        rows = self.memory.shared.rows[: control.rows]
        frames = self.memory.shared.frames[: control.frames]
        for sink in self._sinks:
            sink.take(rows, frames)
        if self.monitor is not None and len(rows):
            moment = Moment(self.ticks, rows[-1], int(control.sent), 0, NO_ERRORS)
            self.monitor.look(moment, is_last=self._now.outcome not in (DONE, RESET))
        self.bits += int(control.bits)
        control.rows = control.frames = control.bits = 0
