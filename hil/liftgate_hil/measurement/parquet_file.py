"""Parquet files as columns: those that hold numbers, with the units that stand among their metadata."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.foreign_reader import foreign_reader
from liftgate_hil.measurement.series import Series


@dataclass(frozen=True)
class ParquetFile:
    """See Columns."""

    path: Path
    names: Sequence[str]
    sample: str = "row"
    notes: Sequence[str] = ()

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Series]:
        """See Columns."""
        result = {}
        with foreign_reader(self.path, "Parquet", "pyarrow"):
            from pyarrow import parquet, types

            table = parquet.read_table(self.path, columns=list(wanted))
            for name in wanted:
                kind = table.schema.field(name).type
                if not (
                    types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind)
                ):
                    issues.append(f"{self.path}: {name}: {kind}; allowed: numbers")
                    continue
                values = np.array(table[name].to_numpy(), dtype=np.float64)
                bad = np.flatnonzero(np.isinf(values))
                if len(bad):
                    told = f"{values[bad[0]]} in row {bad[0] + 1}; allowed: a finite number"
                    issues.append(f"{self.path}: {name}: {told}")
                    continue
                unit = ((table.schema.field(name).metadata or {}).get(b"unit") or b"").decode()
                result[name] = Series(values, unit=unit or None)
        return result


def open_parquet(path: Path) -> ParquetFile:
    """The file's columns. Raises ConfigError where it cannot be read."""
    with foreign_reader(path, "Parquet", "pyarrow"):
        from pyarrow import parquet

        names = list(parquet.read_schema(path).names)
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ConfigError(f"{path}: {twice}: twice; allowed: once")
    return ParquetFile(path, names)
