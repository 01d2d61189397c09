"""The Python loop: a clock, transports and recorders around `tick`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import FD, Frames, empty_frames
from liftgate_hil.errors import OverrunError, PlantDivergedError
from liftgate_hil.loop.clock import Clock, FreeClock
from liftgate_hil.loop.recorder import Recorder, Taker
from liftgate_hil.loop.row import is_sound, write_row
from liftgate_hil.loop.statistics import NO_TIMING, BusLoad, Summary, Timing
from liftgate_hil.loop.tick import LoopConfig, LoopState, copied, tick
from liftgate_hil.signals import ROW_WIDTH
from liftgate_hil.stimuli.mailbox import nothing_held
from liftgate_hil.stimuli.outside import outside_at
from liftgate_hil.stimuli.timeline import Timeline
from liftgate_hil.transport.base import Transport
from liftgate_plant.compiler import compilable, compiled
from liftgate_plant.signals import Sensed, Truth


class Peer(Protocol):
    """Somebody at the other end of an in-process bus, who gets a turn after every tick."""

    def poll(self, now_ns: int) -> None:
        """Take and send what is there at this model time."""


@compilable
def scheduled_tick(
    config: LoopConfig,
    state: LoopState,
    frames: Frames,
    timeline: Timeline,
    held: NDArray[np.float64],
    ticks_missed: int,
    is_silent: bool,
    is_stop: bool,
) -> tuple[LoopState, Frames, Truth, Sensed]:
    """A tick with what timeline and mailbox say."""
    time = state.tick * config.step
    outside = outside_at(timeline, held, time, ticks_missed, is_silent, is_stop)
    return tick(config, state, frames, outside)


_PATIENCE = 2.0  # s of silence after which lockstep says that it waits


@dataclass
class Loop:
    """A loop about to run; `state` moves on with it."""

    config: LoopConfig
    state: LoopState
    timeline: Timeline
    transport: Transport
    recorders: Sequence[Recorder] = ()
    peers: Sequence[Peer] = ()
    takers: Sequence[Taker] = ()
    bitrate: float = 500_000.0
    load: BusLoad = field(default_factory=BusLoad)
    held: NDArray[np.float64] = field(default_factory=nothing_held)  # what was posted, see mailbox
    ticks_missed: int = 0
    frames_sent: int = 0
    _tick: Callable[..., tuple[LoopState, Frames, Truth, Sensed]] = field(init=False)

    def __post_init__(self) -> None:
        self._tick = compiled(scheduled_tick)

    def begin(self) -> None:
        """Compile, or read the cache, before time counts; then the peers may speak first."""
        # What a tick remembers it writes in place: this one has a state of its own.
        self._call(copied(self.state), empty_frames(0), False, False)
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
        self.state, replies, truth, sensed = self._call(self.state, frames, is_silent, stop)
        self.transport.send(replies)
        self.frames_sent += replies.count
        self.load.add(frames)
        self.load.add(replies)
        rows = np.empty((1, ROW_WIDTH))
        write_row(rows[0], truth, sensed)
        for recorder in self.recorders:
            recorder.write_frames(frames, [truth.time_s] * frames.count)
            recorder.write_frames(replies, [truth.time_s] * replies.count)
            recorder.write_rows(rows)
        for taker in self.takers:
            taker.take(rows, ())
        if not is_sound(truth):
            raise PlantDivergedError(
                f"the plant diverged at {truth.time_s:.3f} s (angle {truth.gate_angle_deg}, "
                f"current {truth.left_current_a}); allowed: a higher `rate`, a saner vehicle"
            )

    def _call(
        self, state: LoopState, frames: Frames, is_silent: bool, stop: bool
    ) -> tuple[LoopState, Frames, Truth, Sensed]:
        return self._tick(
            self.config, state, frames, self.timeline, self.held, self.ticks_missed, is_silent, stop
        )

    @property
    def time(self) -> float:
        """Model time [s]."""
        return self.state.tick * self.config.step

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


class Lockstep(NamedTuple):
    """How lockstep waits."""

    command: int  # identifier of the frame that ends a command
    ticks_per_command: int
    wall_timeout: float | None = None  # s without a command after which it gives up; None: never
    say: Callable[[str], None] = lambda text: None


def run_lockstep(
    loop: Loop, lockstep: Lockstep, ticks: int | None, stopped: Callable[[], bool]
) -> None:
    """Advance one command period for each command frame that comes; the bus is the clock. Raises OverrunError.

    An ECU that answers every frame would lag for good by what it sent before the gate was there, so of the
    commands that are waiting at the start the last one alone counts. Other frames are kept.
    """
    lockstep.say("ready: waits for the first command")
    waiting: list[Frames] = []
    heard = time.monotonic()
    is_told = False
    while not stopped() and (ticks is None or loop.state.tick < ticks):
        waiting += split_after(loop.transport.receive(timeout=0.1), lockstep.command)
        if loop.state.tick == 0 and waiting:
            waiting += split_after(_rest(loop.transport), lockstep.command)
            waiting = newest(waiting, lockstep.command)
        silent = time.monotonic() - heard
        if lockstep.wall_timeout is not None and silent > lockstep.wall_timeout:
            raise OverrunError(
                f"no command for {lockstep.wall_timeout:g} s at {loop.time:.3f} s of model time; "
                "allowed: an ECU that answers, or a longer `wall_timeout`"
            )
        if silent > _PATIENCE and not is_told:
            lockstep.say(f"{loop.time:.3f} s: waits for a command (0x{lockstep.command:X})")
            is_told = True
        while len(waiting) > 1 or (waiting and _ends_with(waiting[0], lockstep.command)):
            frames = waiting.pop(0)
            if not _ends_with(frames, lockstep.command):
                waiting[0] = join(frames, waiting[0])
                continue
            heard, is_told = time.monotonic(), False
            for step in range(lockstep.ticks_per_command):
                if ticks is None or loop.state.tick < ticks:
                    loop.advance(frames if step == 0 else empty_frames(0), 1)


def _rest(transport: Transport) -> Frames:
    """All that is left to be read; one reading has an end."""
    frames = empty_frames(0)
    while (more := transport.receive()).count:
        frames = join(frames, _slice(more, 0, more.count))
    return frames


def newest(pieces: list[Frames], command: int) -> list[Frames]:
    """The pieces without the commands before the last one."""
    ends = [place for place, piece in enumerate(pieces) if _ends_with(piece, command)]
    if not ends:
        return pieces
    before = [
        _slice(piece, 0, piece.count - _ends_with(piece, command)) for piece in pieces[: ends[-1]]
    ]
    return [piece for piece in before if piece.count] + pieces[ends[-1] :]


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
