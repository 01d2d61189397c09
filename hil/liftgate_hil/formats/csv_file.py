"""CSV files, written and read: a header, then one row of numbers per tick, each exact to the last bit.

A recording made in real time has one more column, the start of the run: a bus log beside it has the computer's
time. Files of other tools may have semicolons or tabs, and empty cells (NaN).
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import functools
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_hil.config.files import read_bytes
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.csv_text import CsvText
from liftgate_hil.formats.mcap_layout import START_COLUMN
from liftgate_hil.formats.reading import CUT, as_config_errors, is_cut
from liftgate_hil.formats.recording import Floats, Series, WithoutFrames, column_signal
from liftgate_plant.signals import TIME, Signal


class CsvWriter:
    """Writer of CSV recordings."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        self._stream = stream
        self._content = content
        self._start: float | None = None  # start of the run, s since 1970
        self._text: CsvText | None = None
        self.written = 0

    def begin(self, epoch_ns: int) -> None:
        """Write the header; if `epoch_ns` is not 0, with a column for the start of the run."""
        columns, row = list(self._content.columns), dict(self._content.row)
        if epoch_ns:
            self._start = epoch_ns / 1e9
            columns, row = [*columns, START_COLUMN], {**row, START_COLUMN: TIME}
        self._text = CsvText(columns, row)
        self._write(self._text.head)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write one line per row."""
        if self._start is not None:
            rows = np.column_stack([rows, np.full(len(rows), self._start)])
        self._write(self._begun().lines(rows))

    def write_frames(self, frames: Any) -> None:
        """Ignore frames: CSV holds rows only."""

    def flush(self) -> None:
        """Flush the stream to the operating system."""
        self._stream.flush()

    def close(self) -> None:
        """Close the file, which has at least a header."""
        self._begun()
        self._stream.close()

    def _begun(self) -> CsvText:
        """Return the formatter; write the header first if `begin` was not called (no wall clock applies then)."""
        if self._text is None:
            self.begin(0)
        assert self._text is not None
        return self._text

    def _write(self, text: bytes) -> None:
        self._stream.write(text)
        self.written += len(text)


_FEW = 3  # if fewer than a third of the columns are wanted, only their cells are parsed
_JSON = b"0123456789+-.eE,\n"  # characters of rows that may be parsed as JSON
_LATEST_START = 1e10  # latest plausible start of a run, s since 1970


@dataclass(frozen=True)
class CsvRecording(WithoutFrames):
    """Recording read from a CSV file."""

    path: Path
    signals: Mapping[str, Signal]
    delimiter: bytes
    head: int  # length of the header [bytes]
    names: Sequence[str]  # names of all columns, including START_COLUMN
    start_ns: int = 0
    notes: Sequence[str] = ()
    about: str = ""

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of these columns, one block at a time; empty cells are NaN."""
        places = [self.names.index(name) for name in wanted]
        with as_config_errors(self.path), self.path.open("rb") as stream:
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
        """Return these columns (n, len(places)) of n lines of text; `number` is that of the first row."""
        if _FEW * len(places) >= len(self.names):
            return self._parsed(text, number)[:, places]
        text = text.replace(b"\r", b"")
        letters = np.frombuffer(text, dtype=np.uint8)
        ends = np.append(np.flatnonzero(letters == ord("\n")), len(text))
        marks = np.flatnonzero(letters == self.delimiter[0])
        if len(marks) == len(ends) * (len(self.names) - 1):
            lines = marks.reshape(len(ends), -1)
            begins = np.append(0, ends[:-1] + 1)
            # Each line must have its own delimiters.
            if (lines[:, 0] >= begins).all() and (lines[:, -1] < ends).all():
                inner = len(self.names) - 1
                first = np.column_stack(
                    [lines[:, place - 1] + 1 if place else begins for place in places]
                )
                last = np.column_stack(
                    [lines[:, place] if place < inner else ends for place in places]
                )
                spans = zip(first.ravel().tolist(), last.ravel().tolist(), strict=True)
                cells = b",".join([text[begin:end] for begin, end in spans])
                with contextlib.suppress(ValueError):  # no JSON: .5, 007, an empty cell
                    if not cells.translate(None, _JSON):
                        found = np.array(orjson.loads(b"[" + cells + b"]"), dtype=np.float64)
                        return found.reshape(len(ends), len(places))
        return self._parsed(text, number)[:, places]

    def start_in(self, line: bytes) -> int:
        """Return the wall clock [ns] at the start of the run from a row; 0 if the value is not plausible."""
        start = self._parsed(line.rstrip(b"\n"), 1)[0, self.names.index(START_COLUMN)]
        return round(start * 1e6) * 1000 if 0.0 < start < _LATEST_START else 0

    def _parsed(self, text: bytes, number: int) -> Floats:
        """Return all columns (n, columns) of n lines of text as numbers; an empty cell is NaN. Raises ConfigError.

        `number` is that of the first row in the file, for the error message.
        """
        text = text.replace(b"\r", b"").replace(self.delimiter, b",")
        width = len(self.names)
        if not text.translate(None, _JSON) and b",," not in text:
            try:
                rows = orjson.loads(b"[[" + text.replace(b"\n", b"],[") + b"]]")
                table = np.array(rows, dtype=np.float64)
                if table.shape[1] == width:
                    return table
            except (ValueError, IndexError):  # .5, 007, an empty cell, rows of different lengths
                pass
        return np.array(
            [self._row(line, number + k) for k, line in enumerate(text.decode().split("\n"))]
        )

    def _row(self, line: str, number: int) -> list[float]:
        """Return the numbers in a line; an empty cell is NaN. Raises ConfigError."""
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


