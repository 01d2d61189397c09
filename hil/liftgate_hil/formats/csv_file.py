"""Reader of CSV files: a header, then rows of numbers, each exact to the last bit.

Files of other tools may have semicolons or tabs, and empty cells (NaN).
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import tzinfo
from pathlib import Path
from typing import BinaryIO

import numpy as np
import orjson

from liftgate_hil.config.units import headed_unit
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.account import CUT
from liftgate_hil.formats.csv_header import (
    NOT_FINITE,
    NUMBER,
    UNNAMED,
    decoded,
    doubts_about,
    first_cells,
    header_of,
    with_newlines,
    without_comments,
    without_words,
)
from liftgate_hil.formats.local_time import FORMS, Stamp, seconds_since, stamp_of
from liftgate_hil.formats.mcap_layout import START_COLUMN
from liftgate_hil.formats.recording import Floats, Recording, as_config_errors, check_time_first, column_signal

_FEW = 3  # if fewer than a third of the columns are wanted, only their cells are parsed
_DIGITS = b"0123456789+-.eE, \n"  # characters of rows in which each cell is a finite number, or empty
_EMPTY = b"9.87654321e300"  # stands for an empty cell while numbers are parsed
_LATEST_START = 1e10  # latest plausible start of a run, s since 1970
_LONGEST = 1 << 22  # longest header, and longest last line [bytes]
_AS_POINTS = bytes.maketrans(b",.", b".'")  # a point among decimal commas is none, so that its cell is refused
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # how a text begins that Excel calls Unicode
_MOST_UTF_16 = 1 << 29  # bytes of such a file, which is decoded as a whole
_LARGE = 2.0**53  # an integer from here on may be none as a float
_INTEGER = re.compile(r"[+-]?\d{1,300}")  # more digits than a float has
_OR_A_DATE = f", or a date in each row, such as {FORMS}"
_BLOCK = 1 << 22  # bytes that are parsed at a time, so that an interrupt does not wait for long


@dataclass(frozen=True, kw_only=True)
class CsvFile(Recording):
    """Reader of a CSV file: a table of any program, or a recording, whose values may be nan and inf."""

    delimiter: bytes
    head: int  # length of the header [bytes]
    last: bytes  # last line, if it does not end with a newline
    has_commas: bool = False  # numbers have decimal commas
    encoding: str = "UTF-8"
    moments: Mapping[str, Stamp] = field(default_factory=dict)  # columns of dates, with their first ones
    is_strict: bool = False

    def as_recording(self) -> CsvFile:
        """Return the file as a recording without a cut-off last line. Raises ConfigError if time is not first."""
        check_time_first(self.path, self.names)
        units = {name: headed_unit(name) for name in self.names} | dict(self.units)
        signals = {name: column_signal(name, units[name]) for name in self.names if name and name != START_COLUMN}
        # Even if the last line has all cells, the last one may be cut off.
        said = ((CUT, bool(self.last)), (UNNAMED, "" in self.names))
        notes = dict.fromkeys((*self.remarks, *(note for note, is_so in said if is_so)))
        begin_ns = self.starts.get("time_s", 0)
        found = replace(
            self, units=units, signals=signals, remarks=tuple(notes), start_ns=begin_ns, is_strict=True
        )
        if START_COLUMN not in self.names:
            return found
        with as_config_errors(self.path), _text_of(self.path) as stream:
            stream.seek(self.head)
            first = stream.readline(_LONGEST)
            while first and not first.strip():
                first = stream.readline(_LONGEST)
        if not first.endswith(b"\n"):
            return found
        start = found._table(with_newlines(first), 1, [self.names.index(START_COLUMN)])[0, 0]
        return replace(found, start_ns=round(start * 1e6) * 1000 if 0.0 < start < _LATEST_START else 0)

    def in_zone(self, zone: tzinfo) -> CsvFile:
        """Return the table with local times in its cells interpreted in a time zone."""
        return self.changed(starts=_starts_of(self.moments, zone))

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of the wanted columns, one block at a time; an empty cell is NaN."""
        order = {name: place for place, name in enumerate(self.names)}
        dates = [(column, name) for column, name in enumerate(wanted) if name in self.moments]
        plain = [column for column, name in enumerate(wanted) if name not in self.moments]
        places = [order[wanted[column]] for column in plain]
        number, before = 1, dict.fromkeys(self.moments, 0.0)
        self.rows_account.clear()
        for text in self._lines():
            if not dates:
                table = self._table(text, number, places)
            else:
                rows = self._rows_of(text)
                table = np.empty((len(rows), len(wanted)))
                if plain:
                    table[:, plain] = self._table(text, number, places)
                for column, name in dates:
                    table[:, column] = self._moments(rows, name, number, before)
            yield table
            number += len(table)

    def _moments(self, rows: list[list[str]], name: str, number: int, before: dict[str, float]) -> Floats:
        """Return dates as times (n,) [s] since the first; store the last in `before`. Raises ConfigError."""
        place = list(self.names).index(name)
        short = next((row for row, cells in enumerate(rows) if len(cells) <= place), None)
        if short is not None:
            raise ConfigError(
                f"{self.path}: row {number + short}: {len(rows[short])} cells; allowed: {len(self.names)}"
            )
        found = seconds_since(self.moments[name], [cells[place] for cells in rows], before[name])
        if isinstance(found, int):
            cell = rows[found][place].strip()[:40]
            raise ConfigError(
                f"{self.path}: {name}: {cell!r} in row {number + found}; allowed: as in the first row"
            )
        known = found[np.isfinite(found)]
        before[name] = float(known[-1]) if len(known) else before[name]
        return found

    def _lines(self) -> Iterator[bytes]:
        """Yield blocks of some MB of whole lines below the header, without comments or a last line cut off."""
        with as_config_errors(self.path), _text_of(self.path) as stream:
            at, rest = stream.seek(self.head), b""
            while block := stream.read(_BLOCK):
                lines, newline, rest = (rest + block).rpartition(b"\n")
                text = without_comments(with_newlines(self._checked(lines, at)))
                at += len(lines + newline)
                if text.strip():
                    yield text
            text = without_comments(with_newlines(self._checked(rest, at)))
            if CUT in self.notes:  # the last line is ignored
                text = text[: text.rfind(b"\n") + 1]
            if text.strip():
                yield text

    def _checked(self, text: bytes, at: int) -> bytes:
        """Return a block of the file that begins at byte `at`, as UTF-8. Raises ConfigError if it is no text."""
        is_plain = text.isascii() and b"\0" not in text
        return text if is_plain else decoded(self.path, text, at, self.encoding).encode()

    def _table(self, text: bytes, number: int, places: Sequence[int]) -> Floats:
        """Return columns (n, len(places)) of lines of text; the first row has this number. Raises ConfigError."""
        text = written = text.strip(b"\n")
        if self.has_commas:
            text = text.translate(_AS_POINTS)
        table = self._at_once(text, places)
        if table is None and not self.is_strict and (numbers := without_words(text)) is not text:
            text, table = numbers, self._at_once(numbers, places)
        table = self._by_cell(text, written, number, places) if table is None else table
        if (np.abs(table) >= _LARGE).any():
            self._account_for_integers(text, table, places)
        return table

    def _at_once(self, text: bytes, places: Sequence[int]) -> Floats | None:
        """Return the columns by parsing rows of numbers in one pass; None if that is not possible."""
        is_plain = self.delimiter == b"," or b"," not in text
        if not is_plain or b'"' in text or b"\n\n" in text:
            return None
        table = self._whole(text, places) if _FEW * len(places) >= len(self.names) else None
        return self._cells(text, places) if table is None else table

    def _account_for_integers(self, text: bytes, table: Floats, places: Sequence[int]) -> None:
        """Count in the account the integers with more digits than a float holds."""
        rows = self._rows_of(text)
        for column, place in enumerate(places):
            large = np.flatnonzero(np.abs(table[:, column]) >= _LARGE)
            cells = [rows[row][place].strip() for row in large]
            integers = [int(each) for each in cells if _INTEGER.fullmatch(each)]
            self.rows_account.floats_of(self.names[place], integers)

    def _whole(self, text: bytes, places: Sequence[int]) -> Floats | None:
        """Return the columns by parsing all cells of the rows as JSON; None if that is not possible."""
        text = text.replace(self.delimiter, b",")
        if text.translate(None, _DIGITS):
            return None
        try:
            rows = orjson.loads(b"[[" + text.replace(b"\n", b"],[") + b"]]")
            table = np.array(rows, dtype=np.float64)
        except ValueError:  # .5, 007, an empty cell, rows of different lengths
            return None
        if table.shape[1:] != (len(self.names),) or not np.isfinite(table).all():
            return None
        return table[:, places]

    def _cells(self, text: bytes, places: Sequence[int]) -> Floats | None:
        """Return the columns by parsing only their cells; None if a row is malformed or a cell not numeric."""
        letters = np.frombuffer(text, dtype=np.uint8)
        ends = np.append(np.flatnonzero(letters == ord("\n")), len(text))
        begins = np.append(0, ends[:-1] + 1)
        marks = np.flatnonzero(letters == self.delimiter[0])
        if len(marks) != len(ends) * (len(self.names) - 1):
            return None
        inner = marks.reshape(len(ends), -1)
        # Each line must have its own delimiters.
        if inner.size and ((inner[:, 0] < begins).any() or (inner[:, -1] > ends).any()):
            return None
        bounds = np.column_stack([begins - 1, inner, ends])
        first = bounds[:, places].ravel() + 1
        last = bounds[:, [place + 1 for place in places]].ravel()
        spans = zip(first.tolist(), last.tolist(), strict=True)
        cells = [text[begin:end] or _EMPTY for begin, end in spans]
        joined = b",".join(cells)
        if joined.translate(None, _DIGITS):
            return None
        try:
            try:
                values = np.array(orjson.loads(b"[" + joined + b"]"), dtype=np.float64)
            except ValueError:  # .5, 007
                values = np.array(cells).astype(np.float64)
        except ValueError:  # a blank cell, or no number
            return None
        if not np.isfinite(values).all():
            return None
        values[values == float(_EMPTY)] = np.nan
        return values.reshape(len(ends), len(places))

    def _by_cell(self, text: bytes, written: bytes, number: int, places: Sequence[int]) -> Floats:
        """Return the columns cell by cell, so that ConfigError quotes row and cell as `written` in the file."""
        rows = self._rows_of(text)
        width = len(self.names)
        for row, cells in enumerate(rows):
            if len(cells) < width or any(cell.strip() for cell in cells[width:]):
                comma = "" if self.delimiter != b"," else " (is it a decimal comma?)"
                raise ConfigError(
                    f"{self.path}: row {number + row}: {len(cells)} cells{comma}; "
                    f"allowed: {width}, as in the header"
                )
        table, issues = np.empty((len(rows), len(places))), []
        for column, place in enumerate(places):
            bad = []
            for row, cells in enumerate(rows):
                value = self._number(cells[place].strip())
                if value is None:
                    bad.append(row)
                else:
                    table[row, column] = value
            if bad:
                cell = self._rows_of(written)[bad[0]][place].strip()
                issues.append(f"{self.names[place]}: {_refusal_of(cell, number, bad)}")
        if issues:
            raise ConfigError([f"{self.path}: {issue}" for issue in issues])
        return table

    def _rows_of(self, text: bytes) -> list[list[str]]:
        """Return the cells of each line that is not blank. Raises ConfigError."""
        lines = [line for line in text.decode().split("\n") if line.strip()]
        try:
            return list(csv.reader(lines, delimiter=self.delimiter.decode()))
        except csv.Error as error:
            raise ConfigError(f"{self.path}: cannot be read: {error}") from error

    def _number(self, cell: str) -> float | None:
        """Return the number in a cell, NaN for an empty cell; None if the cell is not allowed."""
        if not cell:
            return math.nan
        if self.is_strict and cell in NOT_FINITE:
            return float(cell)
        value = float(cell) if NUMBER.fullmatch(cell) else math.inf
        return value if math.isfinite(value) else None


