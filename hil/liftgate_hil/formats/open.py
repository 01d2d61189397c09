"""Opening of files of any format, for reading or writing."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

from liftgate_hil.config.files import check_file as check_readable
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.guarded import GuardedWriter, Say, silent
from liftgate_hil.formats.ours import SIGNED
from liftgate_hil.formats.recording import AS_IT_IS, ReadOptions, Recording
from liftgate_hil.formats.rotation import Parts, SalvagedWriter
from liftgate_hil.formats.suffixes import BUS_LOGS, FORMATS, RECORDED, Limit
from liftgate_hil.formats.target import check_no_input, is_special, open_free, open_salvage, why
from liftgate_hil.formats.writer import Writer

_HEAD = 512  # bytes
_FROM_BUSMASTER = "exported there as ASC, or recorded with candump -L"
_FROM_SAVVYCAN = "saved by SavvyCAN in candump's form"
# How a file begins, or what stands in its first lines; what it is; what is allowed.
_FORMS = (
    (
        b"version https://git-lfs.github.com",
        "a Git LFS pointer instead of the file",
        "the file, after: git lfs pull",
    ),
    (b"***BUSMASTER", "a log of BUSMASTER", _FROM_BUSMASTER),
    (b"@ TEXT @", "a trace of CAR BUS Analyzer", "exported there as ASC or CSV"),
    (b"Time Stamp,ID,Extended", "a log of SavvyCAN", _FROM_SAVVYCAN),
    (b"ID,Data Bytes", "a log of SavvyCAN without times", _FROM_SAVVYCAN),
    (b"\x1f\x8b", "compressed by gzip", "unpacked"),
    (b"PK\x03\x04", "a ZIP archive", "unpacked"),
)
# And with which endings.
_WITHIN = (
    (b"Microchip", "a log of Microchip's CAN BUS Analyzer", "converted into candump's form or ASC", (".log",)),
    # A part of a log of BUSMASTER, without its first lines.
    (b"***<Time><Tx/Rx>", "a log of BUSMASTER", _FROM_BUSMASTER, (".log",)),
    # The record with the version, in the Car Reverse-Engineering Toolkit's format.
    (b" CXX ", "a CRTD log", _FROM_SAVVYCAN, (".txt", ".csv", ".log")),
)
_MDF, _MDF_VERSION = (b"MDF     ", b"UnFinMF "), slice(8, 12)
# What a binary format begins with, and its endings.
_BINARY = (
    (b"LOGG", "BLF", (".blf",)),
    *((begin, "MDF", (".mf4",)) for begin in _MDF),
    (b"\x89MCAP", "MCAP", (".mcap",)),
)


def check_form(path: Path) -> None:
    """Raise ConfigError if a file's beginning shows another format than its suffix.

    Also raises it for versions of MDF that are not read.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    for begin, called, allowed in _FORMS:
        if head.removeprefix(b"\xef\xbb\xbf").startswith(begin):
            raise ConfigError(f"{path}: is {called}; allowed: {allowed}")
    for part, called, allowed, suffixes in _WITHIN:
        if part in head and path.suffix.lower() in suffixes:
            raise ConfigError(f"{path}: is {called}; allowed: {allowed}")
    version = head[_MDF_VERSION].decode("latin-1").strip(" \0")
    if head.startswith(_MDF) and version[:1] in ("2", "3"):
        raise ConfigError(
            f"{path}: MDF {version}; allowed: MDF 4, to which asammdf converts it: "
            f"MDF({path.name!r}).convert('4.10').save('{path.stem}-4.mf4')"
        )
    for begin, called, suffixes in _BINARY:
        if head.startswith(begin) and path.suffix.lower() not in suffixes:
            raise ConfigError(f"{path}: is {called}; allowed: a name that ends in {suffixes[0]}")


_SALVAGE_SUFFIXES = (".log", ".csv")  # of text files with frames and rows beside an unfinished file


def open_recording(path: Path, how: ReadOptions = AS_IT_IS) -> Recording:
    """Open a recording for reading; its suffix selects the format. Raises ConfigError."""
    found = _opened(path, how)
    if not found.signals and found.channel is None:
        raise ConfigError(
            f"{path}: neither rows nor frames{_instead(found)}; allowed: a recording with rows or frames"
        )
    return found


def _instead(found: Recording) -> str:
    """Return as text what a file without rows and frames holds, as far as its reader can tell; "": unknown."""
    if found.notes:
        return f", but {'; '.join(found.notes)}"
    is_log = found.path.suffix.lower() in BUS_LOGS  # its reader accounts for each line and object
    return ", at most comments, statistics, markers and the like" if is_log else ""


def holds_nothing(path: Path) -> bool:
    """Whether a recording has neither rows nor frames, e.g. if its trigger never came. Raises ConfigError."""
    if path.suffix.lower() == ".log" and path.is_file() and path.stat().st_size == 0:
        return True  # candump's text has no header
    found = _opened(path)
    return next(found.rows(["time_s"]), None) is None if found.signals else found.channel is None


def _opened(path: Path, how: ReadOptions = AS_IT_IS) -> Recording:
    """Open a recording, even one without rows and frames. Raises ConfigError, also for a file of no bytes."""
    if path.suffix.lower() in RECORDED:
        check_readable(path)
        if path.stat().st_size == 0:
            texts = [path.with_name(path.name + suffix) for suffix in _SALVAGE_SUFFIXES]
            left = [each.name for each in texts if each.is_file() and each.stat().st_size]
            beside = f", such as {' or '.join(left)} beside it" if left else ""
            raise ConfigError(f"{path}: empty; allowed: a recording{beside}")
    return open_file(path, RECORDED, how).as_recording()


