"""Tables as recordings: CSV and Parquet, all columns, a block at a time."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError
from liftgate_hil.mcap_layout import ABOUT_PARQUET
from liftgate_hil.measurement.foreign_reader import foreign_reader
from liftgate_hil.measurement.log_frames import CUT, is_cut
from liftgate_hil.measurement.measurement import Floats
from liftgate_hil.measurement.recorded import column_signal
from liftgate_plant.signals import Signal

_BLOCK = 1 << 22  # bytes of text
_ROWS = 1 << 16
_JSON = b"0123456789+-.eE,\n"  # of rows that are as good as JSON's
_EXACT = 2**53  # whole numbers up to here are floats, too


class _Table:
    """What tables have in common: no frames, no wall clock."""

    channel: str | None = None
    start_ns = 0

    def frames(self) -> Iterator[NDArray[np.void]]:
        """See Recorded."""
        return iter(())


@dataclass(frozen=True)
class RecordedCsv(_Table):
    """See Recorded."""

    path: Path
    signals: Mapping[str, Signal]
    delimiter: bytes
    head: int  # bytes of the header
    notes: Sequence[str] = ()
    about: str = ""

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """See Recorded."""
        order = list(self.signals)
        places = [order.index(name) for name in wanted]
        with foreign_reader(self.path, "Parquet", "pyarrow"), self.path.open("rb") as stream:
            stream.seek(self.head)
            rest, number = b"", 1
            while text := stream.read(_BLOCK):
                lines, newline, rest = (rest + text).rpartition(b"\n")
                if newline:
                    yield self._parsed(lines, number)[:, places]
                    number += lines.count(b"\n") + 1
            if rest.strip() and not self.notes:
                yield self._parsed(rest, number)[:, places]

    def _parsed(self, text: bytes, number: int) -> Floats:
        """Lines (n,) as rows; `number` is the first one's."""
        text = text.replace(b"\r", b"").replace(self.delimiter, b",")
        width = len(self.signals)
        if not text.translate(None, _JSON) and b",," not in text:
            try:
                rows = orjson.loads(b"[[" + text.replace(b"\n", b"],[") + b"]]")
                table = np.array(rows, dtype=np.float64)
                if table.shape[1] == width:
                    return table
            except (ValueError, IndexError):  # .5, 007, an empty cell, rows of unlike lengths
                pass
        return np.array(
            [self._row(line, number + k) for k, line in enumerate(text.decode().split("\n"))]
        )

    def _row(self, line: str, number: int) -> list[float]:
        """A line's cells; an empty one is NaN."""
        cells = line.split(",")
        if len(cells) != len(self.signals):
            raise ConfigError(
                f"{self.path}: row {number}: {len(cells)} cells; "
                f"allowed: {len(self.signals)}, as in the header"
            )
        values = []
        for name, cell in zip(self.signals, cells, strict=True):
            try:
                values.append(float(cell) if cell.strip() else np.nan)
            except ValueError as error:
                said = f"{name}: {cell[:40]!r} in row {number}; allowed: a number"
                raise ConfigError(f"{self.path}: {said}") from error
        return values


def open_csv_recording(path: Path) -> RecordedCsv:
    """A CSV file: a header, and rows of numbers. Raises ConfigError."""
    with foreign_reader(path, "Parquet", "pyarrow"), path.open("rb") as stream:
        line = stream.readline(1 << 20)
        head = stream.tell()
        text = line.decode("utf-8-sig").strip()
        if "\0" in text or not line.endswith(b"\n"):
            raise ConfigError(f"{path}: cannot be read: no header and rows below it")
    delimiter = max(",;\t", key=text.count)
    names = [name.strip() for name in next(csv.reader([text], delimiter=delimiter), [])]
    if names[:1] != ["time_s"]:
        raise ConfigError(
            f"{path}: time_s: missing; allowed: a recording, whose first column it is"
        )
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ConfigError(f"{path}: {twice}: twice in the header; allowed: once")
    notes = (CUT,) if is_cut(path) else ()
    signals = {name: column_signal(name) for name in names}
    return RecordedCsv(path, signals, delimiter.encode(), head, notes)


@dataclass(frozen=True)
class RecordedParquet(_Table):
    """See Recorded."""

    path: Path
    signals: Mapping[str, Signal]
    about: str = ""
    notes: Sequence[str] = ()

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """See Recorded."""
        with foreign_reader(self.path, "Parquet", "pyarrow"):
            from pyarrow import parquet

            with parquet.ParquetFile(self.path) as file:
                for batch in file.iter_batches(_ROWS, columns=list(wanted)):
                    values = [self._column(batch[name], name) for name in wanted]
                    yield np.column_stack(values)

    def _column(self, column: Any, name: str) -> Floats:
        """Its numbers; null is NaN."""
        values = column.to_numpy(zero_copy_only=False)
        if values.dtype.kind in "iu" and len(values) and not (np.abs(values) <= _EXACT).all():
            raise ConfigError(
                f"{self.path}: {name}: whole numbers beyond 2^53; allowed: up to there"
            )
        return np.asarray(values, dtype=np.float64)


def open_parquet_recording(path: Path) -> RecordedParquet:
    """A Parquet file of columns of numbers. Raises ConfigError."""
    with foreign_reader(path, "Parquet", "pyarrow"):
        from pyarrow import parquet, types

        schema = parquet.read_schema(path)
        for each in schema:
            if not (
                types.is_floating(each.type)
                or types.is_integer(each.type)
                or types.is_boolean(each.type)
            ):
                raise ConfigError(f"{path}: {each.name}: {each.type}; allowed: numbers")
        signals = {
            each.name: column_signal(
                each.name,
                ((each.metadata or {}).get(b"unit") or b"").decode(),
                types.is_integer(each.type),
            )
            for each in schema
        }
    if next(iter(signals), "") != "time_s":
        raise ConfigError(
            f"{path}: time_s: missing; allowed: a recording, whose first column it is"
        )
    about = (schema.metadata or {}).get(ABOUT_PARQUET.encode(), b"").decode(errors="replace")
    return RecordedParquet(path, signals, about)
