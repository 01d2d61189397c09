"""The Python loop: a clock, a transport, sinks and observers around `tick`."""

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
from liftgate_hil.loop.advance import advance
from liftgate_hil.loop.clock import Clock, FreeClock
from liftgate_hil.loop.observers import Observer, Sink
from liftgate_hil.loop.progress_monitor import Moment, ProgressMonitor
from liftgate_hil.loop.statistics import NO_TIMING, BusLoad, Summary, Timing
from liftgate_hil.loop.tick import LoopConfig, LoopState, copied, in_force
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH, Bench
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan, not_made, received, turns
from liftgate_hil.transport.base import Transport, drained
from liftgate_plant.compiler import compilable, compiled

_DIVERGED = ("time_s", "gate_angle_deg", "left_current_a")  # reported where the plant diverges


class Peer(Protocol):
    """A node at the other end of an in-process bus, which gets a turn after every tick."""

    @property
    def is_ours(self) -> bool:
        """Whether it is the reference ECU: where that is late, the bench is; an ECU under test is judged."""

    @property
    def dropped(self) -> int:
        """Frames for it that were dropped before it could read them."""

    def poll(self, now_ns: int) -> None:
        """Take a turn at a model time [ns]: receive the frames that have arrived, send own ones."""

    def request(self, action: str) -> bool:
        """Have the driver request open, close, stop or reset at the peer's next turn.

        Returns False where that cannot be requested here.
        """


@compilable
def scheduled_tick(
    config: LoopConfig,
    state: LoopState,
    frames: Frames,
    stimuli: StimulusPlan,
    row: NDArray[np.float64],
    counts: Bench,
    is_silent: bool,
    is_stop: bool,
) -> tuple[LoopState, Frames, Frames, bool]:
    """Make a tick with its stimuli, as `advance` does; its row goes to `row` (1, ROW_WIDTH).

    Returns the state, the frames that the gate received, those that it sends, and whether the plant is still
    sound.
    """
    turns(stimuli, (state.tick - stimuli.origin[0]) * config.step)
    gate, given = in_force(config, stimuli.faults.row), frames
    if not is_stop:
        given = received(stimuli, config.inputs, frames, state.tick * config.step_ns, config.seed)
    bench = Bench(counts.ticks_missed, counts.frames_dropped, 0.0, not_made(stimuli))
    state, replies, is_sound = advance(gate, state, stimuli, given, row, bench, is_silent, is_stop)
    return state, given, replies, is_sound


