"""Table of file formats by suffix: what files of each format hold, and their readers and writers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from pathlib import Path
    from typing import BinaryIO

    from liftgate_hil.formats.content import Content
    from liftgate_hil.formats.recording import Recording
    from liftgate_hil.formats.writer import Writer


class Limit(NamedTuple):
    """Limit on a recording's files: the size of each, and how many are kept."""

    size: int  # bytes
    keep: int | None = None  # number of files that are kept, the latest ones; None: all


class Format(NamedTuple):
    """Format of a suffix: its reader, its writer, and what its files can hold."""

    read: Callable[[Path], Recording]
    write: Callable[[BinaryIO, Content], Writer] | None = None
    has_rows: bool = False
    has_frames: bool = False
    holds_about: bool = False  # the provenance of the run, in full
    has_comments: bool = False  # a part of the provenance, as comments
    holds_marks: bool = False  # events with a text
    is_text: bool = False  # written directly: a kill cannot corrupt it, and a pipe can take it
    module: str = ""  # Python module that it needs
    extra: str = ""  # extra of this package that installs the module


def _lazily(module: str, name: str) -> Callable[..., Any]:
    """Return a function of a module in this package that is imported only when the function is called."""

    def call(*arguments: object) -> Any:
        return getattr(import_module(f"{__package__}.{module}"), name)(*arguments)

    return call


def _form(file: str, read: str, write: str, **holds: Any) -> Format:
    """Return the format that a module of this package reads and writes; `holds` states what its files hold."""
    return Format(_lazily(file, read), _lazily(file, write), **holds)


_CSV = _lazily("csv_file", "open_csv")
_BOTH = {"has_rows": True, "has_frames": True, "holds_about": True, "holds_marks": True}
FORMATS: Mapping[str, Format] = {
    ".csv": Format(_CSV, _lazily("csv_writer", "CsvWriter"), has_rows=True, is_text=True),
    ".tsv": Format(_CSV, has_rows=True),
    ".txt": Format(_CSV, has_rows=True),
    ".parquet": _form(
        "parquet_file",
        "open_parquet",
        "ParquetTableWriter",
        has_rows=True,
        holds_about=True,
        module="pyarrow",
        extra="parquet",
    ),
    ".mf4": _form("mf4_file", "open_mf4", "Mf4Writer", module="asammdf", extra="mf4", **_BOTH),
    ".mcap": _form("mcap_file", "open_mcap", "McapWriter", module="mcap", extra="mcap", **_BOTH),
    ".log": _form("candump_file", "open_candump", "CandumpWriter", has_frames=True, is_text=True),
    ".asc": _form("asc_file", "open_asc", "AscWriter", has_frames=True, has_comments=True, holds_marks=True),
    ".blf": _form("blf_file", "open_blf", "BlfWriter", has_frames=True, holds_marks=True),
    ".trc": _form("trc_file", "open_trc", "TrcWriter", has_frames=True, has_comments=True, holds_marks=True),
}
RECORDED = tuple(suffix for suffix, each in FORMATS.items() if each.write)
TABLES = tuple(suffix for suffix in RECORDED if FORMATS[suffix].has_rows)
ROWS_ONLY = tuple(suffix for suffix in TABLES if not FORMATS[suffix].has_frames)
ROWS_AND_FRAMES = tuple(suffix for suffix in TABLES if FORMATS[suffix].has_frames)
WITH_ROWS = tuple(suffix for suffix, each in FORMATS.items() if each.has_rows)
BUS_LOGS = tuple(suffix for suffix in FORMATS if suffix not in WITH_ROWS)
WITH_FRAMES = (*BUS_LOGS, *ROWS_AND_FRAMES)
WITH_MARKS = tuple(suffix for suffix, each in FORMATS.items() if each.holds_marks)
PICTURES = (".png", ".svg", ".pdf", ".html")  # of recordings and vehicles


def either(suffixes: Sequence[str]) -> str:
    """Return suffixes joined as alternatives in words: .csv, .log or .mf4."""
    return f"{', '.join(suffixes[:-1])} or {suffixes[-1]}"
