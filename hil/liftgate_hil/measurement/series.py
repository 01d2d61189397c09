"""What any file of columns gives: its names, and of each column the samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from liftgate_hil.measurement.measurement import Floats

FRAME = "CAN_DataFrame"  # of ASAM MDF bus logging: among a file's names where it holds frames


@dataclass(frozen=True)
class Series:
    """One column as the file has it, in the file's unit."""

    values: Floats  # NaN where a cell is empty
    times: Floats | None = None  # s, of a column with times of its own; None: the file's rows
    unit: str | None = None  # None: the file does not say


class Columns(Protocol):
    """An opened file of columns."""

    @property
    def names(self) -> Sequence[str]:
        """The columns that it has."""

    @property
    def sample(self) -> str:
        """What one of its samples is called: "row", or "sample" where each column has its own times."""

    @property
    def notes(self) -> Sequence[str]:
        """What was noticed when it was opened."""

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Series]:
        """These columns; one that holds anything but finite numbers is left out, and noted."""
