"""The recorder for a file name."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from hil.errors import ConfigError
from hil.recording.base import Recorder
from hil.recording.bus_log import CONVERTED, CandumpRecorder, ConvertedRecorder
from hil.recording.table import CsvRecorder


def check_record(name: str) -> Path:
    """The path of a `--record` value. Raises ConfigError."""
    path = Path(name)
    allowed = (".csv", ".log", *CONVERTED)
    if path.suffix not in allowed:
        raise ConfigError(
            f"--record {name}: format {path.suffix or 'none'!r}; allowed: {', '.join(allowed)}"
        )
    if path.is_dir():
        raise ConfigError(f"--record {name}: is a folder; allowed: a file")
    if not path.parent.is_dir():
        raise ConfigError(f"--record {name}: no folder {path.parent}; allowed: one that exists")
    if path.suffix == ".mf4" and importlib.util.find_spec("asammdf") is None:
        raise ConfigError(
            f"--record {name}: MF4 needs asammdf; allowed after: pip install 'liftgate-hil[mf4]'"
        )
    return path


def open_recorder(path: Path, drives: int, channel: str, epoch: float) -> Recorder:
    """The recorder whose format the suffix says. Raises ConfigError where the file cannot be written."""
    try:
        if path.suffix == ".csv":
            return CsvRecorder(path, drives)
        if path.suffix == ".log":
            return CandumpRecorder(path, channel, epoch)
        return ConvertedRecorder(path, channel, epoch)
    except OSError as error:
        raise ConfigError(f"--record {path}: cannot be written: {error.strerror}") from error
