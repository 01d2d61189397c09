"""CSV: a row a tick, all columns, every number to the last bit. In real time one column more, when the run began:
a bus log beside it has the computer's time.
"""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.mcap_layout import START_COLUMN
from liftgate_hil.recording.content import Content
from liftgate_hil.recording.csv_text import CsvText
from liftgate_plant.signals import TIME


class CsvRecorder:
    """See Recorder."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        self._stream = stream
        self._content = content
        self._start: float | None = None  # s since 1970
        self._text: CsvText | None = None
        self.written = 0

    def begin(self, epoch_ns: int) -> None:
        """See Recorder."""
        columns, row = list(self._content.columns), dict(self._content.row)
        if epoch_ns:
            self._start = epoch_ns / 1e9
            columns, row = [*columns, START_COLUMN], {**row, START_COLUMN: TIME}
        self._text = CsvText(columns, row)
        self._write(self._text.head)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""
        if self._start is not None:
            rows = np.column_stack([rows, np.full(len(rows), self._start)])
        self._write(self._begun().lines(rows))

    def write_frames(self, frames: Any) -> None:
        """See Recorder."""

    def flush(self) -> None:
        """See Recorder."""
        self._stream.flush()

    def close(self) -> None:
        """See Recorder."""
        self._begun()
        self._stream.close()

    def _begun(self) -> CsvText:
        """With its header; where nobody has said when the run began, none counts."""
        if self._text is None:
            self.begin(0)
        assert self._text is not None
        return self._text

    def _write(self, text: bytes) -> None:
        self._stream.write(text)
        self.written += len(text)
