"""CSV files: comma, semicolon or tab, one header row, decimal points. An empty cell is no sample (NaN)."""

from __future__ import annotations

import codecs
import csv
import functools
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.files import read_bytes
from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.log_frames import CUT
from liftgate_hil.measurement.measurement import Floats
from liftgate_hil.measurement.series import Series

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


_BLANK = re.compile(rb"\s*\n")
_BLOCK = 1 << 22  # bytes that are parsed at a time, so that an interrupt does not wait for long
_EMPTY = 9.87654321e300  # stands for an empty cell while numpy parses


@dataclass(frozen=True)
class CsvFile:
    """See Columns."""

    path: Path
    names: Sequence[str]
    delimiter: str
    body: bytes  # UTF-8, without the header and what is blank before it
    sample: str = "row"
    notes: Sequence[str] = ()

    @functools.cached_property
    def _places(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.names)}

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Series]:
        """See Columns."""
        if not self.body.strip():
            issues.append(f"{self.path}: no rows; allowed: rows below the header")
            return {}
        columns = self._fast(wanted)
        if columns is None:
            columns = self._slow(wanted, issues)
        return {name: Series(values) for name, values in columns.items()}

    def _fast(self, wanted: Sequence[str]) -> dict[str, Floats] | None:
        """All of it by numpy; None where any row is not as it should be, or a cell neither empty nor finite."""
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
        """Cell by cell, so that it can be told which one is wrong."""
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
    """The file's header and rows. Raises ConfigError where it cannot be read."""
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
    start = body.rfind(b"\n") + 1  # of the last line
    if start and body[start:].strip() and body[start:].count(delimiter.encode()) < len(names) - 1:
        # As a full disk or a kill leaves it.
        return CsvFile(path, names, delimiter, body[:start].rstrip(b"\n"), notes=(CUT,))
    return CsvFile(path, names, delimiter, body.rstrip(b"\n"))


def _parsed(block: bytes, delimiter: str, width: int, places: Sequence[int]) -> Floats | None:
    """(rows, places) of the cells of these columns, NaN where they are empty; None where numpy cannot tell."""
    own = np.frombuffer(block, dtype=np.uint8)
    ends = np.flatnonzero(own == ord("\n"))
    if not block.endswith(b"\n"):
        ends = np.append(ends, len(block))
    marks = np.flatnonzero(own == ord(delimiter))
    if len(marks) != len(ends) * (width - 1):
        return None
    if width > 1:  # each row has its own
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
    """The same rows with a number that stands for it in each empty cell."""
    mark, number = delimiter.encode(), repr(_EMPTY).encode()
    for _ in range(2):  # of two in a row the first time finds one
        block = block.replace(mark + mark, mark + number + mark)
    block = block.replace(b"\n" + mark, b"\n" + number + mark).replace(
        mark + b"\n", mark + number + b"\n"
    )
    first = number if block.startswith(mark) else b""
    last = number if block.endswith(mark) else b""
    return first + block + last


def _number(cell: str) -> float:
    """The cell's value; NaN for an empty one, inf for what is no finite number."""
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