def open_csv_recording(path: Path) -> CsvRecording:
    """Open a CSV recording: a header, and rows of numbers. Raises ConfigError."""
    with as_config_errors(path), path.open("rb") as stream:
        line = stream.readline(1 << 20)
        head, first = stream.tell(), stream.readline(1 << 20)
        text = line.decode("utf-8-sig").strip()
        if "\0" in text or not line.endswith(b"\n"):
            raise ConfigError(f"{path}: cannot be read: no header and rows below it")
    delimiter = max(",;\t", key=text.count)
    names = [name.strip() for name in next(csv.reader([text], delimiter=delimiter), [])]
    if names[:1] != ["time_s"]:
        raise ConfigError(
            f"{path}: time_s: missing; allowed: a recording whose first column is time_s"
        )
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ConfigError(f"{path}: {twice}: twice in the header; allowed: once")
    notes = (CUT,) if is_cut(path) else ()
    signals = {name: column_signal(name) for name in names if name != START_COLUMN}
    found = CsvRecording(path, signals, delimiter.encode(), head, names, notes=notes)
    if START_COLUMN in names and first.endswith(b"\n"):
        with as_config_errors(path):
            return replace(found, start_ns=found.start_in(first))
    return found


_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


_BLANK = re.compile(rb"\s*\n")
_BLOCK = 1 << 22  # bytes that are parsed at a time, so that an interrupt does not wait for long
_EMPTY = 9.87654321e300  # stands for an empty cell while numpy parses


@dataclass(frozen=True)
class CsvFile:
    """Columns of a CSV file."""

    path: Path
    names: Sequence[str]
    delimiter: str
    body: bytes  # UTF-8, without the header and blank lines before it
    sample: str = "row"
    notes: Sequence[str] = ()

    @functools.cached_property
    def _places(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.names)}

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Series]:
        """Read these columns; one with a cell that is neither empty nor finite is left out, with an issue."""
        if not self.body.strip():
            issues.append(f"{self.path}: no rows; allowed: rows below the header")
            return {}
        columns = self._fast(wanted)
        if columns is None:
            columns = self._slow(wanted, issues)
        return {name: Series(values) for name, values in columns.items()}

    def _fast(self, wanted: Sequence[str]) -> dict[str, Floats] | None:
        """Parse with numpy; None if a row is malformed, or a cell is neither empty nor finite."""
        if b'"' in self.body:
            return None
        places = [self._places[name] for name in wanted]
        parts = []
        first = 0
        while first < len(self.body):
            last = self.body.find(b"\n", first + _BLOCK) + 1 or len(self.body)
            part = _parsed(self.body[first:last], self.delimiter, len(self.names), places)
            if part is None:
                return None
            parts.append(part)
            first = last
        return {
            name: np.concatenate([each[:, k] for each in parts]) for k, name in enumerate(wanted)
        }

    def _slow(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Floats]:
        """Parse cell by cell, so that issues can name the row and the cell."""
        lines = [line for line in self.body.decode().splitlines() if line.strip()]
        try:
            rows = list(csv.reader(lines, delimiter=self.delimiter))
        except csv.Error as error:
            issues.append(f"{self.path}: cannot be read: {error}")
            return {}
        width = len(self.names)
        for number, row in enumerate(rows):
            if len(row) < width or any(cell.strip() for cell in row[width:]):
                comma = "" if self.delimiter != "," else " (is it a decimal comma?)"
                issues.append(
                    f"{self.path}: row {number + 1}: {len(row)} cells{comma}; "
                    f"allowed: {width}, as in the header"
                )
                return {}
        result = {}
        for name in wanted:
            place = self._places[name]
            values = np.array([_number(row[place]) for row in rows])
            bad = np.flatnonzero(np.isinf(values))
            if len(bad):
                issues.append(_fault(self.path, name, rows[bad[0]][place].strip(), bad))
            else:
                result[name] = values
        return result


