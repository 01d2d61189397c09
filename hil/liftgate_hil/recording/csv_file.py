"""CSV: a row a tick, all columns, every number to the last bit."""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.recording.content import Content
from liftgate_hil.recording.csv_text import CsvText


class CsvRecorder:
    """See Recorder."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        self._stream = stream
        self._text = CsvText(content.columns, content.row)
        self.written = 0
        self._write(self._text.head)

    def begin(self, epoch_ns: int) -> None:
        """See Recorder."""

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""
        self._write(self._text.lines(rows))

    def write_frames(self, frames: Any) -> None:
        """See Recorder."""

    def flush(self) -> None:
        """See Recorder."""
        self._stream.flush()

    def close(self) -> None:
        """See Recorder."""
        self._stream.close()

    def _write(self, text: bytes) -> None:
        self._stream.write(text)
        self.written += len(text)
