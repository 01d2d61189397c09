"""Header of a CSV file: names and units of columns, delimiter, encoding, and how the cells are written.

Files of other tools may begin with the delimiter (`sep=;`, for Excel) or with comments, have a row of units below
the header, or no header at all. A header that is not UTF-8 is read as Windows-1252, as Excel writes it, and so are
its rows.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from liftgate_hil.config.units import dimensions_named, headed_unit
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.local_time import in_minutes, stamp_of
from liftgate_hil.formats.recording import check_width

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
COMMAS = "decimal commas are read as points"
UNNAMED = "columns without a name are left out"
UNITS = "the row below the header is read as units"
NUMBERED = "without a header: its columns are named by their numbers, from 1"
COMMENTED = "the last comment above the rows is read as the header"
WINDOWS = "the header is not UTF-8, and is read as Windows-1252"
NOT_FINITE = ("nan", "inf", "-inf")  # as recordings have them of a plant that has diverged
_MISSING = ("n/a", "#n/a", "na")  # a number that is missing; N/A is a unit, too

_UTF_8, _WINDOWS = "UTF-8", "Windows-1252"
_BLANK = re.compile(rb"\s*[\r\n]")
_LINE_OF = re.compile(rb"[^\r\n]*(?:\r\n|\r|\n)?")
_SEPARATOR = re.compile(rb"\"?sep=([,;\t])\"?\s*", re.IGNORECASE)
_COMMENT = re.compile(rb"[ \t]*(?:#(?![A-Z]+[/!?])|%|//)[^\r\n]*(?:\r\n|\r|\n|\Z)")
_COMMENTS = re.compile(rb"^[ \t]*(?:#(?![A-Z]+[/!?])|%|//)[^\n]*(?:\n|\Z)", re.MULTILINE)
_COMMA, _POINT = re.compile(rb"[+-]?\d*,\d+([eE][+-]?\d+)?"), re.compile(rb"[+-]?\d*\.\d+([eE][+-]?\d+)?")


class Header(NamedTuple):
    """Header of a CSV file: columns, begin of the rows, delimiter, encoding and decimal sign."""

    names: list[str]  # of the columns; where a row of units follows, with the unit in brackets
    delimiter: str
    end: int  # byte at which the rows begin
    has_commas: bool  # numbers have decimal commas
    encoding: str
    notes: tuple[str, ...]


def header_of(path: Path, text: bytes) -> Header:
    """Return the header of a CSV file from its first bytes, which hold the complete header. Raises ConfigError."""
    begin = len(codecs.BOM_UTF8) if text.startswith(codecs.BOM_UTF8) else 0
    line, end = _next_line(text, begin)
    separator = _SEPARATOR.fullmatch(line)
    if separator is not None:
        line, end = _next_line(text, end)
    comment = b""
    while _COMMENT.fullmatch(line):
        comment, (line, end) = line, _next_line(text, end)
    encoding = _encoding_of(comment + line)
    header = decoded(path, line, end - len(line), encoding).strip()
    if not header:
        raise ConfigError(f"{path}: empty; allowed: a header and rows")
    delimiter = separator[1].decode() if separator is not None else max(",;\t", key=header.count)
    check_width(path, header.count(delimiter) + 1)
    try:
        names, others = _cells(header, delimiter), [each for each in ";\t" if separator is None and each in header]
        if others and all(map(_is_value, _cells(header, others[0]))):  # a row, maybe with decimal commas
            delimiter, names = others[0], _cells(header, others[0])
        has_own = not all(map(_is_value, names))
        if not has_own:
            end, count = end - len(line), len(names)
            names = _cells(decoded(path, comment, 0, encoding).strip().lstrip("#%/ "), delimiter)
            is_commented = len(names) == count and not all(map(_is_value, names))
            names = names if is_commented else [str(number + 1) for number in range(count)]
    except csv.Error as error:
        raise ConfigError(f"{path}: its first line cannot be read: {error}; allowed: a header") from error
    below, after = _next_line(text, end)
    if (
        len(names) == 1
        and len(cells := below.split()) > 1
        and all(NUMBER.fullmatch(each.decode("latin-1")) for each in cells)
    ):
        raise ConfigError(f"{path}: cells separated by blanks; allowed: by commas, semicolons or tabs")
    units = _units_of(below, _next_line(text, after)[0], delimiter, len(names)) if has_own else []
    if units:
        end, encoding = after, encoding if _encoding_of(below) == _UTF_8 else _WINDOWS
        pairs = zip(names, units, strict=True)
        names = [f"{name} [{unit}]" if unit and not headed_unit(name) else name for name, unit in pairs]
    twice = sorted(name for name, count in Counter(names).items() if name and count > 1)
    if twice:
        raise ConfigError(f"{path}: {twice[0]}: twice in the header; allowed: once")
    has_commas = delimiter != "," and _has_commas(text[end:], delimiter.encode())
    said = (
        (NUMBERED, not has_own and not is_commented),
        (COMMENTED, not has_own and is_commented),
        (COMMAS, has_commas),
        (UNITS, bool(units)),
        (WINDOWS, encoding != _UTF_8),
    )
    return Header(names, delimiter, end, has_commas, encoding, tuple(note for note, is_so in said if is_so))


def decoded(path: Path, text: bytes, at: int, encoding: str) -> str:
    """Return as text a block of a file that begins at byte `at`. Raises ConfigError if it is not text."""
    if b"\0" in text:
        raise ConfigError(f"{path}: cannot be read: binary; allowed: a CSV text")
    try:
        return text.decode(encoding)
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: cannot be read: not {encoding} at byte {at + error.start}") from error


def without_comments(text: bytes) -> bytes:
    """Return lines of a table without comment lines."""
    if any(mark in text for mark in (b"#", b"%", b"//")):
        return _COMMENTS.sub(b"", text)
    return text


def _next_line(text: bytes, begin: int) -> tuple[bytes, int]:
    """Return the first line from `begin` on that is not blank (empty: none), and the position of its end."""
    while blank := _BLANK.match(text, begin):
        begin = blank.end()
    line = _LINE_OF.match(text, begin)
    assert line is not None
    return line[0], line.end()


def _encoding_of(line: bytes) -> str:
    """Return the encoding of a line: Windows-1252 if it is valid as that and not as UTF-8."""
    try:
        line.decode()
    except UnicodeDecodeError:
        try:
            line.decode(_WINDOWS)
        except UnicodeDecodeError:
            return _UTF_8
        return _WINDOWS
    return _UTF_8


def _cells(line: str, delimiter: str) -> list[str]:
    """Return a line split into its cells. Raises csv.Error."""
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


def _units_of(below: bytes, first: bytes, delimiter: str, count: int) -> list[str]:
    """Return the units, without brackets, in the line below a header of `count` columns; []: no line of units.

    The cells are units if none is a number, the first one (usually the time) is a known unit, and
    the line after it begins with a number. A dash stands for none.
    """
    try:
        cells, numbers = (_cells(line.decode(_encoding_of(line)).strip(), delimiter) for line in (below, first))
    except (csv.Error, UnicodeDecodeError):
        return []
    units = ["" if cell == "-" else cell.strip("[]() ") for cell in cells]
    if not len(cells) == len(numbers) == count or any(map(_is_number, cells)):
        return []
    return units if units[0] and dimensions_named(units[0]) and _is_number(numbers[0]) else []


def _is_value(cell: str) -> bool:
    """Whether a cell is a number, a date or a time of day."""
    return NUMBER.fullmatch(cell.replace(",", ".")) is not None or stamp_of(cell) is not None


def _is_number(cell: str) -> bool:
    """Whether a cell is a number, or a word for a missing one."""
    return NUMBER.fullmatch(cell.replace(",", ".")) is not None or cell.lower() in (*NOT_FINITE, *_MISSING)


def _has_commas(text: bytes, delimiter: bytes) -> bool:
    """Whether a text's numbers have decimal commas: some cells are such numbers, and none has a point."""
    cells = [cell.strip(b' "') for cell in text.replace(b"\r", b"\n").replace(b"\n", delimiter).split(delimiter)]
    return any(map(_COMMA.fullmatch, cells)) and not any(map(_POINT.fullmatch, cells))


