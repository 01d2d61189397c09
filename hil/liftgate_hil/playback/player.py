"""Plays a recording's frames onto a bus.

The loop runs in a thread of its own; this thread fills the ring of the loop and supervises the wire.
"""

from __future__ import annotations

import bisect
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compiled
from liftgate_hil.codec.frames import Frames
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.errors import ConfigError, LiftgateError
from liftgate_hil.formats.open import open_recording
from liftgate_hil.formats.recording import AS_IT_IS, ReadOptions
from liftgate_hil.loop.datagrams import POSSIBLE
from liftgate_hil.loop.histogram import BINS, NOTHING, Quantiles, distribution, note
from liftgate_hil.loop.listener import Listener
from liftgate_hil.loop.priority import Realtime, prepare_thread
from liftgate_hil.loop.realtime_loop import MONOTONIC, clock_ns, make_room
from liftgate_hil.loop.replay_loop import TRIAL_NS, Schedule, empty_schedule, params_for, play, put
from liftgate_hil.loop.rings import LATENESS, Memory
from liftgate_hil.loop.statistics import in_words
from liftgate_hil.plan.provenance import Provenance
from liftgate_hil.playback.selection import DueTimes, Selection, playable
from liftgate_hil.transport.base import Line, LinkCounts, Transport
from liftgate_hil.transport.find import Way, open_line

_WATCH_S = 0.05  # between two checks of the wire
_SWITCH_S = 0.0005  # time this thread keeps the interpreter lock while a pump's thread waits

Block = tuple[NDArray[np.int64], NDArray[np.void]]  # when frames are due [ns], and the frames


@dataclass(frozen=True)
class Replay:
    """Settings of a replay: the recording, the selection of its frames, the speed and the repetitions."""

    recording: Path
    selection: Selection = field(default_factory=Selection)
    how: ReadOptions = AS_IT_IS  # to read it
    speed: float = 1.0
    times: int | None = 1  # None: until it is stopped
    realtime: bool | None = None  # None: FIFO scheduling and locked memory where they are granted
    cpu: int | None = None


# fmt: off
# A field with its description is a row of a table.


@dataclass
class Played(DescribedResult):
    """The summary of a replay."""

    direction: Annotated[str, Shown("which frames were sent: `received`, `sent` or `both`, as they were "
        "recorded")] = ""
    is_complete: Annotated[bool, Shown("false: it was stopped")] = False
    rounds: Annotated[int, Shown("rounds that were begun, or played to their end")] = 0
    played_s: Annotated[float, Shown("from the first frame's due time to that of the last one sent [s]")] = 0.0
    took_s: Annotated[float, Shown("elapsed time [s]")] = 0.0
    frames_due: Annotated[int, Shown("frames whose due time has come")] = 0
    frames_sent: Annotated[int, Shown("frames that were sent")] = 0
    frames_not_sent: Annotated[int, Shown("frames that were not sent")] = 0
    error_frames_left_out: Annotated[int, Shown("error frames of the recording, which are not sent")] = 0
    clock_set_back: Annotated[int, Shown("times that a time stamp was far behind the one before")] = 0
    ring_empty: Annotated[int, Shown("times that a frame was late because the recording was read too slowly")] = 0
    lateness: Annotated[Quantiles, Shown("from when a frame was due until the wire had it",
        prefix="lateness")] = NOTHING
    link: Annotated[LinkCounts, Shown("errors of the link, see Link")] = field(default_factory=LinkCounts)
    link_error: Annotated[str, Shown("the operating system's text for the link's last error; empty: none")] = ""
    notes: Annotated[tuple[str, ...], Shown("what was noticed while reading and playing, as texts")] = ()
    stop_reason: Annotated[str, Shown("`end`: the recording was played, else what stopped it: `SIGINT`, "
        "`SIGTERM`")] = "end"
    provenance: Annotated[Provenance | None, Shown("see Provenance")] = None

    # fmt: on
    def lines(self) -> list[str]:
        """Return the summary of the replay as lines of text."""
        rounds = f", {self.rounds} rounds" if self.rounds > 1 else ""
        which = "" if self.direction == "both" else f" (recorded as {self.direction})"
        lines = [
            f"frames sent {self.frames_sent}{which}, in {self.took_s:.3f} s{rounds}",
            f"lateness {in_words(self.lateness)}",
        ]
        if self.frames_not_sent:
            why = f": {self.link_error}" if self.link_error else ""
            lines.append(f"not sent: {self.frames_not_sent} frames{why}")
        if self.error_frames_left_out:
            lines.append(f"omitted: {self.error_frames_left_out} error frames")
        if self.clock_set_back:
            lines.append(f"the logger's clock was set back {self.clock_set_back} times")
        if self.ring_empty:
            lines.append(f"recording read too slowly {self.ring_empty} times")
        if faults := self.link.in_words():
            lines.append(f"link: {', '.join(faults.values())}")
        return lines


