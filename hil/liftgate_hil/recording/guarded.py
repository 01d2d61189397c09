"""A recorder whose faults don't end the run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import LiftgateError, RecordingError
from liftgate_hil.recording.rotation import Parts
from liftgate_hil.recording.target import why

Say = Callable[[str], None]


def silent(text: str) -> None:
    """Nobody listens."""


class GuardedRecorder:
    """See Recorder. After the first fault it writes no more; that is said at once, and `failure` tells."""

    def __init__(self, what: str, parts: Parts, say: Say = silent) -> None:
        self._what = what
        self._parts = parts
        self._say = say
        self.failure = ""

    @property
    def files(self) -> list[str]:
        """The files that are there."""
        return self._parts.files

    @property
    def written(self) -> int:
        """See Recorder."""
        return self._parts.written

    def begin(self, epoch_ns: int) -> None:
        """See Recorder."""
        self._try(self._parts.begin, epoch_ns)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""
        self._try(self._parts.write_rows, rows)

    def write_frames(self, frames: Any) -> None:
        """See Recorder."""
        self._try(self._parts.write_frames, frames)

    def flush(self) -> None:
        """See Recorder."""
        self._try(self._parts.flush)

    def close(self) -> None:
        """See Recorder. What has failed before is closed as far as it can be."""
        try:
            self._parts.close(is_whole=not self.failure)
        except Exception as error:
            self.failure = self.failure or self._told(error)

    def _try(self, action: Callable[..., None], *arguments: object) -> None:
        if not self.failure:
            try:
                action(*arguments)
            except Exception as error:  # formats' libraries raise what they like
                self.failure = self._told(error)
                self._say(self.failure)

    def _told(self, error: Exception) -> str:
        if isinstance(error, OSError):
            text = why(error)
        else:
            text = str(error) if isinstance(error, LiftgateError) else repr(error)
        return f"{self._what}: recording ended: {text}"


def raise_failures(recorders: Sequence[GuardedRecorder]) -> None:
    """Raises RecordingError with what failed."""
    if failures := failures_of(recorders):
        raise RecordingError("; ".join(failures))


def failures_of(recorders: Sequence[GuardedRecorder]) -> list[str]:
    """What failed."""
    return [recorder.failure for recorder in recorders if recorder.failure]
