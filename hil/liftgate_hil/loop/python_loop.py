"""The Python loop: a clock, transports and recorders around `tick`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import FD, Frames, empty_frames
from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.loop.clock import Clock, FreeClock
from liftgate_hil.loop.recorder import Recorder
from liftgate_hil.loop.statistics import NO_TIMING, BusLoad, Summary, Timing
from liftgate_hil.loop.tick import LoopConfig, LoopState, tick
from liftgate_hil.stimuli.mailbox import nothing_held
from liftgate_hil.stimuli.outside import Outside, outside_at
from liftgate_hil.stimuli.timeline import Timeline
from liftgate_hil.transport.base import Transport
from liftgate_plant.compiler import compiled
from liftgate_plant.signals import Sensed, Truth


class Peer(Protocol):
    """Somebody at the other end of an in-process bus, who gets a turn after every tick."""

    def poll(self, now_ns: int) -> None:
        """Take and send what is there at this model time."""


Watch = Callable[[NDArray[np.float64]], None]  # gets a row (ROW_WIDTH,)


@dataclass
class Loop:
    """A loop about to run; `state` moves on with it."""

    config: LoopConfig
    state: LoopState
    timeline: Timeline
    transport: Transport
    recorders: Sequence[Recorder] = ()
    peers: Sequence[Peer] = ()
    watch: Watch | None = None
    bitrate: float = 500_000.0
    load: BusLoad = field(default_factory=BusLoad)
    held: NDArray[np.float64] = field(default_factory=nothing_held)  # what was posted, see mailbox
    ticks_missed: int = 0
    frames_sent: int = 0
    _tick: Callable[..., tuple[LoopState, Frames, Truth, Sensed]] = field(init=False)
    _outside: Callable[..., Outside] = field(init=False)

    def __post_init__(self) -> None:
        self._tick = compiled(tick)
        self._outside = compiled(outside_at)

    def begin(self) -> None:
        """Compile, or read the cache, before time counts; then the peers may speak first."""
        outside = self._outside(self.timeline, self.held, 0.0, 0, False, False)
        self._tick(self.config, self.state, empty_frames(1), outside)
        for peer in self.peers:
            peer.poll(0)

    def advance(self, frames: Frames, steps: int, stop: bool = False) -> None:
        """So many steps; all but the last make up for missed ticks and send nothing. The frames come in the
        first. Raises PlantDivergedError.
        """
        for missed in range(steps - 1, -1, -1):
            self._step(frames, missed > 0, stop)
            frames = empty_frames(0)
        for peer in self.peers:
            peer.poll(self.state.tick * self.config.step_ns)

    def _step(self, frames: Frames, is_silent: bool, stop: bool) -> None:
        self.ticks_missed += is_silent
        time = self.state.tick * self.config.step
        outside = self._outside(self.timeline, self.held, time, self.ticks_missed, is_silent, stop)
        self.state, replies, truth, sensed = self._tick(self.config, self.state, frames, outside)
        self.transport.send(replies)
        self.frames_sent += replies.count
        self.load.add(frames)
        self.load.add(replies)
        row = np.array([*truth, *sensed])
        for recorder in self.recorders:
            recorder.write_frames(frames, [truth.time_s] * frames.count)
            recorder.write_frames(replies, [truth.time_s] * replies.count)
            recorder.write_rows(row[np.newaxis])
        if self.watch is not None:
            self.watch(row)
        if not math.isfinite(sum(truth)):
            raise PlantDivergedError(
                f"the plant diverged at {truth.time_s:.3f} s (angle {truth.gate_angle_deg}, "
                f"current {truth.left_current_a}); allowed: a higher --rate, a saner vehicle"
            )

    def finish(self) -> None:
        """The last frames say that the motors are off."""
        self.peers = ()
        self.advance(empty_frames(0), 1, stop=True)

    def summary(self, clock: str, timing: Timing = NO_TIMING) -> Summary:
        """The figures so far."""
        seconds = self.state.tick * self.config.step
        return Summary(
            clock=clock,
            ticks=self.state.tick,
            model_time_s=seconds,
            overruns=self.ticks_missed,
            timing=timing,
            bus_load_percent=self.load.percent(self.bitrate, seconds),
            frames_sent=self.frames_sent,
            command_timeouts=self.state.timeouts,
            received=self.state.counts,
            link=self.transport.counts(),
        )


def run_clocked(loop: Loop, clock: Clock, ticks: int | None, stopped: Callable[[], bool]) -> None:
    """Run on a clock for so many ticks (None: until stopped)."""
    while not stopped() and (ticks is None or loop.state.tick < ticks):
        steps = clock.wait(loop.state.tick)
        if ticks is not None:
            steps = min(steps, ticks - loop.state.tick)
        loop.advance(loop.transport.receive(), steps)


def run_free(loop: Loop, ticks: int | None, stopped: Callable[[], bool]) -> None:
    """Run as fast as it goes."""
    run_clocked(loop, FreeClock(), ticks, stopped)


def run_lockstep(
    loop: Loop,
    command_identifier: int,
    ticks_per_command: int,
    ticks: int | None,
    stopped: Callable[[], bool],
) -> None:
    """Advance one command period for each command frame that comes; the bus is the clock."""
    waiting: list[Frames] = []
    while not stopped() and (ticks is None or loop.state.tick < ticks):
        waiting += split_after(loop.transport.receive(timeout=0.1), command_identifier)
        while len(waiting) > 1 or (waiting and _ends_with(waiting[0], command_identifier)):
            frames = waiting.pop(0)
            if not _ends_with(frames, command_identifier):
                waiting[0] = join(frames, waiting[0])
                continue
            for step in range(ticks_per_command):
                if ticks is None or loop.state.tick < ticks:
                    loop.advance(frames if step == 0 else empty_frames(0), 1)


def split_after(frames: Frames, identifier: int) -> list[Frames]:
    """The frames in pieces that each end with a frame of that identifier, and the rest."""
    pieces = []
    start = 0
    for row in range(frames.count):
        if int(frames.identifiers[row]) & ~FD == identifier:
            pieces.append(_slice(frames, start, row + 1))
            start = row + 1
    if start < frames.count:
        pieces.append(_slice(frames, start, frames.count))
    return pieces


def join(first: Frames, second: Frames) -> Frames:
    """Frames one after the other."""
    return Frames(
        first.count + second.count,
        np.concatenate([first.identifiers, second.identifiers]),
        np.concatenate([first.lengths, second.lengths]),
        np.concatenate([first.data, second.data]),
    )


def _slice(frames: Frames, start: int, end: int) -> Frames:
    return Frames(
        end - start,
        frames.identifiers[start:end].copy(),
        frames.lengths[start:end].copy(),
        frames.data[start:end].copy(),
    )


def _ends_with(frames: Frames, identifier: int) -> bool:
    return frames.count > 0 and int(frames.identifiers[frames.count - 1]) & ~FD == identifier
