"""Cells of foreign text tables: words for no value, the first row, and what may be meant otherwise."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping

from liftgate_hil.formats.csv_header import Header, without_comments
from liftgate_hil.formats.date_column import in_minutes

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
    """Return lines of a table with empty cells in place of words for no value."""
    if not _LETTERS.search(text) or not any(map(text.lower().__contains__, _NO_VALUES)):
        return text
    return _NO_VALUE.sub(b"", text)


def first_cells(header: Header, text: bytes) -> dict[str, str]:
    """Return the cells of the first row, by the names of their columns; none if it cannot be read."""
    first = next((line for line in without_comments(with_newlines(text)).split(b"\n") if line.strip()), b"")
    try:
        cells = next(csv.reader([first.decode(header.encoding)], delimiter=header.delimiter), [])
    except (csv.Error, UnicodeDecodeError):
        return {}
    return {name: cell for name, cell in zip(header.names, cells, strict=False) if name}


def doubts_about(cells: Mapping[str, str], header: Header, rows: bytes) -> Iterator[str]:
    """Yield remarks on what may be meant otherwise, in the first cells by column and in rows of a table."""
    for name, cell in cells.items():
        if in_minutes(cell):
            yield f"{name}: {cell.strip()} is read as hours and minutes"
    is_sheet = header.delimiter == ";" and not header.has_commas and b"," not in rows
    if is_sheet and (grouped := _GROUPED.fullmatch(b" ".join(_POINTED.findall(rows)))):
        yield f"{grouped[1].decode()} is read as {float(grouped[1])}, not with thousands"


def with_newlines(text: bytes) -> bytes:
    """Return the text with a newline at the end of each line, and maybe a blank line between two blocks."""
    return text.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in text else text
