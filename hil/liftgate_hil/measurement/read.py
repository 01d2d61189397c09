"""Reads a file as a measurement: its suffix, and for MF4 and MCAP its content, selects the reader."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.formats.open import open_file
from liftgate_hil.formats.recording import AS_IT_IS, FRAME, ReadOptions
from liftgate_hil.formats.suffixes import BUS_LOGS, FORMATS
from liftgate_hil.measurement.mapping import KNOWN, ColumnMap
from liftgate_hil.measurement.measurement import Measurement
from liftgate_hil.measurement.table import read_table

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig


def read_measurement(
    path: Path,
    mapping: ColumnMap,
    rig: Rig | Callable[[], Rig],
    before: Mapping[str, float] | None = None,
    how: ReadOptions = AS_IT_IS,
) -> Measurement:
    """Read the measurement in a file. Raises ConfigError with all issues.

    `rig`, or a function that loads it, is used for bus logs only; so is `before`, the inputs until the frames of a
    test bench's panel first state them.
    """
    if needs_rig(path, mapping):
        from liftgate_hil.measurement.bus_log import read_bus_log

        return read_bus_log(path, rig() if callable(rig) else rig, before or {}, how)
    return read_table(path, open_file(path, how=how), mapping)


def needs_rig(path: Path, mapping: ColumnMap) -> bool:
    """Whether a file holds frames, which a rig decodes. Raises ConfigError if it cannot be read."""
    kind = path.suffix.lower()
    if kind in BUS_LOGS:
        return True
    return kind in FORMATS and FORMATS[kind].has_frames and is_bus_log(path, mapping)


def is_bus_log(path: Path, mapping: ColumnMap) -> bool:
    """Whether an MF4 or MCAP file holds frames, and no column that is ours."""
    names = open_file(path).names
    ours = {*KNOWN, *(theirs.name for theirs in mapping.values())}
    return FRAME in names and not ours.intersection(names)
