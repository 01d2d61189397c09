"""CSV of snapshots: full double precision, a row a tick."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path

from liftgate_hil.codec.frames import Frames
from liftgate_hil.snapshot import WHOLE, Snapshot


def columns(fields: Sequence[str], drives: int) -> list[int]:
    """Which fields a gate of so many drives has."""
    return [i for i, name in enumerate(fields) if drives == 2 or not name.startswith("right_")]


class CsvRecorder:
    """See Recorder."""

    def __init__(self, path: Path, drives: int) -> None:
        self._keep = columns(Snapshot._fields, drives)
        self._whole = [Snapshot._fields[i] in WHOLE for i in self._keep]
        self._stream = path.open("w", encoding="ascii", newline="")
        self._stream.write(",".join(Snapshot._fields[i] for i in self._keep) + "\n")

    def write_snapshot(self, snapshot: Snapshot) -> None:
        """See Recorder."""
        cells = [
            str(int(snapshot[i])) if whole and isfinite(snapshot[i]) else repr(float(snapshot[i]))
            for i, whole in zip(self._keep, self._whole, strict=True)
        ]
        self._stream.write(",".join(cells) + "\n")

    def write_frames(self, frames: Frames, times: Sequence[float]) -> None:
        """See Recorder."""

    def flush(self) -> None:
        """See Recorder."""
        self._stream.flush()

    def close(self) -> None:
        """See Recorder."""
        self._stream.close()
