"""CSV of snapshots: full double precision, a row a tick, flushed as it grows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil.codec.frames import Frames
from hil.loop.tick import Snapshot

_FLUSH_ROWS = 200


def columns(fields: Sequence[str], drives: int) -> list[int]:
    """Which fields a gate of so many drives has."""
    return [i for i, name in enumerate(fields) if drives == 2 or not name.startswith("right_")]


def plain(value: Any) -> str:
    """A number with all its digits, whether Python's or numpy's."""
    return repr(value if type(value) in (float, int) else value.item())


class CsvRecorder:
    """See Recorder."""

    def __init__(self, path: Path, drives: int) -> None:
        self._keep = columns(Snapshot._fields, drives)
        self._stream = path.open("w", encoding="ascii", newline="")
        self._stream.write(",".join(Snapshot._fields[i] for i in self._keep) + "\n")
        self._rows = 0

    def write(self, time: float, snapshot: Snapshot, received: Frames, sent: Frames) -> None:
        """See Recorder."""
        # Without the compiler some fields are numpy's, which write themselves otherwise.
        cells = [plain(snapshot[i]) for i in self._keep]
        self._stream.write(",".join(cells) + "\n")
        self._rows += 1
        if self._rows % _FLUSH_ROWS == 0:
            self._stream.flush()

    def close(self) -> None:
        """See Recorder."""
        self._stream.close()