class NotedTransport:
    """Transport wrapper that records how late each frame is at the moment when the driver has it.

    Only there it is known how long a thread has waited for the interpreter lock.
    """

    def __init__(self, transport: Transport, schedule: Schedule) -> None:
        self._transport, self._schedule = transport, schedule
        self.name = transport.name
        self._count = 0
        self.histogram = np.zeros(BINS, dtype=np.int64)
        self.receive, self.close, self.counts = transport.receive, transport.close, transport.counts
        self.came_ns = transport.came_ns
        self._room = make_room()

    @property
    def is_up(self) -> bool:
        """Whether the link is up, as far as is known."""
        return self._transport.is_up

    def send(self, frames: Frames) -> None:
        """Send frames, in the order in which the loop has passed them on, and record their lateness."""
        failed = self._transport.counts().send_failures
        self._transport.send(frames)
        now = clock_ns(MONOTONIC, self._room)
        schedule, start = self._schedule, int(self._schedule.position[0].start_ns)
        for _ in range(frames.count):
            due = int(schedule.handed[self._count % len(schedule.handed)])
            self._count += 1
            if self._transport.counts().send_failures == failed:
                note(self.histogram, now - start - due)


class Player:
    """Player of one replay; `run` opens the wire, plays to the end or until `stopped()`, and closes it.

    `progress` is called a few times a second with when the last frame that was played was due, when the last of
    all will be (0: not known yet) [s since the beginning], and how many were sent.
    """

    def __init__(
        self,
        replay: Replay,
        way: Way,
        listener: Listener,
        stopped: Callable[[], bool],
        progress: Callable[[float, float, int], None],
    ) -> None:
        if not POSSIBLE:
            raise LiftgateError("a replay needs 64-bit Linux")
        self._listener, self._stopped, self._progress = listener, stopped, progress
        self._way = way
        self.played = Played()
        self._source = open_recording(replay.recording, replay.how)
        if self._source.channel is None:
            raise ConfigError(f"{self._source.path}: holds only rows; allowed: a recording with frames")
        selection = replay.selection
        if not selection.direction:
            has_sent = any((frames["is_sent"] != 0).any() for frames in self._source.frames())
            selection = replace(selection, direction="sent" if has_sent else "both")
        self._replay = replace(replay, selection=selection)
        self._course = DueTimes(replay.speed, selection.begin, selection.end)
        self.played.direction = selection.direction
        self._schedule = empty_schedule()
        self._blocks = self._all_blocks()
        self._waiting: Block | None = None
        self._begins: list[int] = []  # number of the first frame of each round read so far
        self._count = 0  # frames read
        self._failure: BaseException | None = None
        self._took_s = 0.0

    def run(self) -> None:
        """Play the recording; `played` is its summary, failed or not. Raises ConfigError, TransportError."""
        self._code = machine_code()
        # Issues at the beginning of the recording are reported before anything is played.
        while self._fill() and len(self._begins) == 1 and not self._stopped():
            pass
        if self._stopped():
            return
        if not self._schedule.position[0].written:
            chosen = self._replay.selection
            what = "no frame" if chosen.direction == "both" else f"no frame {chosen.direction}"
            if replace(chosen, direction="both") == Selection("both"):
                why = f"{what} in the recording; allowed: a recording with such frames"
            else:
                why = f"{what} matches the selection; allowed: a selection that holds frames"
            raise ConfigError(f"{self._source.path}: {why}")
        memory, noted = Memory(1, 1), list[NotedTransport]()

        def seen_by(transport: Transport) -> Transport:
            noted.append(NotedTransport(transport, self._schedule))
            return noted[0]

        switch = sys.getswitchinterval()
        line = None
        try:
            line = open_line(self._way, seen_by)
            sys.setswitchinterval(_SWITCH_S)
            self._play(line, memory, is_kernels=not noted)
        finally:
            sys.setswitchinterval(switch)
            if line is not None:
                line.close()
                self._sum_up(line, memory, noted[0].histogram if noted else None)
            for note in self._source.notes:
                self._listener.say(f"{self._source.path}: {note}")
            memory.close()

    def _all_blocks(self) -> Iterator[Block]:
        """Yield due times and frames, round after round; a recording that fits into the ring is read once."""
        times, kept, is_kept = self._replay.times, list[NDArray[np.void]](), False
        while times is None or len(self._begins) < times:
            self._begins.append(self._count)
            for frames in kept if is_kept else self._playable():
                self._count += len(frames)
                if len(self._begins) == 1 and self._count <= len(self._schedule.due):
                    kept.append(frames)
                yield self._course.due(frames), frames
            if self._count == self._begins[-1]:
                return
            if len(self._begins) == 1:
                is_kept = self._count <= len(self._schedule.due)
            if times != len(self._begins):
                self._course.begin_again()

    def _playable(self) -> Iterator[NDArray[np.void]]:
        """Yield the selected frames, without those that cannot be sent. Raises ConfigError."""
        has_fd = self._way.is_fd or self._way.serial is not None
        for block in self._replay.selection.of(self._source.frames()):
            frames, left_out = playable(block, has_fd)
            self.played.error_frames_left_out += left_out
            if len(frames):
                yield frames

    def _fill(self) -> bool:
        """Put a block of frames into the ring; False: it is full, or none is left, which marks it as whole."""
        position = self._schedule.position[0]
        block = self._waiting or next(self._blocks, None)
        if block is None:
            position.is_whole = 1
            return False
        due, frames = block
        count = put(self._schedule, due, frames)
        self._waiting = (due[count:], frames[count:]) if count < len(due) else None
        return self._waiting is None

    def _play(self, line: Line, memory: Memory, is_kernels: bool) -> None:
        """Run the loop in its thread from the first frame to the last. Raises TransportError, ConfigError."""
        schedule, control = self._schedule, memory.shared.control[0]
        asked = self._replay.realtime
        realtime = None if asked is False else Realtime(self._replay.cpu, bool(asked))
        room = make_room()
        room.writing.pause[1] = TRIAL_NS
        params = params_for(line.descriptor, is_kernels)
        if realtime is not None:
            realtime.prepare()

        def in_thread() -> None:
            try:
                prepare_thread(realtime)
                for each in [] if realtime is None else realtime.reported():
                    self._listener.say(each)
                self._code(schedule, params, memory.shared, room)
            except BaseException as error:  # raised by the thread that started this one
                self._failure = error

        thread = threading.Thread(target=in_thread, name="replay")
        began = time.monotonic()
        thread.start()
        try:
            while thread.is_alive():
                if self._stopped():
                    control.stop = 1
                until = time.monotonic() + _WATCH_S
                while not schedule.position[0].is_whole and self._fill():
                    if time.monotonic() > until:
                        break
                self._supervise(line, control)
                thread.join(_WATCH_S)
        finally:
            control.stop = 1
            thread.join()
            self._took_s = time.monotonic() - began
            if realtime is not None:
                realtime.release()
        if self._failure is not None:
            raise self._failure

    def _supervise(self, line: Line, control: Any) -> None:
        """Pass news of the wire to the listener as an alarm, and report the progress."""
        news = line.watch(control)
        if news:
            self._listener.alarm(f"{self._seconds():.3f} s: {line.name} {news}")
        position = self._schedule.position[0]
        end = self._due(int(position.written)) if position.is_whole else 0.0
        self._progress(self._seconds(), end, int(position.accepted))

    def _seconds(self) -> float:
        """Return the due time of the last frame that was played [s since the beginning]."""
        return self._due(int(self._schedule.position[0].played))

    def _due(self, count: int) -> float:
        """Return the due time of frame `count` (from 1) [s since the beginning]; it must still be in the ring."""
        due = self._schedule.due
        return float(due[(count - 1) % len(due)]) * 1e-9 if count else 0.0

    def _sum_up(self, line: Line, memory: Memory, histogram: NDArray[np.int64] | None) -> None:
        """Fill `played` with the summary of the replay; the line must be closed for complete counts."""
        position, control = self._schedule.position[0], memory.shared.control[0]
        mine = line.counts()
        link = mine._replace(
            send_failures=int(control.unsent) + mine.send_failures,
            send_queue_full=int(control.unsent_full) + mine.send_queue_full,
            receive_failures=int(control.receive_errors) + mine.receive_failures,
            before_start=0,  # a player ignores what it receives
        )
        self.played = replace(
            self.played,
            is_complete=bool(position.is_whole and position.played == position.written),
            rounds=bisect.bisect_left(self._begins, int(position.played)),
            played_s=self._seconds(),
            took_s=self._took_s,
            frames_due=int(position.played),
            frames_sent=int(position.played) - link.send_failures,
            frames_not_sent=link.send_failures,
            clock_set_back=self._course.set_back,
            ring_empty=int(position.starved),
            lateness=distribution(memory.shared.histograms[LATENESS] if histogram is None else histogram),
            link=link,
            link_error=os.strerror(int(control.last_error)) if control.last_error else "",
        )


def machine_code() -> Any:
    """Return the replay's loop as machine code, compiled or loaded already, before timing matters."""
    code, scratch, nothing = compiled(play), Memory(1, 1), empty_schedule(1)
    nothing.position[0].is_whole = 1
    code(nothing, params_for(-1, is_kernels=True), scratch.shared, make_room())
    scratch.close()
    return code
