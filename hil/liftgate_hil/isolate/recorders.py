"""Recorders: pass the rows and frames of a run, or of its loop's rings, to the writers of its files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.writer import Writer, truncated_to_us
from liftgate_hil.loop.datagrams import CAPACITY
from liftgate_hil.loop.rings import Memory, RingReader
from liftgate_hil.signals import COLUMN_PLACE

_LATE_NS = 100_000_000  # ns that a frame may be out of order: received ones are logged a tick late


class RingPlace(NamedTuple):
    """Place in the loop's rings: numbers of rows and frames that the loop has written so far."""

    rows: int
    frames: int


EVERYWHERE = RingPlace(2**62, 2**62)


def place_in(memory: Memory) -> RingPlace:
    """Return the present place in the loop's rings."""
    control = memory.shared.control
    return RingPlace(int(control["rows"][0]), int(control["frames"][0]))


class RingRecorder:
    """Passes rows and frames from the rings, through a sieve if given, to writers; buffers them until `write_to`.

    Files may take longer to open than the rings hold, as a format's library is imported with the first one.
    """

    def __init__(
        self, memory: Memory, content: Content, sieve: Sieve | None = None, begin: RingPlace | None = None
    ) -> None:
        shared = memory.shared
        self._rows = RingReader(shared.rows, shared.control, "rows")
        self._frames = RingReader(shared.frames, shared.control, "frames", CAPACITY)
        self._control = shared.control
        if begin is not None:
            self._rows.skip(begin.rows)
            self._frames.skip(begin.frames)
        self._content, self._sieve = content, sieve
        self._writers: Sequence[Writer] | None = None  # None: not open yet
        self._kept: list[Callable[[Sequence[Writer]], None]] = []  # what is to be written then
        self._waiting: Any = no_logged()
        self._has_begun = False
        self.span: tuple[float, float] | None = None  # s, first and last row that were written

    def write_to(self, writers: Sequence[Writer]) -> None:
        """Write the buffered rows and frames to the files of the writers, and later ones at once."""
        self._writers, kept, self._kept = writers, self._kept, []
        for write in kept:
            write(writers)

    def _put(self, write: Callable[[Sequence[Writer]], None]) -> None:
        """Call a function with the writers, at once or as soon as there are writers."""
        if self._writers is None:
            self._kept.append(write)
        else:
            write(self._writers)

    def end_at(self, place: RingPlace) -> None:
        """Set the place in the rings at which the recording ends."""
        self._rows.end, self._frames.end = place

    @property
    def lost(self) -> int:
        """Number of rows plus frames that were overwritten before they were read."""
        return self._rows.lost + self._frames.lost

    def take(self, most: RingPlace = EVERYWHERE, is_last: bool = False) -> None:
        """Write new rows and frames up to a place; frames that others may precede wait unless `is_last`."""
        rows = self._rows.take(most.rows)
        come = self._frames.take(most.frames)
        frames = self._in_order(come, is_last)
        if len(rows) or len(frames):
            self.begin()
        if self._sieve is not None:
            rows, frames = self._sieve.kept(rows, frames, come)
        if len(rows):
            times = rows[:, COLUMN_PLACE["time_s"]]
            self.span = float(times[0] if self.span is None else self.span[0]), float(times[-1])
        self._put(lambda writers: write_block(writers, self._content, rows, frames))

    def mark(self, time_s: float, text: str) -> None:
        """Write a mark at a time [s] of the run to the files."""
        self.begin()

        def write(writers: Sequence[Writer]) -> None:
            for writer in writers:
                writer.write_mark(time_s, text)

        self._put(write)

    def begin(self) -> None:
        """Begin the files, with the wall-clock time of the run's start, unless they have begun."""
        if self._has_begun:
            return
        self._has_begun = True
        epoch_ns = truncated_to_us(int(self._control["epoch_ns"][0]))

        def write(writers: Sequence[Writer]) -> None:
            for writer in writers:
                writer.begin(epoch_ns)

        self._put(write)

    def _in_order(self, come: Any, is_last: bool) -> Any:
        """Return the frames that no later one can precede, in the order of time; buffer the others."""
        frames = np.concatenate([self._waiting, come])
        frames = frames[np.argsort(frames["time_ns"], kind="stable")]
        count = len(frames)
        if count and not is_last:
            count = int(np.searchsorted(frames["time_ns"], frames["time_ns"][-1] - _LATE_NS))
        self._waiting = frames[count:]
        return frames[:count]


_ROWS = 100  # rows that are buffered before they are written


class Sieve(Protocol):
    """Filter that selects the rows and frames of a run that are recorded."""

    def kept(self, rows: NDArray[np.float64], frames: Any, come: Any) -> tuple[NDArray[np.float64], Any]:
        """Return the rows and frames to be recorded now, from those given and earlier ones.

        `rows` and `frames` are in the order of time; `come` are the frames that the loop has logged meanwhile.
        """


class RecordingSink:
    """Passes rows and frames to writers in blocks, through a sieve if given; times count from the run's start."""

    def __init__(self, writers: Sequence[Writer], content: Content, sieve: Sieve | None = None) -> None:
        self._writers, self._content, self._sieve = writers, content, sieve
        self._rows: list[NDArray[np.float64]] = []
        self._frames: list[Any] = []
        for writer in writers:
            writer.begin(0)

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Buffer rows and frames, and write them once there are enough rows."""
        self._rows.append(rows if len(rows) >= _ROWS else rows.copy())
        self._frames.append(frames.copy())
        if sum(map(len, self._rows)) >= _ROWS:
            self.flush()

    def flush(self) -> None:
        """Write the buffered rows and frames, down to the operating system: an ECU may crash this process."""
        if not self._rows:
            return
        rows = self._rows[0] if len(self._rows) == 1 else np.concatenate(self._rows)
        frames = np.concatenate(self._frames)
        self._rows, self._frames = [], []
        if self._sieve is not None:
            rows, frames = self._sieve.kept(rows, frames, frames)
        write_block(self._writers, self._content, rows, frames)


def write_block(writers: Sequence[Writer], content: Content, rows: NDArray[np.float64], frames: Any) -> None:
    """Write rows (n, ROW_WIDTH) and frames (m,) LOGGED, either possibly empty, to all writers, and flush."""
    rows = content.whole(rows)
    for writer in writers:
        if len(rows):
            writer.write_rows(rows)
        if len(frames):
            writer.write_frames(frames)
        writer.flush()
