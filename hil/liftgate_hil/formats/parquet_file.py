"""Reader and writer of Parquet by pyarrow: one column per signal with its unit, one row group at a time."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import tzinfo
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.content import Content, RowBatch
from liftgate_hil.formats.local_time import Stamp
from liftgate_hil.formats.mcap_layout import ABOUT_PARQUET, START_PARQUET
from liftgate_hil.formats.recording import (
    Floats,
    Recording,
    check_time_first,
    check_width,
    column_signal,
    foreign_reader,
    nanoseconds_of,
)
from liftgate_hil.formats.writer import StreamWriter

_GROUP = 65_536  # rows in a row group


class ParquetTableWriter(StreamWriter):
    """Writer of Parquet recordings."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        import pyarrow
        from pyarrow import parquet

        super().__init__(stream, content)
        self._arrow = pyarrow
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
            metadata={"title": content.title, **({ABOUT_PARQUET: content.about} if content.about else {})},
        )
        # Dictionary encoding pays off where values repeat.
        self._writer: Any = parquet.ParquetWriter(stream, self._schema, use_dictionary=whole)
        self._batch = RowBatch(_GROUP)

    @property
    def written(self) -> int:
        """Number of bytes written so far, including rows that wait for a full row group."""
        return self._stream.tell() + self._batch.nbytes

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Collect rows (n, ROW_WIDTH), and write them once a row group is full."""
        self._put(self._batch.add(rows))

    def close(self) -> None:
        """Write the remaining rows, the start of the run and the remark, and close the file."""
        self._put(self._batch.take())
        if self._epoch_ns:
            self._writer.add_key_value_metadata({START_PARQUET: str(self._epoch_ns)})
        if remark := self._content.remark():
            self._writer.add_key_value_metadata({"remark": remark})
        self._writer.close()
        self._stream.close()

    def _put(self, rows: NDArray[np.float64] | None) -> None:
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
# Units of dates and times.
_TICK_NS = {"s": 10**9, "ms": 10**6, "us": 1000, "ns": 1, "[day]": 86_400 * 10**9}


@dataclass(frozen=True, kw_only=True)
class ParquetFile(Recording):
    """Reader of a Parquet file: a table of any program, or a recording of this one."""

    others: Mapping[str, str]  # the columns of anything but numbers and times, with their types
    whole: Collection[str]  # the columns of integers
    # Columns of dates, times of day and durations: the moment from which they count, and their unit [ns].
    moments: Mapping[str, tuple[Stamp, int]] = field(default_factory=dict)

    def as_recording(self) -> ParquetFile:
        """Return the file as a recording. Raises ConfigError if columns hold texts, or time is not first."""
        self._check(self.names)
        check_time_first(self.path, self.names)
        return replace(self, start_ns=self.start_ns or self.starts.get("time_s", 0))

    def in_zone(self, zone: tzinfo) -> ParquetFile:
        """Return the table with dates without a zone interpreted as local times of this zone."""
        return self.changed(starts=_starts_of(self.moments, zone))

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of the wanted columns, one batch at a time; null is NaN."""
        self._check(wanted)
        self.rows_account.clear()
        with foreign_reader(self.path, "Parquet", "pyarrow"):
            from pyarrow import parquet

            with parquet.ParquetFile(self.path) as file:
                for batch in file.iter_batches(_ROWS, columns=list(wanted)):
                    values = [self._column(batch[name], name) for name in wanted]
                    yield np.column_stack(values)

    def _check(self, wanted: Sequence[str]) -> None:
        """Raise ConfigError if one of these columns holds anything but numbers, dates and times."""
        issues = [f"{name}: {self.others[name]}" for name in wanted if name in self.others]
        if issues:
            raise ConfigError([f"{self.path}: {each}; allowed: numbers" for each in issues])

    def _column(self, column: Any, name: str) -> Floats:
        if name in self.moments:
            first, tick_ns = self.moments[name]
            ticks = column.cast(f"int{column.type.bit_width}").fill_null(0).to_numpy(zero_copy_only=False)
            since = (ticks.astype(np.int64) - first.ns // tick_ns) * (tick_ns / 1e9)
            return np.where(column.is_valid().to_numpy(zero_copy_only=False), since, np.nan)
        if name not in self.whole:
            return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)
        values = self.rows_account.floats_of(name, column.fill_null(0).to_numpy(zero_copy_only=False))
        there = column.is_valid().to_numpy(zero_copy_only=False)
        return values if there.all() else np.where(there, values, np.nan)


def open_parquet(path: Path) -> ParquetFile:
    """Open a Parquet file for reading. Raises ConfigError if it is unreadable or has equal column names."""
    with foreign_reader(path, "Parquet", "pyarrow"):
        from pyarrow import parquet, types

        with parquet.ParquetFile(path) as file:
            schema, entries = file.schema_arrow, file.metadata.metadata or {}
            check_width(path, len(schema))
            moments = _moments_in(file, schema)
        whole = {each.name for each in schema if types.is_integer(each.type)}
        others = {
            each.name: str(each.type)
            for each in schema
            if each.name not in {*whole, *moments}
            and not (types.is_floating(each.type) or types.is_boolean(each.type) or types.is_decimal(each.type))
        }
    names = list(schema.names)
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ConfigError(f"{path}: {twice}: twice; allowed: once")
    units = {each.name: ((each.metadata or {}).get(b"unit") or b"").decode() for each in schema}
    units |= dict.fromkeys(moments, "s")
    signals = {name: column_signal(name, units[name], name in whole) for name in names if name not in others}
    about = (schema.metadata or {}).get(ABOUT_PARQUET.encode(), b"").decode(errors="replace")
    start = entries.get(START_PARQUET.encode(), b"").decode(errors="replace")
    return ParquetFile(
        path=path,
        names=names,
        units=units,
        signals=signals,
        others=others,
        whole=whole,
        moments=moments,
        starts=_starts_of(moments, None),
        about=about,
        start_ns=nanoseconds_of(start),
    )


def _moments_in(file: Any, schema: Any) -> dict[str, tuple[Stamp, int]]:
    """Return each date or time column's first date (of times: 0), from which it counts, and its unit [ns]."""
    from pyarrow import types

    found = {}
    temporal = [each for each in schema if types.is_temporal(each.type) and not types.is_interval(each.type)]
    first = next(file.iter_batches(1, columns=[each.name for each in temporal]), None) if temporal else None
    for each in temporal:
        tick_ns = _TICK_NS[str(getattr(each.type, "unit", "[day]" if types.is_date32(each.type) else "ms"))]
        is_date = types.is_timestamp(each.type) or types.is_date(each.type)
        begin = None
        if is_date and first is not None:
            begin = first[each.name].cast(f"int{each.type.bit_width}")[0].as_py()
        is_utc = bool(types.is_timestamp(each.type) and each.type.tz)
        found[each.name] = Stamp((begin or 0) * tick_ns, is_date and bool(begin), is_utc), tick_ns
    return found


def _starts_of(moments: Mapping[str, tuple[Stamp, int]], zone: tzinfo | None) -> dict[str, int]:
    """Return the wall clock [ns since 1970] at the first date of each column of dates; for times of day 0."""
    return {name: stamp.epoch_ns(zone) for name, (stamp, _) in moments.items()}
