"""CSV files: comma, semicolon or tab, one header row, decimal points. An empty cell is no sample (NaN)."""

from __future__ import annotations

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


@dataclass(frozen=True)
class CsvFile:
    """See Columns."""

    path: Path
    names: Sequence[str]
    delimiter: str
    lines: Sequence[str]  # without the header and without blank ones
    sample: str = "row"
    notes: Sequence[str] = ()

    @functools.cached_property
    def _places(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.names)}

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Series]:
        """See Columns."""
        if not self.lines:
            issues.append(f"{self.path}: no rows; allowed: rows below the header")
            return {}
        columns = self._fast(wanted)
        if columns is None:
            columns = self._slow(wanted, issues)
        return {name: Series(values) for name, values in columns.items()}

    def _fast(self, wanted: Sequence[str]) -> dict[str, Floats] | None:
        """All of it by numpy; None where any cell is not a finite number."""
        commas = len(self.names) - 1
        if any(line.count(self.delimiter) != commas or '"' in line for line in self.lines):
            return None
        places = [self._places[name] for name in wanted]
        try:
            numbers = np.loadtxt(
                self.lines, delimiter=self.delimiter, comments=None, usecols=places, ndmin=2
            )
        except ValueError:
            return None
        if not np.all(np.isfinite(numbers)):
            return None
        return {name: np.ascontiguousarray(numbers[:, i]) for i, name in enumerate(wanted)}

    def _slow(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Floats]:
        """Cell by cell, so that it can be told which one is wrong."""
        try:
            rows = list(csv.reader(self.lines, delimiter=self.delimiter))
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
    """The file's header and lines. Raises ConfigError where it cannot be read."""
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: cannot be read: not UTF-8 at byte {error.start}") from error
    if "\0" in text:
        raise ConfigError(f"{path}: cannot be read: binary; allowed: a CSV text")
    lines = [line for line in text.splitlines() if line.strip()]
    if not lines:
        raise ConfigError(f"{path}: empty; allowed: a header and rows")
    delimiter = max(",;\t", key=lines[0].count)
    names = [name.strip() for name in next(csv.reader(lines[:1], delimiter=delimiter))]
    if all(_NUMBER.fullmatch(name) for name in names):
        raise ConfigError(f"{path}: no header; allowed: the columns' names in the first row")
    twice = sorted(name for name, count in Counter(names).items() if name and count > 1)
    if twice:
        raise ConfigError(f"{path}: {twice[0]}: twice in the header; allowed: once")
    is_cut = not text.endswith(("\n", "\r")) and lines[-1].count(delimiter) < len(names) - 1
    if is_cut and len(lines) > 1:  # as a full disk or a kill leaves it
        return CsvFile(path, names, delimiter, lines[1:-1], notes=(CUT,))
    return CsvFile(path, names, delimiter, lines[1:])


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
