"""The recorder for a file name: the suffix says the format."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO

from liftgate_hil.errors import ConfigError
from liftgate_hil.loop.recorder import Recorder
from liftgate_hil.recording.content import Content
from liftgate_hil.recording.guarded import GuardedRecorder, Say, silent
from liftgate_hil.recording.rotation import Limit, Part, Parts
from liftgate_hil.recording.salvage import SalvagedRecorder
from liftgate_hil.recording.target import is_special, open_salvage, open_target, why

Make = Callable[[BinaryIO, Content], Recorder]


def _csv(stream: BinaryIO, content: Content) -> Recorder:
    from liftgate_hil.recording.csv_file import CsvRecorder

    return CsvRecorder(stream, content)


def _candump(stream: BinaryIO, content: Content) -> Recorder:
    from liftgate_hil.recording.candump_file import CandumpRecorder

    return CandumpRecorder(stream, content)


def _python_can(suffix: str, stream: BinaryIO, content: Content) -> Recorder:
    from liftgate_hil.recording.python_can_file import PythonCanRecorder

    return PythonCanRecorder(stream, content, suffix)


def _mf4(stream: BinaryIO, content: Content) -> Recorder:
    from liftgate_hil.recording.mf4_file import Mf4Recorder

    return Mf4Recorder(stream, content)


def _parquet(stream: BinaryIO, content: Content) -> Recorder:
    from liftgate_hil.recording.parquet_file import ParquetRecorder

    return ParquetRecorder(stream, content)


def _mcap(stream: BinaryIO, content: Content) -> Recorder:
    from liftgate_hil.recording.mcap_file import McapRecorder

    return McapRecorder(stream, content)


@dataclass(frozen=True)
class Format:
    """What a suffix means."""

    make: Make
    has_rows: bool = False
    has_frames: bool = False
    holds_about: bool = False  # what the recording says of its run, in full
    is_text: bool = False  # written as it comes: a kill cannot spoil it, and a pipe can take it
    module: str = ""  # that it needs
    extra: str = ""  # of this package, which brings it


FORMATS = {
    ".csv": Format(_csv, has_rows=True, is_text=True),
    ".log": Format(_candump, has_frames=True, is_text=True),
    ".asc": Format(partial(_python_can, ".asc"), has_frames=True),
    ".blf": Format(partial(_python_can, ".blf"), has_frames=True),
    ".trc": Format(partial(_python_can, ".trc"), has_frames=True),
    ".mf4": Format(
        _mf4, has_rows=True, has_frames=True, holds_about=True, module="asammdf", extra="mf4"
    ),
    ".mcap": Format(
        _mcap, has_rows=True, has_frames=True, holds_about=True, module="mcap", extra="mcap"
    ),
    ".parquet": Format(
        _parquet, has_rows=True, holds_about=True, module="pyarrow", extra="parquet"
    ),
}
TABLES = tuple(suffix for suffix, each in FORMATS.items() if each.has_rows)


def check_file(argument: str, name: str, allowed: tuple[str, ...] = tuple(FORMATS)) -> Path:
    """The path of a file to write that an argument names. Raises ConfigError."""
    path, what = Path(name), f"`{argument}` {name}"
    with contextlib.suppress(OSError, ValueError):  # told below
        if path.is_dir():
            raise ConfigError(f"{what}: is a folder; allowed: a file of {', '.join(allowed)}")
    if path.suffix not in allowed:
        raise ConfigError(
            f"{what}: format {path.suffix or 'none'!r}; allowed: {', '.join(allowed)}"
        )
    form = FORMATS[path.suffix]
    try:
        if not path.parent.is_dir():
            raise ConfigError(f"{what}: no folder {path.parent}; allowed: one that exists")
        if is_special(path) and not form.is_text:
            raise ConfigError(f"{what}: a pipe or a device; allowed: a file")
    except OSError as error:
        raise ConfigError(f"{what}: cannot be written: {why(error)}") from error
    except ValueError as error:  # a NUL in the name
        raise ConfigError(f"{what}: cannot be written: {error}") from error
    if form.module and importlib.util.find_spec(form.module) is None:
        raise ConfigError(
            f"{what}: {path.suffix} needs {form.module}; "
            f"allowed after: pip install 'liftgate-hil[{form.extra}]'"
        )
    return path


def open_recorder(
    path: Path,
    content: Content,
    limit: Limit | None = None,
    say: Say = silent,
    argument: str = "record",
    is_salvaged: bool = True,
) -> GuardedRecorder:
    """The recorder for a file, or for several of a limited size; `is_salvaged`: a kill costs next to nothing.

    Raises ConfigError where the file cannot be written.
    """
    what = f"`{argument}` {path}"
    try:
        parts = Parts(path, partial(_open_part, content, is_salvaged), limit)
    except ConfigError as error:
        raise ConfigError(f"`{argument}` {error}") from error
    except OSError as error:
        raise ConfigError(f"{what}: cannot be written: {why(error)}") from error
    return GuardedRecorder(what, parts, say)


def open_recorders(
    paths: Sequence[Path],
    content: Content,
    limit: Limit | None,
    say: Say,
    stack: contextlib.ExitStack,
) -> list[GuardedRecorder]:
    """The recorders of a run; the stack closes them. Raises ConfigError where a file cannot be written."""
    recorders = []
    for path in paths:
        recorder = open_recorder(path, content, limit, say)
        stack.callback(recorder.close)
        recorders.append(recorder)
    return recorders


def _open_part(content: Content, is_salvaged: bool, path: Path) -> Part:
    """One file. Raises ConfigError, OSError."""
    form = FORMATS[path.suffix]
    texts: list[tuple[Path, Recorder]] = []
    try:
        for suffix, has_it in ((".log", form.has_frames), (".csv", form.has_rows)):
            if has_it and is_salvaged and not form.is_text:
                salvage = path.with_name(path.name + suffix)
                texts.append((salvage, FORMATS[suffix].make(open_salvage(salvage), content)))
        return SalvagedRecorder(form.make(open_target(path), content), texts)
    except BaseException:
        for salvage, text in texts:
            text.close()
            salvage.unlink()
        raise
