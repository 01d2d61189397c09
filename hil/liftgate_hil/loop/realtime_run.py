"""A real-time run: the real-time loop in a thread of its own, supervised by this thread.

This thread watches the wire, reports what happened, updates the figures that go onto the bus, and gives the peers
of an in-process bus their turns. None of it can hold up a tick.
"""

from __future__ import annotations

import gc
import os
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from liftgate_compiler import compiled
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import OverrunError, PlantDivergedError
from liftgate_hil.loop import realtime_loop
from liftgate_hil.loop.datagrams import CAPACITY
from liftgate_hil.loop.histogram import distribution
from liftgate_hil.loop.loop_thread import LOOP
from liftgate_hil.loop.observers import Observer, Sink
from liftgate_hil.loop.priority import Realtime, name_thread, prepare_thread
from liftgate_hil.loop.progress_monitor import Moment, ProgressMonitor
from liftgate_hil.loop.python_loop import PeerNode
from liftgate_hil.loop.rings import DELAY, EXECUTION, LATENESS, ArrivalReader, Memory, RingReader
from liftgate_hil.loop.statistics import LoopTiming, Summary
from liftgate_hil.loop.tick import LoopConfig, LoopState, copied
from liftgate_hil.stimuli.command_queue import post_values
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan
from liftgate_hil.transport.base import Line, LinkCounts

_WATCH = 0.02  # s between two looks at the wire
_PEERS = 0.001  # s between two turns of a peer
_PEERS_NS = round(_PEERS * 1e9)
_OBSERVERS = 0.002  # s between two looks of the observers
_FIGURES = 0.05  # s between two looks at the histograms
_FOREVER = 2**62
_HISTORY = 4.0  # s that the rings hold
_FULL_BUS = 12_000  # frames/s, more than 1 Mbit/s can carry with 8 bytes each


def memory_for(rate: float) -> Memory:
    """Return shared memory whose rings hold a few seconds, at a rate of rows [1/s]."""
    return Memory(int(_HISTORY * rate) + 64, int(_HISTORY * _FULL_BUS))


def feedback_identifiers(rig: Rig) -> list[int]:
    """Return the identifiers of a rig's messages that show a command's effect: with a motor current, else all."""
    shown = {wire.message for wire in rig.outputs if wire.quantity.endswith("_current")}
    names = shown or {wire.message for wire in rig.outputs}
    return [rig.identifier(name) for name in names]


class _Turns:
    """Gives a peer its turns, and reports their delay, without a tested ECU's own computing time, to the loop."""

    def __init__(self, peer: PeerNode, control: Any) -> None:
        self._peer, self._control = peer, control
        self._last = time.monotonic_ns()  # when the last turn ended
        self._kept = 0  # tick until which a late turn is reported

    def give(self, now_ns: int) -> None:
        """Give the peer one turn, at a model time [ns]."""
        begun = time.monotonic_ns()
        try:
            self._peer.poll(now_ns)
        finally:
            ended = time.monotonic_ns()
            late = (ended if self._peer.is_ours else begun) - self._last - _PEERS_NS
            self._last = ended
            control = self._control
            if late > control.turn_late_ns or control.tick > self._kept:
                control.turn_late_ns = max(0, late)
                self._kept = int(control.tick) + 1  # one whole tick of the loop sees it


