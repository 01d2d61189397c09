"""The Python loop: a transport, sinks and observers around `tick`; free and lockstep runs make its ticks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, compiled
from liftgate_hil.codec.frames import Frames, empty_frames, logged
from liftgate_hil.config.rig import DEFAULT_BITRATE
from liftgate_hil.errors import PlantDivergedError
from liftgate_hil.loop.advance import advance
from liftgate_hil.loop.observers import Observer, Sink
from liftgate_hil.loop.progress_monitor import Moment, ProgressMonitor
from liftgate_hil.loop.statistics import BusLoad, Summary
from liftgate_hil.loop.tick import LoopConfig, LoopState, copied, in_force
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH, Bench
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan, not_made, received, turns
from liftgate_hil.transport.base import Transport, drained

_DIVERGED = ("time_s", "gate_angle_deg", "left_current_a")  # reported where the plant diverges


class PeerNode(Protocol):
    """Node at the other end of an in-process bus, which gets a turn after every tick."""

    @property
    def is_ours(self) -> bool:
        """Whether this is the reference ECU, whose delays count as the bench's, unlike a tested ECU's."""

    @property
    def dropped(self) -> int:
        """Number of frames for this node that were dropped before it could read them."""

    def poll(self, now_ns: int) -> None:
        """Take a turn at a model time [ns]: receive the frames that have arrived, and send frames."""

    def request(self, action: str) -> bool:
        """Have the driver request open, close, stop or reset at this node's next turn.

        Returns False where that cannot be requested here.
        """


@compilable
def scheduled_tick(
    config: LoopConfig,
    state: LoopState,
    frames: Frames,
    stimuli: StimulusPlan,
    row: NDArray[np.float64],
    frames_dropped: float,
    is_stop: bool,
) -> tuple[LoopState, Frames, Frames, bool]:
    """Make one tick with its stimuli, as `advance` does, and write its values to `row` (1, ROW_WIDTH).

    Returns the state, the frames that the gate received, those that it sends, and whether the plant is still
    sound.
    """
    turns(stimuli, (state.tick - stimuli.origin[0]) * config.step)
    gate, given = in_force(config, stimuli.faults.row), frames
    if not is_stop:
        given = received(stimuli, config.inputs, frames, state.tick * config.step_ns, config.seed)
    bench = Bench(0.0, frames_dropped, 0.0, not_made(stimuli))
    state, replies, is_sound = advance(gate, state, stimuli, given, row, bench, False, is_stop)
    return state, given, replies, is_sound


@dataclass
class Loop:
    """The Python loop: runs ticks of `state` with a transport, peers, sinks and observers."""

    config: LoopConfig
    state: LoopState
    stimuli: StimulusPlan
    transport: Transport
    peers: Sequence[PeerNode] = ()
    sinks: Sequence[Sink] = ()
    monitor: ProgressMonitor | None = None
    observers: Sequence[Observer] = ()
    bitrate: float = DEFAULT_BITRATE
    load: BusLoad = field(default_factory=BusLoad)
    frames_sent: int = 0
    frames_dropped: int = 0  # frames dropped because too many waited for a tick
    command: int = -1  # identifier of the drive command; -1: commands are not counted
    before_start: int = 0  # frames that came before the loop was ready
    commands_before: int = 0  # commands among these
    _lost_before: int = 0  # frames dropped before this run, see `_lost`
    _tick: Callable[..., tuple[LoopState, Frames, Frames, bool]] = field(init=False)

    def __post_init__(self) -> None:
        self._tick = compiled(scheduled_tick)

    def begin(self, is_first: bool = False) -> None:
        """Compile the loop's code, or load it from the cache, before time counts; then let the peers send.

        Where this loop `is_first` on a transport that others write to, what has come before is dropped.
        """
        # A tick writes its state in place, so this one gets copies.
        own = copied(self.state), copied(self.stimuli)
        self._call(*own, np.empty((1, ROW_WIDTH)), empty_frames(0), False)
        if is_first:
            count, self.commands_before = drained(self.transport, self.command)
            self.before_start += count
        self._lost_before = self._lost()
        for peer in self.peers if self.state.tick == 0 else ():
            peer.poll(0)

    def advance(self, frames: Frames) -> None:
        """Run one tick, in which the gate receives the frames. Raises PlantDivergedError."""
        self._step(frames, is_stop=False)
        for peer in self.peers:
            peer.poll(self.state.tick * self.config.step_ns)

    def advance_by(self, frames: Frames, ticks: int) -> None:
        """Run `ticks` ticks; the gate receives the frames in the first. Raises PlantDivergedError."""
        for _ in range(ticks):
            self.advance(frames)
            frames = empty_frames(0)

    def _step(self, frames: Frames, is_stop: bool) -> None:
        """Run one tick, the last one if `is_stop`, and send its frames. Raises PlantDivergedError."""
        row = np.empty((1, ROW_WIDTH))
        self.state, frames, replies, is_sound = self._call(self.state, self.stimuli, row, frames, is_stop)
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
            moment = Moment(self.ticks, row[0], self.frames_sent, 0, link)
            self.monitor.look(moment, is_last=is_stop)
        if not is_sound:
            at, angle, current = (row[0, COLUMN_PLACE[name]] for name in _DIVERGED)
            raise PlantDivergedError.at(at, found=f" (angle {angle}, current {current})")

    def _call(
        self, state: LoopState, stimuli: StimulusPlan, row: NDArray[np.float64], frames: Frames, is_stop: bool
    ) -> tuple[LoopState, Frames, Frames, bool]:
        """Call the compiled `scheduled_tick`, with the number of frames dropped so far."""
        dropped = float(self._lost() - self._lost_before + self.frames_dropped)
        return self._tick(self.config, state, frames, stimuli, row, dropped, is_stop)

    def _lost(self) -> int:
        """Return the number of frames that were dropped before the transport, or a peer, could read them."""
        return self.transport.counts().dropped + sum(each.dropped for each in self.peers)

    @property
    def ticks(self) -> int:
        """Number of plant steps done since the scenario's time 0."""
        return int(self.state.tick - self.stimuli.origin[0])

    @property
    def time(self) -> float:
        """Model time [s] since the scenario's time 0."""
        return self.ticks * self.config.step

    def finish(self) -> None:
        """Run one more tick, with the motors off, in which every message is sent."""
        self._step(empty_frames(0), is_stop=True)

    def summary(self, clock: str) -> Summary:
        """Return the summary of the run so far, with the name of its clock."""
        seconds = self.time
        link = self.transport.counts()
        return Summary(
            clock=clock,
            ticks=self.ticks,
            model_time_s=seconds,
            bus_load_percent=self.load.percent(self.bitrate, seconds),
            frames_sent=self.frames_sent,
            command_timeouts=self.state.timeouts,
            received=self.state.counts,
            link=link._replace(
                dropped=self._lost() - self._lost_before + self.frames_dropped,
                before_start=link.before_start + self.before_start,
            ),
        )


def run_free(loop: Loop, ticks: int | None, stopped: Callable[[], bool]) -> None:
    """Run a loop at full speed up to `ticks` in all (None: no end) or `stopped()`. Raises PlantDivergedError."""
    while not stopped() and (ticks is None or loop.ticks < ticks):
        loop.advance(loop.transport.receive())
