"""Writer of CSV recordings: a header, then one row of numbers per tick, each exact to the last bit.

A recording made in real time has one more column, the start of the run: a bus log beside it has the computer's
time.

Every number has the shortest form that reads back as the same value. Values that do not change within a block of
rows are formatted once, and so are columns with equal values, such as the drives of a symmetrical gate. orjson
formats the other numbers from the array, without a Python object for each; compiled code puts them between the
constant pieces.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_compiler import compilable, compiled, put_text
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.mcap_layout import START_COLUMN
from liftgate_hil.formats.writer import StreamWriter
from liftgate_hil.signals import COLUMNS
from liftgate_plant.signals import TIME, Signal

_OPEN, _CLOSE, _COMMA, _MINUS, _ZERO = (ord(each) for each in "[],-0")
_LONGEST = 24  # characters of the longest number: -2.2250738585072014e-308
_BLOCK = 8192  # rows at a time: their text stays in the processor's cache
_NAN, _INF = np.frombuffer(b"nan", np.uint8), np.frombuffer(b"inf", np.uint8)


class Layout(NamedTuple):
    """Layout of the lines of a block: constant pieces of text, and between them the cells that change."""

    glue: NDArray[np.uint8]  # all constant pieces, one after the other
    ends: NDArray[np.int64]  # (n,) where the piece before each cell ends in `glue`
    whole: NDArray[np.int64]  # (n,) 1: an integer, without a decimal point
    alike: NDArray[np.int64]  # (n,) first cell with the same values: this one or an earlier one
    spans: NDArray[np.int64]  # (n, 2) where the current row's cells begin and end in the text


@compilable
def put_whole(out: NDArray[np.uint8], at: int, value: int) -> int:
    """Write the digits of an integer into a buffer from `at` on; return where they end."""
    if value < 0:
        out[at] = _MINUS
        at += 1
        value = -value
    end = at + 1
    rest = value // 10
    while rest > 0:
        end += 1
        rest //= 10
    for place in range(end - 1, at - 1, -1):
        out[place] = _ZERO + value % 10
        value //= 10
    return end


@compilable
def put_word(out: NDArray[np.uint8], at: int, value: float) -> int:
    """Write nan or inf into a buffer, spelled as in Python; return where the word ends."""
    word = _INF
    if math.isnan(value):
        word = _NAN
    elif value < 0.0:
        out[at] = _MINUS
        at += 1
    for letter in word:
        out[at] = letter
        at += 1
    return at


@compilable
def put_number(out: NDArray[np.uint8], at: int, digits: NDArray[np.uint8], read: int) -> tuple[int, int]:
    """Copy the next number of the JSON text `digits` into a buffer.

    The number is searched from `read` on; return where it ends in `out`, and where in `digits`.
    """
    while digits[read] in (_OPEN, _CLOSE, _COMMA):
        read += 1
    first = read
    while digits[read] not in (_COMMA, _CLOSE):
        read += 1
    put_text(out, at, digits, first, read - first)
    return at + read - first, read


@compilable
def put_lines(
    layout: Layout, cells: NDArray[np.float64], digits: NDArray[np.uint8], out: NDArray[np.uint8]
) -> int:
    """Write the lines of rows (m, n) of changing cells into `out`; return their length [bytes].

    `digits` is the JSON text of the cells that are neither integers nor equal to an earlier one: numbers in
    brackets.
    """
    glue, ends, whole, alike, spans = layout
    at = read = 0
    for row in range(cells.shape[0]):
        begin = 0
        for k in range(cells.shape[1]):
            put_text(out, at, glue, begin, ends[k] - begin)
            at += ends[k] - begin
            begin = ends[k]
            if alike[k] != k:
                first, end = spans[alike[k], 0], spans[alike[k], 1]
                put_text(out, at, out, first, end - first)
                at += end - first
                continue
            spans[k, 0] = at
            value = cells[row, k]
            is_finite = math.isfinite(value)
            if whole[k] == 0:
                end, read = put_number(out, at, digits, read)
                if is_finite:  # JSON has only null for other values
                    at = end
            elif is_finite:
                at = put_whole(out, at, int(value))
            if not is_finite:
                at = put_word(out, at, value)
            spans[k, 1] = at
        put_text(out, at, glue, begin, len(glue) - begin)
        at += len(glue) - begin
    return at


def _quoted(name: str) -> str:
    """Return a column's name for the header, in quotes if it has a delimiter or a quote (RFC 4180)."""
    if any(sign in name for sign in ',"\r\n;\t'):
        return '"' + name.replace('"', '""') + '"'
    return name