# Cells that stand for no value, as other programs write them (pandas.read_csv's na_values).
_NO_VALUE = re.compile(
    rb"(?:^|(?<=[,;\t\n]))[ ]*(?:-?nan|#?n/a|#n/a n/a|<?na>?|null|none)[ ]*(?=[,;\t\n]|$)", re.IGNORECASE
)
_NO_VALUES = (b"nan", b"n/a", b"na>", b"null", b"none", b",na", b";na", b"\tna", b" na")  # one of these is in each
_LETTERS = re.compile(rb"[a-df-zA-DF-Z#<]")  # besides the exponent's
# Cells with a point of a table with semicolons, as spreadsheets write it where the comma is the decimal one; and
# where all of them may be groups of thousands.
_POINTED = re.compile(rb"(?<=[;\n])[+-]?\d+\.\d+(?=[;\r\n])")
_GROUPED = re.compile(rb"([+-]?[1-9]\d{0,2}\.\d{3})(?: [+-]?[1-9]\d{0,2}\.\d{3})*")


def without_words(text: bytes) -> bytes:
    """Return lines of a table in which words for a missing value are replaced by empty cells."""
    if not _LETTERS.search(text) or not any(map(text.lower().__contains__, _NO_VALUES)):
        return text
    return _NO_VALUE.sub(b"", text)


def first_cells(header: Header, text: bytes) -> dict[str, str]:
    """Return the cells of a table's first row by column name; none if the row cannot be read."""
    first = next((line for line in without_comments(with_newlines(text)).split(b"\n") if line.strip()), b"")
    try:
        cells = next(csv.reader([first.decode(header.encoding)], delimiter=header.delimiter), [])
    except (csv.Error, UnicodeDecodeError):
        return {}
    return {name: cell for name, cell in zip(header.names, cells, strict=False) if name}


def doubts_about(cells: Mapping[str, str], header: Header, rows: bytes) -> Iterator[str]:
    """Yield notes on ambiguous values (times of day, thousands), given the first cells and lines of a table."""
    for name, cell in cells.items():
        if in_minutes(cell):
            yield f"{name}: {cell.strip()} is read as hours and minutes"
    is_sheet = header.delimiter == ";" and not header.has_commas and b"," not in rows
    if is_sheet and (grouped := _GROUPED.fullmatch(b" ".join(_POINTED.findall(rows)))):
        yield f"{grouped[1].decode()} is read as {float(grouped[1])}, not with thousands"


def with_newlines(text: bytes) -> bytes:
    """Return a text with LF for the line ends CRLF and CR; a CRLF cut in two by blocks leaves a blank line."""
    return text.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in text else text
