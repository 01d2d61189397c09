"""Rows as text: CSV with full double precision, a row a tick; for recordings and for `simulate`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import Frames
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS, columns_of


class RowText:
    """Some columns of rows (n, ROW_WIDTH) of signals.COLUMNS as lines of CSV."""

    def __init__(self, names: Sequence[str]) -> None:
        self.head = ",".join(names) + "\n"
        self._keep = [COLUMN_PLACE[name] for name in names]
        self._whole = [k for k, name in enumerate(names) if COLUMNS[name].is_whole]

    def lines(self, rows: NDArray[np.float64]) -> str:
        """The lines of these rows."""
        kept = rows[:, self._keep]
        are_finite = np.isfinite(kept[:, self._whole]).all()
        lines = []
        for row in kept.tolist():
            for k in self._whole:
                if are_finite or np.isfinite(row[k]):
                    row[k] = int(row[k])
            lines.append(",".join(map(repr, row)))
        return "\n".join(lines) + "\n" if lines else ""


class CsvRecorder:
    """See Recorder."""

    def __init__(self, path: Path, drives: int) -> None:
        self._text = RowText(columns_of(drives))
        self._stream = path.open("w", encoding="ascii", newline="")
        self._stream.write(self._text.head)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""
        self._stream.write(self._text.lines(rows))

    def write_frames(self, frames: Frames, times: Sequence[float]) -> None:
        """See Recorder."""

    def flush(self) -> None:
        """See Recorder."""
        self._stream.flush()

    def close(self) -> None:
        """See Recorder."""
        self._stream.close()
