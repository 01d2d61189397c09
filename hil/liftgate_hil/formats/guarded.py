"""Writer of a recording whose errors are reported and kept instead of ending the run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import LiftgateError, RecordingError
from liftgate_hil.formats.rotation import Parts
from liftgate_hil.formats.target import why
from liftgate_hil.signals import COLUMN_PLACE

Say = Callable[[str], None]


def silent(text: str) -> None:
    """Ignore a message: the default of `say` (the callable that shows messages)."""


class GuardedWriter:
    """Writer that stops at its first error, reports it at once, and keeps it in `failure`."""

    def __init__(self, what: str, parts: Parts, say: Say = silent) -> None:
        self._what = what
        self._parts = parts
        self._say = say
        self._time_s = -math.inf  # of the last row or frame, which an error may concern
        self.failure = ""

    @property
    def files(self) -> list[str]:
        """Paths of the recording's files; after an error, text files in place of an unfinished file."""
        files, texts = self._parts.files, self._texts()
        return [*files[:-1], *texts] if self.failure and texts else files

    @property
    def written(self) -> int:
        """Number of bytes written so far to the open file."""
        return self._parts.written

    def begin(self, epoch_ns: int) -> None:
        """Begin the recording; `epoch_ns`: wall clock at the start of the run [ns since 1970], 0: unknown."""
        self._try(self._parts.begin, epoch_ns)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write rows (n, ROW_WIDTH); nothing after an error."""
        if len(rows):
            self._reach(float(rows[-1, COLUMN_PLACE["time_s"]]))
        self._try(self._parts.write_rows, rows)

    def write_frames(self, frames: Any) -> None:
        """Write frames (n,) LOGGED; nothing after an error."""
        if len(frames):
            self._reach(1e-9 * int(frames["time_ns"][-1]))
        self._try(self._parts.write_frames, frames)

    def write_mark(self, time_s: float, text: str) -> None:
        """Write an operator's mark at a time [s]; nothing after an error."""
        self._try(self._parts.write_mark, time_s, text)

    def flush(self) -> None:
        """Flush the file; do nothing after an error."""
        self._try(self._parts.flush)

    def close(self) -> None:
        """Complete the file, after an error as far as possible; only store an error on closing in `failure`."""
        try:
            self._parts.close(is_whole=not self.failure)
        except Exception as error:
            self.failure = self.failure or self._reported(error)

    def _reach(self, time_s: float) -> None:
        """Store the time [s] that the recording reaches with the next write, for an error's message."""
        if not self.failure:
            self._time_s = max(time_s, self._time_s)

    def _try(self, action: Callable[..., None], *arguments: object) -> None:
        """Call `action(*arguments)` unless an earlier call failed; report an error, and store it in `failure`."""
        if not self.failure:
            try:
                action(*arguments)
            except Exception as error:  # the formats' libraries may raise anything
                self.failure = self._reported(error)
                self._say(self.failure)

    def _texts(self) -> list[str]:
        """Return the paths of the text files that are not empty and stand in for the unfinished file."""
        return [each for each in self._parts.texts if Path(each).is_file() and Path(each).stat().st_size]

    def _reported(self, error: Exception) -> str:
        if isinstance(error, OSError):
            text = why(error)
        else:
            text = str(error) if isinstance(error, LiftgateError) else repr(error)
        when = "" if self._time_s < 0.0 else f" at {self._time_s:.3f} s"
        texts = self._texts()
        left = f"; the data recorded so far is in {' and '.join(texts)}" if texts and texts[0] not in text else ""
        return f"{self._what}: recording ended{when}: {text}{left}"


def raise_failures(recorders: Sequence[GuardedWriter]) -> None:
    """Raise RecordingError with the errors of all writers that failed, if any did."""
    if failures := failures_of(recorders):
        raise RecordingError("; ".join(failures))


def failures_of(recorders: Sequence[GuardedWriter]) -> list[str]:
    """Return the error messages of the writers that failed."""
    return [recorder.failure for recorder in recorders if recorder.failure]
