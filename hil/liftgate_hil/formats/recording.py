"""Protocols of the readers of files: a recording's rows and frames, or the samples of its columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.signals import COLUMNS
from liftgate_plant.signals import Signal

Floats = NDArray[np.float64]

FRAME = "CAN_DataFrame"  # of ASAM MDF bus logging; among a file's names if it holds frames
_ALL = float("inf")


class Recording(Protocol):
    """A recording. Its iterators open the file anew, and raise ConfigError if it cannot be read."""

    @property
    def path(self) -> Path:
        """Path of the file."""

    @property
    def signals(self) -> Mapping[str, Signal]:
        """Columns, the time first; empty if it holds frames only."""

    @property
    def channel(self) -> str | None:
        """Name of the frames' bus; None if it holds no frames."""

    @property
    def start_ns(self) -> int:
        """Wall clock where the times begin [ns since 1970]; 0: none applies."""

    @property
    def about(self) -> str:
        """Provenance of the run, as JSON; empty if unknown."""

    @property
    def notes(self) -> Sequence[str]:
        """Remarks on what was noticed and left out."""

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of these columns; NaN: no value."""

    def frames(self) -> Iterator[NDArray[np.void]]:
        """Yield frames (n,) LOGGED in file order; times count from `start_ns`."""


class WithoutFrames:
    """Base class of recordings that hold rows only."""

    channel: str | None = None

    def frames(self) -> Iterator[NDArray[np.void]]:
        """Return no frames."""
        return iter(())


@dataclass(frozen=True)
class Series:
    """Column of a file, as the file has it, in the file's unit."""

    values: Floats  # NaN where a cell is empty
    times: Floats | None = None  # s, of a column with its own times; None: those of the file's rows
    unit: str | None = None  # None: the file does not state it


class Columns(Protocol):
    """An opened file of columns."""

    @property
    def names(self) -> Sequence[str]:
        """Names of the columns in the file."""

    @property
    def sample(self) -> str:
        """Word for one sample: "row", or "sample" if each column has its own times."""

    @property
    def notes(self) -> Sequence[str]:
        """Remarks on what was noticed when the file was opened."""

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Series]:
        """Read these columns; one with anything but finite numbers is left out and added to `issues`."""


def column_signal(name: str, unit: str = "", is_whole: bool = False) -> Signal:
    """Return the signal of a column: ours of that name, or one of which only the unit is known."""
    return COLUMNS.get(name) or Signal(unit, -_ALL, _ALL, "", is_whole=is_whole)
