"""Selected frames of a bus log, with the time span of the log and its silences (gaps without frames)."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import FD_FLAGS, REMOTE, Frames, no_logged
from liftgate_hil.config.rig import Rig
from liftgate_hil.formats.open import open_file
from liftgate_hil.formats.recording import AS_IT_IS, ReadOptions

_ENOUGH, _OFTEN = 20, 1.8  # frames of which the rate is told, and times its cycle from which it is that of two
SILENT_S = 0.1  # longest silence that is normal: messages come more often


class LogFrames(NamedTuple):
    """Selected frames of a bus log; times count from `start_ns`."""

    times_ns: NDArray[np.int64]  # as in the file, in its order
    frames: Frames
    notes: tuple[str, ...]  # remarks on what was noticed
    start_ns: int  # wall clock [ns since 1970]; 0: none applies
    span: tuple[float, float] | None  # s, first to last frame of the log; None: no frames
    # Begin and end [s] of each time without frames that is longer than SILENT_S.
    silences: tuple[tuple[float, float], ...]


def read_frames(
    path: Path, messages: Collection[str], rig: Rig, others: Collection[int] = (), how: ReadOptions = AS_IT_IS
) -> LogFrames:
    """Read the frames of a rig's `messages`, and those with the identifiers `others`, from a bus log.

    Raises ConfigError if the log cannot be read.
    """
    wanted = np.array(sorted({*(rig.identifier(name) for name in messages), *others}), dtype=np.int64)
    log, watch, ours = open_file(path, how=how), _Watch(), [no_logged()]
    for frames in log.frames():
        watch.see(frames["time_ns"])
        mine = np.isin(frames["identifier"] & ~(FD_FLAGS | REMOTE), wanted)
        ours.append(frames[mine] if not mine.all() else frames)
    found = np.concatenate(ours)
    plain = Frames(len(found), found["identifier"], found["length"], found["payload"])
    notes = (*log.notes, *_doubled(found, messages, rig))
    return LogFrames(found["time_ns"], plain, notes, log.start_ns, watch.span, tuple(watch.silences))


def _doubled(frames: NDArray[np.void], messages: Collection[str], rig: Rig) -> Iterator[str]:
    """Yield a note for each message that comes much more often than its cycle says: two nodes may send it."""
    identifiers = frames["identifier"] & ~(FD_FLAGS | REMOTE)
    for name in messages:
        times, cycle_ns = frames["time_ns"][identifiers == rig.identifier(name)], 1e6 * rig.cycle_ms(name)
        if len(times) < _ENOUGH or not cycle_ns:
            continue
        often = (len(times) - 1) * cycle_ns / max(int(times.max() - times.min()), 1)
        if often > _OFTEN:
            yield (
                f"{name} comes {often:.3g} times as often as every {1e-6 * cycle_ns:g} ms, its cycle: "
                "are two benches in the log, under the name of one bus?"
            )


class _Watch:
    """Collector of a log's time span and silences (gaps without frames), from the timestamps of all frames."""

    def __init__(self) -> None:
        self._first, self._last = 2**62, -(2**62)
        self.silences: list[tuple[float, float]] = []

    def see(self, times_ns: NDArray[np.int64]) -> None:
        """Extend the span and the silences by the timestamps [ns] of the next frames."""
        if not len(times_ns):
            return
        before = self._last if self._last > -(2**62) else int(times_ns[0])
        latest = np.maximum.accumulate(np.concatenate([[before], times_ns]))
        quiet = np.flatnonzero(np.diff(latest) > SILENT_S * 1e9)
        self.silences += [(latest[k] / 1e9, latest[k + 1] / 1e9) for k in quiet.tolist()]
        self._first, self._last = min(self._first, int(times_ns.min())), int(latest[-1])

    @property
    def span(self) -> tuple[float, float] | None:
        """The earliest and the latest timestamp [s]; None if there are none."""
        return (self._first / 1e9, self._last / 1e9) if self._first <= self._last else None
