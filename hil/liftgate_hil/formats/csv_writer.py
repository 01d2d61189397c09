"""CSV recordings as they are written: a header, then one row of numbers per tick, each exact to the last bit.

A recording made in real time has one more column, the start of the run: a bus log beside it has the computer's
time.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.formats.content import Content
from liftgate_hil.formats.csv_text import CsvText
from liftgate_hil.formats.mcap_layout import START_COLUMN
from liftgate_hil.formats.writer import StreamWriter
from liftgate_plant.signals import TIME


class CsvWriter(StreamWriter):
    """Writer of CSV recordings."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        super().__init__(stream, content)
        self._start: float | None = None  # start of the run, s since 1970
        self._text: CsvText | None = None

    def begin(self, epoch_ns: int) -> None:
        """Write the header; if `epoch_ns` is not 0, with a column for the start of the run."""
        columns, row = list(self._content.columns), dict(self._content.row)
        if epoch_ns:
            self._start = epoch_ns / 1e9
            columns, row = [*columns, START_COLUMN], {**row, START_COLUMN: TIME}
        self._text = CsvText(columns, row)
        self._write(self._text.head)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write one line per row."""
        if self._start is not None:
            rows = np.column_stack([rows, np.full(len(rows), self._start)])
        self._write(self._begun().lines(rows))

    def close(self) -> None:
        """Close the file, which has at least a header."""
        self._begun()
        self._stream.close()

    def _begun(self) -> CsvText:
        """Return the formatter; write the header first if `begin` was not called (no wall clock applies then)."""
        if self._text is None:
            self.begin(0)
        assert self._text is not None
        return self._text
