"""Rows as text: CSV with full double precision, a row a tick; for recordings and for `simulate`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_hil.codec.frames import Frames
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS, columns_of


class RowText:
    """Some columns of rows (n, ROW_WIDTH) of signals.COLUMNS as lines of CSV."""

    def __init__(self, names: Sequence[str]) -> None:
        self.head = (",".join(names) + "\n").encode()
        self._keep = [COLUMN_PLACE[name] for name in names]
        self._whole = [k for k, name in enumerate(names) if COLUMNS[name].is_whole]

    def lines(self, rows: NDArray[np.float64]) -> bytes:
        """The lines of these rows; every number in its shortest form that reads back the same."""
        if not len(rows):
            return b""
        kept = rows[:, self._keep]
        finite = np.isfinite(kept).all(axis=1)
        if not finite.all():  # a plant that has diverged; JSON has no word for that
            first = int(np.argmin(finite))
            rest = "".join(",".join(map(repr, row)) + "\n" for row in kept[first:].tolist())
            return self.lines(rows[:first]) + rest.encode()
        cells = kept.tolist()
        for row, whole in zip(cells, kept[:, self._whole].astype(np.int64).tolist(), strict=True):
            for place, value in zip(self._whole, whole, strict=True):
                row[place] = value
        return orjson.dumps(cells)[2:-2].replace(b"],[", b"\n") + b"\n"


class CsvRecorder:
    """See Recorder."""

    def __init__(self, path: Path, drives: int) -> None:
        self._text = RowText(columns_of(drives))
        self._stream = path.open("wb")
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
