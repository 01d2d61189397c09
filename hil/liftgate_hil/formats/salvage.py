"""Text files beside formats that a kill corrupts (`.blf`, `.mf4`, `.parquet`, …), until these are complete.

`run.mf4.log` holds the frames, `run.mf4.csv` the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import RecordingError
from liftgate_hil.formats.ours import sign
from liftgate_hil.formats.target import why
from liftgate_hil.formats.writer import Writer


class SalvagedWriter:
    """Writer of a file with text files beside it, which are deleted once the file itself is complete.

    `signed` is the file if it is then noted that it is ours, see `ours`.
    """

    def __init__(
        self, recorder: Writer, texts: Sequence[tuple[Path, Writer]] = (), signed: Path | None = None
    ) -> None:
        self._recorder, self._signed = recorder, signed
        self._texts = texts
        self._all = [*(text for _, text in texts), recorder]  # the text files first

    @property
    def texts(self) -> list[str]:
        """Paths of the text files, which hold the same as the file until it is complete."""
        return [str(path) for path, _ in self._texts]

    @property
    def written(self) -> int:
        """Bytes written so far to the file itself."""
        return self._recorder.written

    def begin(self, epoch_ns: int) -> None:
        """Begin all files with the wall clock at the start of the run [ns since 1970]; 0: none applies."""
        for each in self._all:
            each.begin(epoch_ns)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write rows (n, ROW_WIDTH) to all files."""
        for each in self._all:
            each.write_rows(rows)

    def write_frames(self, frames: Any) -> None:
        """Write frames (n,) LOGGED to all files."""
        for each in self._all:
            each.write_frames(frames)

    def write_mark(self, time_s: float, text: str) -> None:
        """Write a mark at a time [s] to all files."""
        for each in self._all:
            each.write_mark(time_s, text)

    def flush(self) -> None:
        """Flush all files."""
        for each in self._all:
            each.flush()

    def close(self) -> None:
        """Complete the file and delete the text files. Raises RecordingError, which names them, if that fails."""
        try:
            self._recorder.close()
        except Exception as error:
            for _, text in self._texts:
                text.close()
            if not self._texts:
                raise
            reason = why(error) if isinstance(error, OSError) else str(error)
            raise RecordingError(f"{reason}; the data recorded so far is in {' and '.join(self.texts)}") from error
        if self._signed is not None:
            sign(self._signed)
        for path, text in self._texts:
            text.close()
            path.unlink()

    def leave(self) -> None:
        """Close all files after an error, and keep the text files."""
        for each in self._all:
            try:
                each.close()
            except Exception:  # the error that came before has been reported
                continue
