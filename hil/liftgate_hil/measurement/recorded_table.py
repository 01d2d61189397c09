"""Tables as recordings: CSV and Parquet, all columns, a block at a time."""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError
from liftgate_hil.mcap_layout import ABOUT_PARQUET, START_COLUMN, START_PARQUET
from liftgate_hil.measurement.foreign_reader import foreign_reader
from liftgate_hil.measurement.log_frames import CUT, is_cut
from liftgate_hil.measurement.measurement import Floats
from liftgate_hil.measurement.recorded import column_signal
from liftgate_plant.signals import Signal

_BLOCK = 1 << 22  # bytes of text
_ROWS = 1 << 16
_FEW = 3  # of the columns up to a third are taken out before they are parsed
_JSON = b"0123456789+-.eE,\n"  # of rows that are as good as JSON's
_LATEST_START = 1e10  # s since 1970
_EXACT = 2**53  # whole numbers up to here are floats, too


class _Table:
    """What tables have in common: no frames."""

    channel: str | None = None

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
    names: Sequence[str]  # of all columns, START_COLUMN too
    start_ns: int = 0
    notes: Sequence[str] = ()
    about: str = ""

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """See Recorded."""
        places = [self.names.index(name) for name in wanted]
        with foreign_reader(self.path, "Parquet", "pyarrow"), self.path.open("rb") as stream:
            stream.seek(self.head)
            rest, number = b"", 1
            while text := stream.read(_BLOCK):
                lines, newline, rest = (rest + text).rpartition(b"\n")
                if newline:
                    yield self._cells(lines, number, places)
                    number += lines.count(b"\n") + 1
            if rest.strip() and not self.notes:
                yield self._cells(rest, number, places)

    def _cells(self, text: bytes, number: int, places: Sequence[int]) -> Floats:
        """Of lines (n,) these columns (n, len(places)); `number` is the first row's."""
        if _FEW * len(places) >= len(self.names):
            return self._parsed(text, number)[:, places]
        text = text.replace(b"\r", b"")
        letters = np.frombuffer(text, dtype=np.uint8)
        ends = np.append(np.flatnonzero(letters == ord("\n")), len(text))
        marks = np.flatnonzero(letters == self.delimiter[0])
        if len(marks) == len(ends) * (len(self.names) - 1):
            lines = marks.reshape(len(ends), -1)
            begins = np.append(0, ends[:-1] + 1)
            if (lines[:, 0] >= begins).all() and (lines[:, -1] < ends).all():  # each has its own
                inner = len(self.names) - 1
                first = np.column_stack(
                    [lines[:, place - 1] + 1 if place else begins for place in places]
                )
                last = np.column_stack(
                    [lines[:, place] if place < inner else ends for place in places]
                )
                spans = zip(first.ravel().tolist(), last.ravel().tolist(), strict=True)
                cells = b",".join([text[begin:end] for begin, end in spans])
                with contextlib.suppress(ValueError):  # .5, 007, an empty cell
                    if not cells.translate(None, _JSON):
                        found = np.array(orjson.loads(b"[" + cells + b"]"), dtype=np.float64)
                        return found.reshape(len(ends), len(places))
        return self._parsed(text, number)[:, places]

    def start_in(self, line: bytes) -> int:
        """The wall clock [ns] at the run's start, from a row; 0: it has none that can be one."""
        start = self._parsed(line.rstrip(b"\n"), 1)[0, self.names.index(START_COLUMN)]
        return round(start * 1e6) * 1000 if 0.0 < start < _LATEST_START else 0

    def _parsed(self, text: bytes, number: int) -> Floats:
        """Lines (n,) as rows; `number` is the first one's."""
        text = text.replace(b"\r", b"").replace(self.delimiter, b",")
        width = len(self.names)
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
        if len(cells) != len(self.names):
            raise ConfigError(
                f"{self.path}: row {number}: {len(cells)} cells; "
                f"allowed: {len(self.names)}, as in the header"
            )
        values = []
        for name, cell in zip(self.names, cells, strict=True):
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
        head, first = stream.tell(), stream.readline(1 << 20)
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
    signals = {name: column_signal(name) for name in names if name != START_COLUMN}
    found = RecordedCsv(path, signals, delimiter.encode(), head, names, notes=notes)
    if START_COLUMN in names and first.endswith(b"\n"):
        with foreign_reader(path, "Parquet", "pyarrow"):
            return replace(found, start_ns=found.start_in(first))
    return found


@dataclass(frozen=True)
class RecordedParquet(_Table):
    """See Recorded."""

    path: Path
    signals: Mapping[str, Signal]
    about: str = ""
    start_ns: int = 0
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

        with parquet.ParquetFile(path) as file:
            schema, told = file.schema_arrow, file.metadata.metadata or {}
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
    start = told.get(START_PARQUET.encode(), b"").decode(errors="replace")
    is_time = start.isascii() and start.isdecimal() and len(start) < 20
    return RecordedParquet(path, signals, about, int(start) if is_time else 0)
