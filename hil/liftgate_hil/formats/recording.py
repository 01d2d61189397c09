"""Base class `Recording` of the readers of all formats, with rows, frames and columns."""

from __future__ import annotations

import contextlib
import functools
import json
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import tzinfo
from pathlib import Path
from typing import Any, Self
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.account import Account
from liftgate_hil.signals import COLUMNS, FAULT_IN_FORCE, FAULT_PREFIX
from liftgate_plant.signals import Signal

Floats = NDArray[np.float64]

FRAME = "CAN_DataFrame"  # of ASAM MDF bus logging; among a file's names if it holds frames
_ALL = float("inf")


COMMAND = "command: "  # with which a mark begins that an operator's command has made


@dataclass(frozen=True)
class FileColumn:
    """Column read from a file, in the file's unit."""

    values: Floats  # NaN where a cell is empty
    times: Floats | None = None  # s, of a column with its own times; None: those of the file's rows
    unit: str | None = None  # None: the file does not state it
    start_ns: int = 0  # of a column of dates: the wall clock at its 0 [ns since 1970]


@dataclass(frozen=True)
class ReadOptions:
    """Settings for reading a file, on what the file itself does not state: bus and time zone."""

    channel: str | None = None  # the bus, where a file has frames of several; None: the only one
    zone: tzinfo | None = None  # of local times in headers of bus logs; None: this computer's


AS_IT_IS = ReadOptions()


def read_options(recording_channel: str | None = None, timezone: str | None = None) -> ReadOptions:
    """Return the settings for reading with a bus and a time zone, given by name. Raises ConfigError."""
    zone = None
    if timezone is not None:
        try:
            zone = ZoneInfo(timezone)
        except (ValueError, OSError, LookupError) as error:
            text = f"`timezone` {timezone}: unknown zone; allowed: a name such as UTC or Europe/Berlin"
            raise ConfigError(text) from error
    return ReadOptions(recording_channel, zone)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Reader of a file with rows, frames or both: a recording of this program, a foreign table or bus log.

    Its methods open the file anew, and raise ConfigError if it cannot be read.
    """

    path: Path
    # Columns of rows, the time first; none if the file holds frames only.
    signals: Mapping[str, Signal] = field(default_factory=dict)
    names: Sequence[str] = ()  # of all columns in the file, and FRAME if it holds frames
    units: Mapping[str, str] = field(default_factory=dict)  # of columns, if the file states them
    # Of columns of dates: the wall clock at their 0 [ns since 1970].
    starts: Mapping[str, int] = field(default_factory=dict)
    sample: str = "row"  # word for one sample: "sample" if each column has its own times
    channel: str | None = None  # name of the frames' bus; None: no frames
    start_ns: int = 0  # wall clock where the times begin [ns since 1970]; 0: none applies
    about: str = ""  # provenance of the run, as JSON; "": unknown
    marks: Sequence[tuple[float, str]] = ()  # of the operator: time [s] and text
    remarks: Sequence[str] = ()  # on what was noticed when the file was opened
    # What the last pass over the frames, and over the rows, has left out.
    account: Account = field(default_factory=Account, compare=False)
    rows_account: Account = field(default_factory=Account, compare=False)

    def changed(self, **fields: Any) -> Self:
        """Return a copy of the recording with other values of these fields, and empty accounts."""
        return replace(self, account=Account(), rows_account=Account(), **fields)

    @functools.cached_property
    def provenance(self) -> Mapping[str, Any]:
        """The provenance as a mapping; {}: there is none, or it is damaged."""
        with contextlib.suppress(ValueError, RecursionError):
            found = json.loads(self.about or "{}")
            return found if isinstance(found, dict) else {}
        return {}

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the file, complete once its rows or frames have been read."""
        return (*self.remarks, *self.account.notes(), *self.rows_account.notes())

    def as_recording(self) -> Recording:
        """Return the file as a recording of this program; here itself. Raises ConfigError if it is none."""
        return self

    def read_with(self, how: ReadOptions) -> Recording:
        """Return the recording with these settings applied. Raises ConfigError."""
        found = self if how.zone is None else self.in_zone(how.zone)
        return found if how.channel is None else found.on_bus(how.channel)

    def in_zone(self, zone: tzinfo) -> Recording:
        """Return the recording with its local times interpreted in a zone; this base class has none."""
        return self

    def on_bus(self, name: str) -> Recording:
        """Return the recording with this bus's frames only. Raises ConfigError if all frames are of others."""
        if self.channel not in (None, name):
            raise no_such_bus(self.path, name, [str(self.channel)])
        return self

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of the wanted columns, one block at a time; NaN: no value."""
        return iter(())

    def frames(self) -> Iterator[NDArray[np.void]]:
        """Yield frames (n,) LOGGED in file order, one block at a time; times count from `start_ns`."""
        return iter(())

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, FileColumn]:
        """Return columns by name, but those with infinities; {}: unreadable rows. Both are noted in `issues`."""
        if not wanted:
            return {}
        try:
            found = list(self.rows(wanted))
        except ConfigError as error:
            issues += error.issues
            return {}
        if not found:
            issues.append(f"{self.path}: no rows; allowed: one or more")
            return {}
        result = {}
        for name, values in zip(wanted, np.concatenate(found).T, strict=True):
            bad = np.flatnonzero(np.isinf(values))
            if len(bad):
                text = f"{values[bad[0]]} in row {bad[0] + 1}; allowed: a finite number"
                issues.append(f"{self.path}: {name}: {text}")
            else:
                result[name] = FileColumn(
                    np.ascontiguousarray(values),
                    unit=self.units.get(name) or None,
                    start_ns=self.starts.get(name, 0),
                )
        return result


def no_such_bus(path: Path, name: str, buses: Sequence[str]) -> ConfigError:
    """Return the ConfigError for a chosen bus that is not in a file."""
    return ConfigError(f"`recording_channel` {name}: not in {path}; allowed: {', '.join(buses)}")


MOST_COLUMNS = 20_000  # more than a sheet of Excel has (16,384)


def check_width(path: Path, count: int) -> None:
    """Raise ConfigError if a file has more columns than the supported maximum."""
    if count > MOST_COLUMNS:
        raise ConfigError(f"{path}: {count} columns; allowed: up to {MOST_COLUMNS}")


def check_time_first(path: Path, names: Sequence[str]) -> None:
    """Raise ConfigError unless `time_s` is a file's first column; `path` is for the message only."""
    if names[:1] != ["time_s"]:
        first = f", the first column is {names[0][:60]!r}" if names and names[0] else ""
        raise ConfigError(f"{path}: time_s: missing{first}; allowed: a recording whose first column is time_s")