def open_csv(path: Path) -> CsvFile:
    """Open a CSV file for reading: its header and rows. Raises ConfigError if it cannot be read."""
    with as_config_errors(path), _text_of(path) as stream:
        head = stream.read(_LONGEST)
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, size - _LONGEST))
        _, newline, last = with_newlines(stream.read()).rpartition(b"\n")
    header = header_of(path, head)
    last = last if newline and header.end < size else b""
    # A last line that is short was cut off, as by a full disk or a kill.
    is_short = bool(last.strip()) and last.count(header.delimiter.encode()) < len(header.names) - 1
    notes = (CUT,) if is_short and size - len(last) > header.end else ()
    rows = head[header.end :]
    cells = first_cells(header, rows)
    moments = {name: stamp for name, cell in cells.items() if (stamp := stamp_of(cell)) is not None}
    return CsvFile(
        path=path,
        names=header.names,
        remarks=(*notes, *header.notes, *doubts_about(cells, header, rows)),
        delimiter=header.delimiter.encode(),
        head=header.end,
        last=last,
        has_commas=header.has_commas,
        encoding=header.encoding,
        moments=moments,
        units=dict.fromkeys(moments, "s"),
        starts=_starts_of(moments, None),
    )


def _text_of(path: Path) -> BinaryIO:
    """Open a text file as bytes, UTF-16 converted to UTF-8. Raises ConfigError, OSError."""
    stream = path.open("rb")
    mark = stream.read(2)
    stream.seek(0)
    if mark not in _UTF_16:
        return stream
    with stream:
        size = path.stat().st_size
        if size > _MOST_UTF_16:
            raise ConfigError(f"{path}: {size} bytes of UTF-16; allowed: up to {_MOST_UTF_16}, or a text in UTF-8")
        try:
            return io.BytesIO(stream.read().decode("utf-16").encode())
        except UnicodeDecodeError as error:
            raise ConfigError(f"{path}: cannot be read: not UTF-16 at byte {error.start}") from error


def _starts_of(moments: Mapping[str, Stamp], zone: tzinfo | None) -> dict[str, int]:
    """Return the wall clock [ns since 1970] at the first cell of each column of dates; for times of day 0."""
    return {name: stamp.epoch_ns(zone) for name, stamp in moments.items()}


def _refusal_of(cell: str, number: int, bad: Sequence[int]) -> str:
    """Return why a `cell`, the first of the rows `bad`, is refused, in a block that begins at row `number`."""
    try:
        text = "a finite number" if not math.isfinite(float(cell)) else "a number"
        shown = cell
    except ValueError:
        shown, text = repr(cell[:40]), f"a number{_OR_A_DATE if ':' in cell or cell.count('/') == 2 else ''}"
        if "," in cell and NUMBER.fullmatch(cell.replace(",", ".", 1)):
            text = "a number with a decimal point"
    more = f" ({len(bad)} such rows)" if len(bad) > 1 else ""
    return f"{shown} in row {number + bad[0]}{more}; allowed: {text}"