def open_file(path: Path, allowed: Sequence[str] = tuple(FORMATS), how: ReadOptions = AS_IT_IS) -> Recording:
    """Open a file of any program for reading. Raises ConfigError, also for a format that is not `allowed`."""
    kind = path.suffix.lower()
    if kind in allowed:
        check_readable(path)
        if path.is_file():
            check_form(path)
        return FORMATS[kind].read(path).read_with(how)
    if path.is_dir():
        raise ConfigError(f"{path}: is a folder; allowed: a file of {', '.join(allowed)}")
    check_readable(path)
    if path.is_file():
        check_form(path)
    raise ConfigError(f"{path}: {_ending(path)}; allowed: {', '.join(allowed)}")


def _ending(path: Path) -> str:
    return f"format {path.suffix.lower()!r}" if path.suffix else "a name without a format's ending"


def check_file(argument: str, name: str, allowed: tuple[str, ...] = RECORDED) -> Path:
    """Return the path of an output file named by an argument, validated. Raises ConfigError."""
    path, what = Path(name), f"`{argument}` {name}"
    with contextlib.suppress(OSError, ValueError):  # reported below
        if path.is_dir():
            raise ConfigError(f"{what}: is a folder; allowed: a file of {', '.join(allowed)}")
    if path.suffix not in allowed:
        raise ConfigError(f"{what}: {_ending(path)}; allowed: {', '.join(allowed)}")
    form = FORMATS[path.suffix]
    try:
        if not path.parent.is_dir():
            raise ConfigError(f"{what}: no folder {path.parent}; allowed: an existing folder")
        if is_special(path) and not form.is_text:
            raise ConfigError(f"{what}: a pipe or a device; allowed: a file")
    except OSError as error:
        raise ConfigError(f"{what}: cannot be written: {why(error)}") from error
    except ValueError as error:  # a NUL in the name
        raise ConfigError(f"{what}: cannot be written: {error}") from error
    if form.module and importlib.util.find_spec(form.module) is None:
        raise ConfigError(
            f"{what}: {path.suffix} needs {form.module}; allowed after: pip install 'liftgate-hil[{form.extra}]'"
        )
    return path


def open_writer(
    path: Path,
    content: Content,
    limit: Limit | None = None,
    say: Say = silent,
    argument: str = "record",
    is_salvaged: bool = True,
    stream: BinaryIO | None = None,
    patience: float | None = None,
) -> GuardedWriter:
    """Open the writer of a recording: to a file, to several of limited size, or to `stream` instead of a file.

    An existing file is set aside (see `set_aside`), and `say` called. `is_salvaged`: text is written beside
    formats that a kill corrupts, so that a kill loses next to nothing. A pipe fails whose reader reads nothing for
    `patience` [s] (None: it is waited for). Raises ConfigError if the file cannot be written, or is one of those
    that the content is made from.
    """
    what = f"`{argument}` {path}"
    opened = _Target(content, is_salvaged and stream is None, say, stream, patience)
    try:
        parts = Parts(path, opened.part, limit, content.inputs)
    except ConfigError as error:
        raise ConfigError(f"`{argument}` {error}") from error
    except OSError as error:
        raise ConfigError(f"{what}: cannot be written: {why(error)}") from error
    return GuardedWriter(what, parts, say)


def open_writers(
    paths: Sequence[Path], content: Content, limit: Limit | None, say: Say, stack: contextlib.ExitStack
) -> list[GuardedWriter]:
    """Open the writers of a run's recordings; the stack closes them. Raises ConfigError if one fails to open."""
    recorders = []
    for path in paths:
        recorder = open_writer(path, content, limit, say)
        stack.callback(recorder.close)
        recorders.append(recorder)
    return recorders


class _Target(NamedTuple):
    """Opener of a recording's files, with their common content and options."""

    content: Content
    is_salvaged: bool
    say: Say
    stream: BinaryIO | None  # that gets the content instead of a file
    patience: float | None  # s, with the reader of a pipe

    def part(self, path: Path) -> SalvagedWriter:
        """Open the writer of one file of a recording. Raises ConfigError, OSError."""
        form, content = FORMATS[path.suffix], self.content
        texts: list[tuple[Path, Writer]] = []
        check_no_input(path, content.inputs)  # before text is written beside it
        try:
            for suffix, has_it in zip(_SALVAGE_SUFFIXES, (form.has_frames, form.has_rows), strict=True):
                if has_it and self.is_salvaged and not form.is_text:
                    salvage = path.with_name(path.name + suffix)
                    texts.append((salvage, _writer(suffix, open_salvage(salvage), content)))
            stream = self.stream or open_free(path, content.inputs, self.say, patience=self.patience)
            signed = Path(stream.name) if path.suffix in SIGNED and not is_special(path) else None
            return SalvagedWriter(_writer(path.suffix, stream, content), texts, signed)
        except BaseException:
            for salvage, text in texts:
                text.close()
                salvage.unlink()
            raise


def _writer(suffix: str, stream: BinaryIO, content: Content) -> Writer:
    write = FORMATS[suffix].write
    assert write is not None
    return write(stream, content)