@dataclass
class Loop:
    """A loop about to run; `state` advances with it."""

    config: LoopConfig
    state: LoopState
    stimuli: StimulusPlan
    transport: Transport
    peers: Sequence[Peer] = ()
    sinks: Sequence[Sink] = ()
    monitor: ProgressMonitor | None = None
    observers: Sequence[Observer] = ()
    bitrate: float = 500_000.0
    load: BusLoad = field(default_factory=BusLoad)
    ticks_missed: int = 0
    frames_sent: int = 0
    frames_dropped: int = 0  # frames dropped because too many waited for a tick
    frames_stale: int = 0  # frames older than their message's time-out
    command: int = -1  # identifier of the drive command; -1: commands are not counted
    before_start: int = 0  # frames that came before the loop was ready
    commands_before: int = 0  # commands among these
    _lost_before: int = 0  # frames dropped before this run, see `_lost`
    _tick: Callable[..., tuple[LoopState, Frames, Frames, bool]] = field(init=False)

    def __post_init__(self) -> None:
        self._tick = compiled(scheduled_tick)

    def begin(self, is_first: bool = False) -> None:
        """Compile, or read the cache, before time counts; then the peers may send.

        Where this loop `is_first` on a transport that others write to, what has come before is dropped.
        """
        # A tick writes its state in place, so this one gets copies.
        own = copied(self.state), copied(self.stimuli)
        self._call(*own, np.empty((1, ROW_WIDTH)), empty_frames(0), False, False)
        if is_first:
            count, self.commands_before = drained(self.transport, self.command)
            self.before_start += count
        self._lost_before = self._lost()
        for peer in self.peers if self.state.tick == 0 else ():
            peer.poll(0)

    def advance(self, frames: Frames, steps: int) -> None:
        """Make `steps` steps; all but the last make up for missed ticks and send nothing.

        The first step receives the frames. Raises PlantDivergedError.
        """
        for missed in range(steps - 1, -1, -1):
            self._step(frames, is_silent=missed > 0, is_stop=False)
            frames = empty_frames(0)
        for peer in self.peers:
            peer.poll(self.state.tick * self.config.step_ns)

    def advance_by(self, frames: Frames, ticks: int) -> None:
        """Make `ticks` ticks, each of which sends; the first receives the frames. Raises PlantDivergedError."""
        for _ in range(ticks):
            self.advance(frames, 1)
            frames = empty_frames(0)

    def without_stale(self, frames: Frames) -> Frames:
        """Return the frames just received without the stale ones.

        A frame is stale if it has waited for longer than its message's time-out.
        """
        count, bus = frames.count, self.config.inputs
        ages_ns = time.monotonic_ns() - self.transport.came_ns
        fresh = [row for row in range(count) if not is_stale(bus, int(frames.identifiers[row]), int(ages_ns[row]))]
        self.frames_stale += count - len(fresh)
        if len(fresh) == count:
            return frames
        return Frames(len(fresh), frames.identifiers[fresh], frames.lengths[fresh], frames.data[fresh])

    def _step(self, frames: Frames, is_silent: bool, is_stop: bool) -> None:
        self.ticks_missed += is_silent
        row = np.empty((1, ROW_WIDTH))
        self.state, frames, replies, is_sound = self._call(
            self.state, self.stimuli, row, frames, is_silent, is_stop
        )
        self.transport.send(replies)
        self.frames_sent += replies.count
        self.load.add(frames)
        self.load.add(replies)
        time_ns = self.ticks * self.config.step_ns
        seen = np.concatenate([logged(frames, time_ns, False), logged(replies, time_ns, True)])
        for sink in self.sinks:
            sink.take(row, seen)
        for observer in self.observers:
            observer.look(seen, self.time)
        if self.monitor is not None:
            link = self.transport.counts()
            moment = Moment(self.ticks, row[0], self.frames_sent, self.ticks_missed, link)
            self.monitor.look(moment, is_last=is_stop)
        if not is_sound:
            at, angle, current = (row[0, COLUMN_PLACE[name]] for name in _DIVERGED)
            raise PlantDivergedError.at(at, found=f" (angle {angle}, current {current})")

    def _call(
        self,
        state: LoopState,
        stimuli: StimulusPlan,
        row: NDArray[np.float64],
        frames: Frames,
        is_silent: bool,
        is_stop: bool,
    ) -> tuple[LoopState, Frames, Frames, bool]:
        dropped = float(self._lost() - self._lost_before + self.frames_dropped + self.frames_stale)
        counts = Bench(float(self.ticks_missed), dropped, 0.0, 0.0)
        return self._tick(self.config, state, frames, stimuli, row, counts, is_silent, is_stop)

    def _lost(self) -> int:
        """Return how many frames were dropped before the transport, or a peer, could read them."""
        return self.transport.counts().dropped + sum(each.dropped for each in self.peers)

    @property
    def ticks(self) -> int:
        """Plant steps done since the scenario's time 0."""
        return int(self.state.tick - self.stimuli.origin[0])

    @property
    def time(self) -> float:
        """Model time [s]."""
        return self.ticks * self.config.step

    def finish(self) -> None:
        """Send the last frames, which say that the motors are off."""
        self._step(empty_frames(0), is_silent=False, is_stop=True)

    def summary(self, clock: str, timing: Timing = NO_TIMING) -> Summary:
        """Return the figures so far."""
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
                dropped=self._lost() - self._lost_before + self.frames_dropped,
                before_start=link.before_start + self.before_start,
                stale_frames=link.stale_frames + self.frames_stale,
            ),
        )


def run_clocked(
    loop: Loop, clock: Clock, ticks: int | None, stopped: Callable[[], bool], is_real: bool = True
) -> None:
    """Run on a clock for `ticks` ticks (None: until stopped).

    With `is_real`, on a clock that is tied to real time, frames can be stale.
    """
    while not stopped() and (ticks is None or loop.ticks < ticks):
        steps = clock.wait(loop.ticks)
        if ticks is not None:
            steps = min(steps, ticks - loop.ticks)
        frames = loop.transport.receive()
        loop.advance(loop.without_stale(frames) if is_real else frames, steps)


def run_free(loop: Loop, ticks: int | None, stopped: Callable[[], bool]) -> None:
    """Run as fast as possible."""
    run_clocked(loop, FreeClock(), ticks, stopped, is_real=False)
