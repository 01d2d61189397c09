"""The recorder for a file name."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import Frames
from liftgate_hil.errors import ConfigError, LiftgateError
from liftgate_hil.loop.recorder import Recorder
from liftgate_hil.recording.bus_log import CONVERTED, CandumpRecorder, ConvertedRecorder
from liftgate_hil.recording.table import CsvRecorder


def check_record(name: str) -> Path:
    """The path of a `record` value. Raises ConfigError."""
    path = Path(name)
    allowed = (".csv", ".log", *CONVERTED)
    if path.suffix not in allowed:
        raise ConfigError(
            f"`record` {name}: format {path.suffix or 'none'!r}; allowed: {', '.join(allowed)}"
        )
    if path.is_dir():
        raise ConfigError(f"`record` {name}: is a folder; allowed: a file")
    if not path.parent.is_dir():
        raise ConfigError(f"`record` {name}: no folder {path.parent}; allowed: one that exists")
    if path.suffix == ".mf4" and importlib.util.find_spec("asammdf") is None:
        raise ConfigError(
            f"`record` {name}: MF4 needs asammdf; allowed after: pip install 'liftgate-hil[mf4]'"
        )
    return path


class GuardedRecorder:
    """A recorder whose faults don't end the run: after the first it writes no more, and `failure` tells."""

    def __init__(self, path: Path, recorder: Recorder) -> None:
        self._path = path
        self._recorder = recorder
        self.failure = ""

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""
        self._try(self._recorder.write_rows, rows)

    def write_frames(self, frames: Frames, times: Sequence[float]) -> None:
        """See Recorder."""
        self._try(self._recorder.write_frames, frames, times)

    def flush(self) -> None:
        """See Recorder."""
        self._try(self._recorder.flush)

    def close(self) -> None:
        """See Recorder."""
        failed = bool(self.failure)
        try:
            self._recorder.close()
        except (OSError, LiftgateError) as error:
            if not failed:
                self._fail(error)

    def _try(self, action: Callable[..., None], *arguments: object) -> None:
        if not self.failure:
            try:
                action(*arguments)
            except OSError as error:
                self._fail(error)

    def _fail(self, error: Exception) -> None:
        text = error.strerror if isinstance(error, OSError) else None
        self.failure = f"`record` {self._path}: recording ended: {text or error}"


def open_recorder(path: Path, drives: int, channel: str, epoch: float) -> GuardedRecorder:
    """The recorder whose format the suffix says. Raises ConfigError where the file cannot be written."""
    recorder: Recorder
    try:
        if path.suffix == ".csv":
            recorder = CsvRecorder(path, drives)
        elif path.suffix == ".log":
            recorder = CandumpRecorder(path, channel, epoch)
        else:
            recorder = ConvertedRecorder(path, channel, epoch)
        return GuardedRecorder(path, recorder)
    except OSError as error:
        raise ConfigError(f"`record` {path}: cannot be written: {error.strerror}") from error