@dataclass
class RealtimeRun:
    """Real-time run about to begin: `begin` compiles the loop, `run` runs it."""

    config: LoopConfig
    state: LoopState
    stimuli: StimulusPlan
    line: Line
    memory: Memory
    rig: Rig
    bitrate: float  # bit/s; NaN: the load is not known
    limit_ns: int
    say: Callable[[str], None]
    alarm: Callable[[str], None]  # called when the link is lost, or back
    peers: Sequence[PeerNode] = ()
    sinks: Sequence[Sink] = ()
    monitor: ProgressMonitor | None = None
    observers: Sequence[Observer] = ()
    realtime: Realtime | None = None
    # False: another run goes on where this one ends; that one reports what `realtime` was refused.
    is_last: bool = True
    is_first: bool = True  # False: another run has used the line before
    # Why the run is of no use any more, by what `sinks` have seen; "": it is.
    spoilt: Callable[[], str] = lambda: ""
    outcome: int = realtime_loop.ENDED
    _failure: BaseException | None = None
    _spoilt: str = ""  # why the run was ended
    _dropped_before: int = 0  # frames dropped before this run, by the count of the line; -1: not known
    _ecu_dropped_before: int = 0  # frames dropped on the way to peers before this run
    _unseen: int = 0  # rows and frames that were overwritten before `sinks` got them
    _room: realtime_loop.Room = field(default_factory=realtime_loop.make_room)
    _entered: threading.Event = field(default_factory=threading.Event)

    def begin(self) -> None:
        """Compile the loop's code, or load it from the cache, before time counts."""
        self._run = compiled(realtime_loop.run_realtime)
        nowhere = self._course(0)._replace(descriptor=-1, stimuli=copied(self.stimuli))
        scratch = Memory(1, 1)  # the recorder already looks at the real one
        self._run(self.config, copied(self.state), nowhere, scratch.shared, self._room)
        scratch.close()
        if self.realtime is not None and self.is_last:
            self.memory.touch()  # before it is locked; `prepare` collects garbage
        else:
            gc.collect()  # here, not during a peer's turns

    def run(self, ticks: int | None, stopped: Callable[[], bool]) -> None:
        """Run up to `ticks` in all (None: no end) or `stopped()`. Raises OverrunError, PlantDivergedError.

        Where nothing has run on the line yet, what has come before is dropped, and the peers send first.
        """
        if self.is_first:
            self.line.drain()
            for peer in self.peers if self.state.tick == 0 else ():
                peer.poll(0)
        self._room.drops[0] = self._dropped_before = self.line.dropped()
        self._ecu_dropped_before = self._dropped_for_peers()
        thread = threading.Thread(
            target=self._in_thread, args=(_FOREVER if ticks is None else ticks,), name="real-time loop"
        )
        control = self.memory.shared.control[0]
        thread.start()
        try:
            if self.realtime is not None and self.is_last:
                self._entered.wait()
                for each in self.realtime.reported():
                    self.say(each)
            realtime = self.realtime
            with nullcontext() if realtime is None else realtime.beside(self.line.threads):
                self._supervise(thread, stopped)
        finally:
            control.stop = 1
            thread.join()
        if self._failure is not None:
            raise self._failure
        if self._spoilt:
            raise OverrunError(self._spoilt)
        if self.outcome == realtime_loop.OVERRUN:
            raise OverrunError(
                f"the bench was late: the loop fell more than `overrun_limit` ({self.limit_ns / 1e6:.0f} ms) "
                "behind; use a lower `rate`, or a faster machine"
            )
        if self.outcome == realtime_loop.DIVERGED:
            raise PlantDivergedError.at(self._ticks * self.config.step)

    @property
    def _ticks(self) -> int:
        """Number of plant steps done since the scenario's time 0."""
        return int(self.state.tick - self.stimuli.origin[0])

    def timing(self) -> LoopTiming:
        """Return the loop's timing figures so far: lateness, execution time and delay."""
        rows = self.memory.shared.histograms
        return LoopTiming(*(distribution(rows[row]) for row in (LATENESS, EXECUTION, DELAY)))

    def _link(self) -> LinkCounts:
        """Return the counts of errors in sending and receiving: those of the loop and those of the line."""
        control, line = self.memory.shared.control[0], self.line.counts()
        return line._replace(
            send_failures=int(control.unsent) + line.send_failures,
            send_queue_full=int(control.unsent_full) + line.send_queue_full,
            receive_failures=int(control.receive_errors) + line.receive_failures,
            dropped=self._dropped(),
            stale_frames=int(control.stale) + line.stale_frames,
        )

    def _dropped(self) -> int:
        """Return the number of frames dropped in this run: on the way to the loop, or to an ECU in this process.

        The loop has those that came before a frame that it has read, the line all.
        """
        found, before = int(self.memory.shared.control[0].dropped), self._dropped_before
        if before >= 0:
            found = max(found, self.line.dropped() - before)
        return found + self._dropped_for_peers() - self._ecu_dropped_before

    def _dropped_for_peers(self) -> int:
        """Return the number of frames dropped on the way to the peers, before and in this run."""
        return sum(each.dropped for each in self.peers)

    def _sent(self) -> int:
        """Return the number of frames sent: those that the loop gave to the line, less its failures."""
        return int(self.memory.shared.control[0].sent) - self.line.counts().send_failures

    def summary(self) -> Summary:
        """Return the summary of the run so far."""
        control = self.memory.shared.control[0]
        seconds = self._ticks * self.config.step
        load = 100.0 * int(control.bits) / (self.bitrate * seconds) if seconds > 0.0 else 0.0
        return Summary(
            clock="realtime",
            ticks=self._ticks,
            model_time_s=seconds,
            overruns=int(control.overruns),
            timing=self.timing(),
            bus_load_percent=load,
            frames_sent=self._sent(),
            command_timeouts=self.state.timeouts,
            received=self.state.counts,
            link=self._link(),
            link_error=os.strerror(int(control.last_error)) if control.last_error else "",
            unseen_rows=self._unseen,
        )

    def _course(self, ticks: int) -> realtime_loop.RunParams:
        """Return the parameters of the machine-code loop for a run up to `ticks` ticks."""
        return realtime_loop.RunParams(
            self.line.descriptor,
            ticks,
            self.limit_ns,
            self.rig.command_identifier(),
            np.array(feedback_identifiers(self.rig), dtype=np.int64),
            self.stimuli,
            int(self.is_last),
        )

    def _in_thread(self, ticks: int) -> None:
        """Run the loop in the calling thread; keep its outcome, or the exception that `run` is to raise."""
        try:
            name_thread(LOOP)
            prepare_thread(self.realtime)
            self._entered.set()
            params, shared = self._course(ticks), self.memory.shared
            self.state, self.outcome = self._run(self.config, self.state, params, shared, self._room)
        except BaseException as error:  # raised by `run`
            self._failure = error
        finally:
            self._entered.set()

    def _supervise(self, thread: threading.Thread, stopped: Callable[[], bool]) -> None:
        """Until the loop's thread ends, watch the line and serve sinks, monitor, observers and peers."""
        shared = self.memory.shared
        control = shared.control[0]
        # Rows up to a tick whose frames are in the ring: rows are read first, then all frames up to that time.
        batch = int(1.0 / self.config.step)
        rows = RingReader(shared.rows, shared.control, "tick", batch)
        frames = RingReader(shared.frames, shared.control, "frames", CAPACITY)
        heard = ArrivalReader(shared, CAPACITY)
        turns = [_Turns(peer, control) for peer in self.peers]
        pause = _PEERS if self.peers else _OBSERVERS if self.observers else _WATCH
        next_look = next_figures = 0.0
        while thread.is_alive():
            if stopped():
                control.stop = 1
            now = time.monotonic()
            if now >= next_look:
                next_look = now + _WATCH
                news = self.line.watch(control)
                if news:
                    seconds = int(control.tick) * self.config.step
                    self.alarm(f"{seconds:.3f} s: {self.line.name} {news}")
                self._feed_sinks(rows, frames)
                self._spoilt = self.spoilt()
                if self._spoilt:
                    control.stop = 1
                    break
                self._report_progress()
            self._observe(heard)
            if now >= next_figures:
                next_figures = now + _FIGURES
                timing = self.timing().on_bus()
                post_values(self.stimuli.queue, timing._asdict())
            for turn in turns:
                turn.give(int(control.tick + self.stimuli.origin[0]) * self.config.step_ns)
            thread.join(pause)
        thread.join()
        self._observe(heard)
        self._feed_sinks(rows, frames)
        if not self._spoilt:  # else what the ECU has reported since is no story to tell
            self._report_progress(is_last=True)

    def _observe(self, heard: ArrivalReader) -> None:
        """Call the observers with the frames received since the last call; report how many were overwritten."""
        if not self.observers:
            return
        lost, come = heard.lost, heard.take()
        if heard.lost > lost:
            self.say(f"{heard.lost - lost} frames were overwritten before they were checked for bench commands")
        for observer in self.observers:
            observer.look(come, int(self.memory.shared.control.tick[0]) * self.config.step)

    def _report_progress(self, is_last: bool = False) -> None:
        """Call the progress monitor, if there is one, with the state of the loop now."""
        if self.monitor is None:
            return
        shared = self.memory.shared
        control = shared.control[0]
        row = shared.rows[(int(control.rows) - 1) % len(shared.rows)]
        moment = Moment(int(control.tick), row, self._sent(), int(control.overruns), self._link())
        self.monitor.look(moment, is_last)

    def _feed_sinks(self, rows: RingReader, frames: RingReader) -> None:
        """Call the sinks with the rows and frames written since the last call."""
        if self.sinks:
            taken, seen = rows.take(), frames.take()
            self._unseen = rows.lost + frames.lost
            for sink in self.sinks:
                sink.take(taken, seen)
