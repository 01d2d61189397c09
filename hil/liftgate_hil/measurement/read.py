"""A file to a measurement: its suffix, and for MF4 and MCAP its content, says which reader."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.config.files import check_file
from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.csv_file import open_csv
from liftgate_hil.measurement.mapping import ColumnMap
from liftgate_hil.measurement.measurement import Measurement
from liftgate_hil.measurement.series import FRAME, Columns
from liftgate_hil.measurement.table import read_table
from liftgate_hil.measurement.units import KNOWN

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig

BUS_LOGS = (".log", ".asc", ".blf", ".trc")
MEASURED = (".mf4", ".mcap")  # of columns, of frames, or of both
TABLES = (".csv", ".tsv", ".txt", ".parquet", *MEASURED)
SUFFIXES = (*TABLES, *BUS_LOGS)


def read_measurement(
    path: Path,
    mapping: ColumnMap,
    rig: Rig | Callable[[], Rig],
    before: Mapping[str, float] | None = None,
) -> Measurement:
    """The measurement in a file. `rig`, or what loads it, is asked for a bus log only; so is `before`, the inputs
    until a test bench's panel first says something of them. Raises ConfigError with all faults.
    """
    if needs_rig(path, mapping):
        from liftgate_hil.measurement.bus_log import read_bus_log

        return read_bus_log(path, rig() if callable(rig) else rig, before or {})
    return read_table(path, open_columns(path, SUFFIXES), mapping)


def needs_rig(path: Path, mapping: ColumnMap) -> bool:
    """Whether a file holds frames, which a rig explains. Raises ConfigError where it cannot be read."""
    kind = path.suffix.lower()
    return kind in BUS_LOGS or (kind in MEASURED and is_bus_log(path, mapping))


def open_columns(path: Path, allowed: Sequence[str] = TABLES) -> Columns:
    """The file of columns. Raises ConfigError where it cannot be read; `allowed` are the formats that it names."""
    kind = path.suffix.lower()
    check_file(path)
    if kind == ".mf4":
        from liftgate_hil.measurement.mf4_file import open_mf4

        return open_mf4(path)
    if kind == ".mcap":
        from liftgate_hil.measurement.mcap_file import open_mcap

        return open_mcap(path)
    if kind == ".parquet":
        from liftgate_hil.measurement.parquet_file import open_parquet

        return open_parquet(path)
    if kind in TABLES:
        return open_csv(path)
    raise ConfigError(f"{path}: format {kind or 'none'!r}; allowed: {', '.join(allowed)}")


def is_bus_log(path: Path, mapping: ColumnMap) -> bool:
    """Whether an MF4 or MCAP file holds frames, and no column that is ours."""
    names = open_columns(path).names
    ours = {*KNOWN, *(theirs.name for theirs in mapping.values())}
    return FRAME in names and not ours.intersection(names)
