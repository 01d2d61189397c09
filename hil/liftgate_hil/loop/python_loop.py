"""The Python loop: a clock, a transport and those who look on around `tick`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import Frames, empty_frames, logged
from liftgate_hil.codec.receive import is_stale
from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.loop.clock import Clock, FreeClock
from liftgate_hil.loop.lookout import Lookout, Moment
from liftgate_hil.loop.recorder import Attendant, Taker
from liftgate_hil.loop.row import is_sound, write_row
from liftgate_hil.loop.statistics import NO_TIMING, BusLoad, Summary, Timing
from liftgate_hil.loop.tick import LoopConfig, LoopState, copied, in_force, tick
from liftgate_hil.signals import ROW_WIDTH, Bench
from liftgate_hil.stimuli.outside import outside_at
from liftgate_hil.stimuli.scene import Scene, not_made, note_tick, received, sent, turns
from liftgate_hil.transport.base import Transport, drained
from liftgate_plant.compiler import compilable, compiled
from liftgate_plant.signals import Sensed, Truth


class Peer(Protocol):
    """Somebody at the other end of an in-process bus, who gets a turn after every tick."""

    @property
    def is_ours(self) -> bool:
        """Whether it is the reference ECU: where that is late, the bench is; an ECU under test is judged."""

    def poll(self, now_ns: int) -> None:
        """Take and send what is there at this model time."""

    def request(self, action: str) -> bool:
        """Have the driver ask for open, close, stop or reset at its next turn; False: it cannot be asked here."""


@compilable
def scheduled_tick(
    config: LoopConfig,
    state: LoopState,
    frames: Frames,
    scene: Scene,
    rows: NDArray[np.float64],
    ticks_missed: int,
    frames_dropped: int,
    is_silent: bool,
    is_stop: bool,
) -> tuple[LoopState, Frames, Frames, Truth, Sensed]:
    """A tick on a scene; its row goes to `rows` (1, ROW_WIDTH). The frames are what the gate got, and what it
    sends.
    """
    time = (state.tick - scene.origin[0]) * config.step
    turns(scene, time)
    outside = outside_at(scene, time, config.step, ticks_missed, is_silent, is_stop)
    gate = in_force(config, scene.faults.row)
    given = frames
    if not is_stop:
        given = received(scene, config.inputs, frames, state.tick * config.step_ns, config.seed)
    state, replies, truth, sensed = tick(gate, state, given, outside)
    if not (is_stop or is_silent):
        replies = sent(scene, replies, state.tick, config.step_ns, config.seed)
    bench = Bench(float(ticks_missed), float(frames_dropped), 0.0, not_made(scene))
    write_row(rows[0], truth, sensed, bench)
    note_tick(scene, rows, given, replies)
    return state, given, replies, truth, sensed


@dataclass
class Loop:
    """A loop about to run; `state` moves on with it."""

    config: LoopConfig
    state: LoopState
    scene: Scene
    transport: Transport
    peers: Sequence[Peer] = ()
    takers: Sequence[Taker] = ()
    lookout: Lookout | None = None
    attendants: Sequence[Attendant] = ()
    bitrate: float = 500_000.0
    load: BusLoad = field(default_factory=BusLoad)
    ticks_missed: int = 0
    frames_sent: int = 0
    frames_dropped: int = 0  # that waited for a tick for too long
    frames_stale: int = 0  # that were older than their message's time-out
    command: int = -1  # identifier of the drive command; -1: not asked for
    before_start: int = 0  # frames that came before the loop was ready
    commands_before: int = 0  # commands among these
    _tick: Callable[..., tuple[LoopState, Frames, Frames, Truth, Sensed]] = field(init=False)

    def __post_init__(self) -> None:
        self._tick = compiled(scheduled_tick)

    def begin(self, is_first: bool = False) -> None:
        """Compile, or read the cache, before time counts. What has come before is dropped where this loop
        `is_first` on a transport that others write to; then the peers may speak.
        """
        # What a tick remembers it writes in place: this one has a state of its own.
        own = copied(self.state), copied(self.scene)
        self._call(*own, np.empty((1, ROW_WIDTH)), empty_frames(0), False, False)
        if is_first:
            count, self.commands_before = drained(self.transport, self.command)
            self.before_start += count
        for peer in self.peers if self.state.tick == 0 else ():
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

    def advance_by(self, frames: Frames, ticks: int) -> None:
        """So many ticks, each of which sends; the frames come in the first. Raises PlantDivergedError."""
        for _ in range(ticks):
            self.advance(frames, 1)
            frames = empty_frames(0)

    def without_stale(self, frames: Frames) -> Frames:
        """The frames just received, less those that have waited for longer than their message's time-out."""
        count, bus = frames.count, self.config.inputs
        ages_ns = time.monotonic_ns() - self.transport.came_ns
        fresh = [
            row
            for row in range(count)
            if not is_stale(bus, int(frames.identifiers[row]), int(ages_ns[row]))
        ]
        self.frames_stale += count - len(fresh)
        if len(fresh) == count:
            return frames
        return Frames(
            len(fresh), frames.identifiers[fresh], frames.lengths[fresh], frames.data[fresh]
        )

    def _step(self, frames: Frames, is_silent: bool, stop: bool) -> None:
        self.ticks_missed += is_silent
        rows = np.empty((1, ROW_WIDTH))
        self.state, frames, replies, truth, _ = self._call(
            self.state, self.scene, rows, frames, is_silent, stop
        )
        self.transport.send(replies)
        self.frames_sent += replies.count
        self.load.add(frames)
        self.load.add(replies)
        time_ns = self.ticks * self.config.step_ns
        seen = np.concatenate([logged(frames, time_ns, False), logged(replies, time_ns, True)])
        for taker in self.takers:
            taker.take(rows, seen)
        for attendant in self.attendants:
            attendant.look(seen, self.time)
        if self.lookout is not None:
            moment = Moment(self.ticks, rows[0], self.frames_sent, self.ticks_missed)
            self.lookout.look(moment, is_last=stop)
        if not is_sound(truth):
            raise PlantDivergedError(
                f"the plant diverged at {truth.time_s:.3f} s (angle {truth.gate_angle_deg}, "
                f"current {truth.left_current_a}); allowed: a higher `rate`, a saner vehicle"
            )

    def _call(
        self,
        state: LoopState,
        scene: Scene,
        rows: NDArray[np.float64],
        frames: Frames,
        is_silent: bool,
        stop: bool,
    ) -> tuple[LoopState, Frames, Frames, Truth, Sensed]:
        missed, dropped = self.ticks_missed, self.frames_dropped + self.frames_stale
        return self._tick(self.config, state, frames, scene, rows, missed, dropped, is_silent, stop)

    @property
    def ticks(self) -> int:
        """Plant steps done since the scenario's time 0."""
        return int(self.state.tick - self.scene.origin[0])

    @property
    def time(self) -> float:
        """Model time [s]."""
        return self.ticks * self.config.step

    def finish(self) -> None:
        """The last frames say that the motors are off."""
        self.peers = ()
        self.advance(empty_frames(0), 1, stop=True)

    def summary(self, clock: str, timing: Timing = NO_TIMING) -> Summary:
        """The figures so far."""
        seconds = self.time
        link = self.transport.counts()
        return Summary(
            clock=clock,
            ticks=self.ticks,
            model_time_s=seconds,
            overruns=self.ticks_missed,
            timing=timing,
            bus_load_percent=self.load.percent(self.bitrate, seconds),
            frames_sent=self.frames_sent,
            command_timeouts=self.state.timeouts,
            received=self.state.counts,
            link=link._replace(
                dropped=link.dropped + self.frames_dropped,
                before_start=link.before_start + self.before_start,
                stale_frames=link.stale_frames + self.frames_stale,
            ),
        )


def run_clocked(
    loop: Loop, clock: Clock, ticks: int | None, stopped: Callable[[], bool], is_real: bool = True
) -> None:
    """Run on a clock for so many ticks (None: until stopped); on one that `is_real` frames can be too old."""
    while not stopped() and (ticks is None or loop.ticks < ticks):
        steps = clock.wait(loop.ticks)
        if ticks is not None:
            steps = min(steps, ticks - loop.ticks)
        frames = loop.transport.receive()
        loop.advance(loop.without_stale(frames) if is_real else frames, steps)


def run_free(loop: Loop, ticks: int | None, stopped: Callable[[], bool]) -> None:
    """Run as fast as it goes."""
    run_clocked(loop, FreeClock(), ticks, stopped, is_real=False)