def open_csv(path: Path) -> CsvFile:
    """Open a CSV file: its header and rows. Raises ConfigError if it cannot be read."""
    try:
        text = read_bytes(path).removeprefix(codecs.BOM_UTF8)
        if not text.isascii():
            text.decode()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: cannot be read: not UTF-8 at byte {error.start}") from error
    if b"\0" in text:
        raise ConfigError(f"{path}: cannot be read: binary; allowed: a CSV text")
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    blank = _BLANK.match(text)
    begin = blank.end() if blank else 0
    end = text.find(b"\n", begin) + 1 or len(text)
    header = text[begin:end].decode().rstrip("\n")
    if not header.strip():
        raise ConfigError(f"{path}: empty; allowed: a header and rows")
    delimiter = max(",;\t", key=header.count)
    names = [name.strip() for name in next(csv.reader([header], delimiter=delimiter))]
    if all(_NUMBER.fullmatch(name) for name in names):
        raise ConfigError(f"{path}: no header; allowed: the columns' names in the first row")
    twice = sorted(name for name, count in Counter(names).items() if name and count > 1)
    if twice:
        raise ConfigError(f"{path}: {twice[0]}: twice in the header; allowed: once")
    body = text[end:]
    start = body.rfind(b"\n") + 1  # start of the last line
    if start and body[start:].strip() and body[start:].count(delimiter.encode()) < len(names) - 1:
        # The last line is cut off, as by a full disk or a kill.
        return CsvFile(path, names, delimiter, body[:start].rstrip(b"\n"), notes=(CUT,))
    return CsvFile(path, names, delimiter, body.rstrip(b"\n"))


def _parsed(block: bytes, delimiter: str, width: int, places: Sequence[int]) -> Floats | None:
    """Return the cells (rows, places) of these columns, NaN if empty; None if numpy cannot parse them."""
    own = np.frombuffer(block, dtype=np.uint8)
    ends = np.flatnonzero(own == ord("\n"))
    if not block.endswith(b"\n"):
        ends = np.append(ends, len(block))
    marks = np.flatnonzero(own == ord(delimiter))
    if len(marks) != len(ends) * (width - 1):
        return None
    if width > 1:  # each row must have its own delimiters
        of_rows = marks.reshape(-1, width - 1)
        if np.any(of_rows[:, -1] > ends) or np.any(of_rows[1:, 0] < ends[:-1]):
            return None
    lines = _with_empty_ones(block, delimiter).decode().split("\n")[: len(ends)]
    try:
        numbers = np.loadtxt(lines, delimiter=delimiter, comments=None, usecols=places, ndmin=2)
    except ValueError:
        return None
    if len(numbers) != len(ends) or not np.all(np.isfinite(numbers)):
        return None
    numbers[numbers == _EMPTY] = math.nan
    return numbers


def _with_empty_ones(block: bytes, delimiter: str) -> bytes:
    """Return the same rows with the placeholder _EMPTY in each empty cell."""
    mark, number = delimiter.encode(), repr(_EMPTY).encode()
    for _ in range(2):  # the first pass finds only every other one in a row
        block = block.replace(mark + mark, mark + number + mark)
    block = block.replace(b"\n" + mark, b"\n" + number + mark).replace(
        mark + b"\n", mark + number + b"\n"
    )
    first = number if block.startswith(mark) else b""
    last = number if block.endswith(mark) else b""
    return first + block + last


def _number(cell: str) -> float:
    """Return the cell's value; NaN for an empty cell, inf for anything but a finite number."""
    cell = cell.strip()
    if not cell:
        return math.nan
    return float(cell) if _NUMBER.fullmatch(cell) else math.inf


def _fault(path: Path, name: str, cell: str, bad: NDArray[np.int64]) -> str:
    try:
        said = "a finite number" if not math.isfinite(float(cell)) else "a number"
        shown = cell
    except ValueError:
        shown, said = repr(cell[:40]), "a number"
        if "," in cell and _NUMBER.fullmatch(cell.replace(",", ".", 1)):
            said = "a number with a decimal point"
    more = f" ({len(bad)} such rows)" if len(bad) > 1 else ""
    return f"{path}: {name}: {shown} in row {int(bad[0]) + 1}{more}; allowed: {said}"
