"""Formats that a kill spoils (`.blf`, `.mf4`, `.parquet`, …) have text beside them until they are complete:
`run.mf4.log` with the frames, `run.mf4.csv` with the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import RecordingError
from liftgate_hil.loop.recorder import Recorder
from liftgate_hil.recording.target import why


class SalvagedRecorder:
    """See Part. The texts go once the file itself is complete."""

    def __init__(self, recorder: Recorder, texts: Sequence[tuple[Path, Recorder]] = ()) -> None:
        self._recorder = recorder
        self._texts = texts
        self._all = [*(text for _, text in texts), recorder]  # the texts first

    @property
    def written(self) -> int:
        """See Recorder."""
        return self._recorder.written

    def begin(self, epoch_ns: int) -> None:
        """See Recorder."""
        for each in self._all:
            each.begin(epoch_ns)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""
        for each in self._all:
            each.write_rows(rows)

    def write_frames(self, frames: Any) -> None:
        """See Recorder."""
        for each in self._all:
            each.write_frames(frames)

    def flush(self) -> None:
        """See Recorder."""
        for each in self._all:
            each.flush()

    def close(self) -> None:
        """See Recorder. Raises RecordingError that tells where the texts are."""
        try:
            self._recorder.close()
        except Exception as error:
            for _, text in self._texts:
                text.close()
            if not self._texts:
                raise
            said = why(error) if isinstance(error, OSError) else str(error)
            raise RecordingError(f"{said}; what there is of it is in {self._names()}") from error
        for path, text in self._texts:
            text.close()
            path.unlink()

    def leave(self) -> None:
        """See Part."""
        for each in self._all:
            try:
                each.close()
            except Exception:  # it has failed before, and that has been told
                continue

    def _names(self) -> str:
        return " and ".join(str(path) for path, _ in self._texts)
