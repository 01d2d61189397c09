"""A recording as a whole, read a block at a time: all its columns, all its frames, nothing judged or left out.

What a measurement makes of a file is in `read`; here it is taken as it is, to be converted, drawn and compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.files import check_file
from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.measurement import Floats
from liftgate_hil.signals import COLUMNS
from liftgate_plant.signals import Signal

_ALL = float("inf")


class Recorded(Protocol):
    """A recording. Its iterators open the file anew; they raise ConfigError where it cannot be read."""

    @property
    def path(self) -> Path:
        """The file."""

    @property
    def signals(self) -> Mapping[str, Signal]:
        """Its columns, the time first; none: it holds frames alone."""

    @property
    def channel(self) -> str | None:
        """What its frames' bus is called; None: it holds no frames."""

    @property
    def start_ns(self) -> int:
        """The wall clock where its times begin [ns since 1970]; 0: none counts."""

    @property
    def about(self) -> str:
        """What it says of its run, as JSON; empty: nothing."""

    @property
    def notes(self) -> Sequence[str]:
        """What was noticed, and left out."""

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Rows (n, len(wanted)) of these columns; NaN: no value."""

    def frames(self) -> Iterator[NDArray[np.void]]:
        """Frames (n,) LOGGED, as they stand in the file; times count from `start_ns`."""


def column_signal(name: str, unit: str = "", is_whole: bool = False) -> Signal:
    """The quantity of a column: ours, or one of which only name and unit are known."""
    return COLUMNS.get(name) or Signal(unit, -_ALL, _ALL, "", is_whole=is_whole)


def open_recorded(path: Path) -> Recorded:
    """The recording in a file; its suffix says the format. Raises ConfigError."""
    found = _opened(path)
    if not found.signals and found.channel is None:
        raise ConfigError(f"{path}: neither rows nor frames; allowed: a recording with some")
    return found


def holds_nothing(path: Path) -> bool:
    """Whether a recording has neither rows nor frames, as one whose trigger never came. Raises ConfigError."""
    if path.suffix.lower() == ".log" and path.is_file() and path.stat().st_size == 0:
        return True  # candump's text has no head
    found = _opened(path)
    return next(found.rows(["time_s"]), None) is None if found.signals else found.channel is None


def _opened(path: Path) -> Recorded:
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise ConfigError(f"{path}: format {kind or 'none'!r}; allowed: {', '.join(SUFFIXES)}")
    check_file(path)
    if path.stat().st_size == 0:
        raise ConfigError(f"{path}: empty; allowed: a recording")
    return _OPENERS[kind](path)


def _csv(path: Path) -> Recorded:
    from liftgate_hil.measurement.recorded_table import open_csv_recording

    return open_csv_recording(path)


def _parquet(path: Path) -> Recorded:
    from liftgate_hil.measurement.recorded_table import open_parquet_recording

    return open_parquet_recording(path)


def _log(path: Path) -> Recorded:
    from liftgate_hil.measurement.recorded_log import open_log_recording

    return open_log_recording(path)


def _mf4(path: Path) -> Recorded:
    from liftgate_hil.measurement.recorded_mf4 import open_mf4_recording

    return open_mf4_recording(path)


def _mcap(path: Path) -> Recorded:
    from liftgate_hil.measurement.mcap_file import open_mcap

    return open_mcap(path)


_OPENERS = {
    ".csv": _csv,
    ".parquet": _parquet,
    ".log": _log,
    ".asc": _log,
    ".blf": _log,
    ".trc": _log,
    ".mf4": _mf4,
    ".mcap": _mcap,
}
SUFFIXES = tuple(_OPENERS)