class CsvText:
    """Formatter of the columns `names` as lines of CSV, from rows that have all columns of `row`."""

    def __init__(self, names: Sequence[str], row: Mapping[str, Signal] = COLUMNS) -> None:
        self.head = (",".join(map(_quoted, names)) + "\n").encode()
        places = {name: place for place, name in enumerate(row)}
        self._keep = np.array([places[name] for name in names])
        self._whole = np.array([row[name].is_whole for name in names])
        self._out = np.empty(0, dtype=np.uint8)
        self._put: Any = compiled(put_lines)

    def lines(self, rows: NDArray[np.float64]) -> bytes:
        """Return rows as lines of CSV."""
        if len(rows) > _BLOCK:
            parts = range(0, len(rows), _BLOCK)
            return b"".join(self.lines(rows[first : first + _BLOCK]) for first in parts)
        if not len(rows):
            return b""
        bits = rows.view(np.int64)
        changes = (bits != bits[0]).any(axis=0)[self._keep]
        whole = self._whole[changes]
        cells = rows[:, self._keep[changes]]
        alike = alike_columns(cells, whole)
        layout = self._layout(rows[0, self._keep], changes, alike)
        room = len(rows) * (len(layout.glue) + cells.shape[1] * _LONGEST)
        if len(self._out) < room:
            self._out = np.empty(room, dtype=np.uint8)
        length = self._put(layout, cells, digits_of(cells, whole, alike), self._out)
        return self._out[:length].tobytes()

    def _layout(self, first: NDArray[np.float64], changes: NDArray[np.bool_], alike: NDArray[np.int64]) -> Layout:
        """Return the layout of a block's lines: the first row's text with gaps for the cells that change."""
        pieces, ends, length = [], [], 0
        for place, (value, is_whole) in enumerate(zip(first.tolist(), self._whole, strict=True)):
            if place:
                pieces.append(b",")
                length += 1
            if changes[place]:
                ends.append(length)
                continue
            pieces.append(_text(value, bool(is_whole)))
            length += len(pieces[-1])
        pieces.append(b"\n")
        glue = np.frombuffer(b"".join(pieces), dtype=np.uint8)
        return Layout(
            glue=glue,
            ends=np.array(ends, dtype=np.int64),
            whole=self._whole[changes].astype(np.int64),
            alike=alike,
            spans=np.zeros((len(ends), 2), dtype=np.int64),
        )


def alike_columns(cells: NDArray[np.float64], whole: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return (n,) for each column of cells (m, n) the index of the first column with the same text.

    Columns have the same text if they are equal to the bit, and both or neither hold integers.
    """
    bits = cells.view(np.int64)
    first: dict[tuple[Any, ...], int] = {}
    found = np.arange(cells.shape[1])
    marks = zip(whole.tolist(), bits[0].tolist(), bits.sum(axis=0).tolist(), strict=True)
    for column, mark in enumerate(marks):
        other = first.setdefault(mark, column)
        if other != column and np.array_equal(bits[:, column], bits[:, other]):
            found[column] = other
    return found


def digits_of(cells: NDArray[np.float64], whole: NDArray[np.bool_], alike: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return cells (m, n) as the JSON text of an array of rows, without integers and repeated columns.

    `whole` (n,) tells which columns hold integers, `alike` (n,) is that of `alike_columns`.
    """
    own = ~whole & (alike == np.arange(len(alike)))
    if not own.any():
        return np.zeros(0, dtype=np.uint8)
    numbers = np.ascontiguousarray(cells[:, own])
    digits = orjson.dumps(numbers, option=orjson.OPT_SERIALIZE_NUMPY)
    return np.frombuffer(digits, dtype=np.uint8)


def _text(value: float, is_whole: bool) -> bytes:
    """Return the text of one number in a cell."""
    if not math.isfinite(value):
        return repr(value).encode()
    return orjson.dumps(int(value) if is_whole else value)


class CsvWriter(StreamWriter):
    """Writer of CSV recordings."""

    def __init__(self, stream: BinaryIO, content: Content) -> None:
        super().__init__(stream, content)
        self._start: float | None = None  # start of the run, s since 1970
        self._text: CsvText | None = None

    def begin(self, epoch_ns: int) -> None:
        """Write the header; if `epoch_ns` is not 0, with a further column for the start of the run."""
        columns, row = list(self._content.columns), dict(self._content.row)
        if epoch_ns:
            self._start = epoch_ns / 1e9
            columns, row = [*columns, START_COLUMN], {**row, START_COLUMN: TIME}
        self._text = CsvText(columns, row)
        self._write(self._text.head)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write one line of CSV per row."""
        if self._start is not None:
            rows = np.column_stack([rows, np.full(len(rows), self._start)])
        self._write(self._begun().lines(rows))

    def close(self) -> None:
        """Close the file, with a header even if no row was written."""
        self._begun()
        self._stream.close()

    def _begun(self) -> CsvText:
        """Return the formatter; if `begin` was not called, write the header without a start of the run first."""
        if self._text is None:
            self.begin(0)
        assert self._text is not None
        return self._text