def nanoseconds_of(text: str) -> int:
    """Return the run's start as stated in a file [ns since 1970]; 0 if the value is not a valid time."""
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 20 else 0


def column_signal(name: str, unit: str = "", is_whole: bool = False) -> Signal:
    """Return the signal of a column: ours with that name, or a new one with the unit only."""
    known = FAULT_IN_FORCE if name.startswith(FAULT_PREFIX) else COLUMNS.get(name)
    return known or Signal(unit, -_ALL, _ALL, "", is_whole=is_whole)


DAMAGED = "truncated or damaged"


@contextmanager
def foreign_reader(path: Path, kind: str, package: str) -> Iterator[None]:
    """Context that raises errors of an optional reader package as ConfigError.

    Files of this kind need a package, which the extra with the name of the kind installs.
    """
    with as_config_errors(path):
        try:
            yield
        except ImportError as error:
            raise ConfigError(
                f"{path}: {kind} needs {package}; allowed after: pip install 'liftgate-hil[{kind.lower()}]'"
            ) from error


@contextmanager
def as_config_errors(path: Path) -> Iterator[None]:
    """Context that raises errors of reading a file as ConfigError."""
    try:
        yield
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # readers raise errors of their own, or of their parsers
        raise ConfigError(f"{path}: cannot be read: {cause_text(error)}") from error


def cause_text(error: Exception) -> str:
    """Return the exception of another package's reader as one line; for damaged files a fixed text."""
    if isinstance(error, struct.error | EOFError | zlib.error):
        return DAMAGED
    return " ".join(str(error).split()) or type(error).__name__
