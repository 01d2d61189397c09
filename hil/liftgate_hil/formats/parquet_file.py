"""Parquet files by pyarrow, written and read: one column per signal with its unit, one row group at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.content import Batch, Content
from liftgate_hil.formats.mcap_layout import ABOUT_PARQUET, START_PARQUET
from liftgate_hil.formats.reading import foreign_reader
from liftgate_hil.formats.recording import Floats, Series, WithoutFrames, column_signal
from liftgate_plant.signals import Signal

_GROUP = 65_536  # rows in a row group


class ParquetTableWriter:
    """Writer of Parquet recordings."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        import pyarrow
        from pyarrow import parquet

        self._arrow = pyarrow
        self._stream = stream
        self._content = content
        whole = [name for name in content.columns if content.row[name].is_whole]
        self._schema = pyarrow.schema(
            [
                pyarrow.field(
                    name,
                    pyarrow.int64() if name in whole else pyarrow.float64(),
                    metadata={"unit": content.unit_of(name)},
                )
                for name in content.columns
            ],
            metadata={
                "title": content.title,
                **({ABOUT_PARQUET: content.about} if content.about else {}),
            },
        )
        # Dictionary encoding pays off where values repeat.
        self._writer: Any = parquet.ParquetWriter(stream, self._schema, use_dictionary=whole)
        self._batch = Batch(_GROUP)
        self._epoch_ns = 0

    @property
    def written(self) -> int:
        """Bytes written so far, including rows that wait for a full row group."""
        return self._stream.tell() + self._batch.nbytes

    def begin(self, epoch_ns: int) -> None:
        """Keep the wall clock at the start of the run [ns since 1970] for the metadata."""
        self._epoch_ns = epoch_ns

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write rows (n, ROW_WIDTH) once a row group is full."""
        self._write(self._batch.add(rows))

    def write_frames(self, frames: Any) -> None:
        """Ignore frames: Parquet recordings hold rows only."""

    def flush(self) -> None:
        """Flush the stream; rows that wait for a full row group stay in memory."""
        self._stream.flush()

    def close(self) -> None:
        """Write the remaining rows, the start of the run and the remark, and close the file."""
        self._write(self._batch.take())
        if self._epoch_ns:
            self._writer.add_key_value_metadata({START_PARQUET: str(self._epoch_ns)})
        if remark := self._content.remark():
            self._writer.add_key_value_metadata({"remark": remark})
        self._writer.close()
        self._stream.close()

    def _write(self, rows: NDArray[np.float64] | None) -> None:
        if rows is None:
            return
        wanted = zip(self._content.columns, self._content.places, strict=True)
        columns = [self._column(rows[:, place], name) for name, place in wanted]
        batch = self._arrow.record_batch(columns, schema=self._schema)
        self._writer.write_batch(batch, row_group_size=len(rows))

    def _column(self, values: NDArray[np.float64], name: str) -> Any:
        if not self._content.row[name].is_whole:
            return self._arrow.array(np.ascontiguousarray(values))
        there = np.isfinite(values)  # false for a plant that has diverged
        return self._arrow.array(np.where(there, values, 0.0).astype(np.int64), mask=~there)


_ROWS = 1 << 16
_EXACT = 2**53  # integers up to this are exact as floats


@dataclass(frozen=True)
class ParquetRecording(WithoutFrames):
    """Recording read from a Parquet file."""

    path: Path
    signals: Mapping[str, Signal]
    about: str = ""
    start_ns: int = 0
    notes: Sequence[str] = ()

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of these columns, one batch at a time."""
        with foreign_reader(self.path, "Parquet", "pyarrow"):
            from pyarrow import parquet

            with parquet.ParquetFile(self.path) as file:
                for batch in file.iter_batches(_ROWS, columns=list(wanted)):
                    values = [self._column(batch[name], name) for name in wanted]
                    yield np.column_stack(values)

    def _column(self, column: Any, name: str) -> Floats:
        """Return a column's numbers; null is NaN."""
        values = column.to_numpy(zero_copy_only=False)
        if values.dtype.kind in "iu" and len(values) and not (np.abs(values) <= _EXACT).all():
            raise ConfigError(f"{self.path}: {name}: integers beyond 2^53; allowed: up to 2^53")
        return np.asarray(values, dtype=np.float64)


def open_parquet_recording(path: Path) -> ParquetRecording:
    """Open a Parquet recording: columns of numbers, the time first. Raises ConfigError."""
    with foreign_reader(path, "Parquet", "pyarrow"):
        from pyarrow import parquet, types

        with parquet.ParquetFile(path) as file:
            schema, told = file.schema_arrow, file.metadata.metadata or {}
        for each in schema:
            if not _is_number(each.type):
                raise ConfigError(f"{path}: {each.name}: {each.type}; allowed: numbers")
        signals = {
            each.name: column_signal(each.name, _unit_of(each), types.is_integer(each.type))
            for each in schema
        }
    if next(iter(signals), "") != "time_s":
        raise ConfigError(
            f"{path}: time_s: missing; allowed: a recording whose first column is time_s"
        )
    about = (schema.metadata or {}).get(ABOUT_PARQUET.encode(), b"").decode(errors="replace")
    start = told.get(START_PARQUET.encode(), b"").decode(errors="replace")
    is_time = start.isascii() and start.isdecimal() and len(start) < 20
    return ParquetRecording(path, signals, about, int(start) if is_time else 0)


def _is_number(kind: Any) -> bool:
    """Whether a column of this type of Arrow's holds numbers."""
    from pyarrow import types

    return bool(types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind))


def _unit_of(field: Any) -> str:
    """Return the unit of a column, from its field in an Arrow schema; "": none is given."""
    return ((field.metadata or {}).get(b"unit") or b"").decode()


@dataclass(frozen=True)
class ParquetFile:
    """Columns of a Parquet file."""

    path: Path
    names: Sequence[str]
    sample: str = "row"
    notes: Sequence[str] = ()

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Series]:
        """Read these columns; one with anything but finite numbers or null is left out and added to `issues`."""
        result = {}
        with foreign_reader(self.path, "Parquet", "pyarrow"):
            from pyarrow import parquet

            table = parquet.read_table(self.path, columns=list(wanted))
            for name in wanted:
                field = table.schema.field(name)
                if not _is_number(field.type):
                    issues.append(f"{self.path}: {name}: {field.type}; allowed: numbers")
                    continue
                values = np.array(table[name].to_numpy(), dtype=np.float64)
                bad = np.flatnonzero(np.isinf(values))
                if len(bad):
                    told = f"{values[bad[0]]} in row {bad[0] + 1}; allowed: a finite number"
                    issues.append(f"{self.path}: {name}: {told}")
                    continue
                result[name] = Series(values, unit=_unit_of(field) or None)
        return result


def open_parquet(path: Path) -> ParquetFile:
    """Open the columns of a Parquet file. Raises ConfigError if it cannot be read, or has two of the same name."""
    with foreign_reader(path, "Parquet", "pyarrow"):
        from pyarrow import parquet

        names = list(parquet.read_schema(path).names)
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ConfigError(f"{path}: {twice}: twice; allowed: once")
    return ParquetFile(path, names)
