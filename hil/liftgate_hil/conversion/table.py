"""Columns of a recording: those of its rows, and those decoded from its frames by a rig's database."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.messages import Messages
from liftgate_hil.config.database import database_file, is_database, load_messages
from liftgate_hil.config.shipped import find_config
from liftgate_hil.conversion.decode import Decoder, seen_in
from liftgate_hil.errors import ConfigError, ConfigIssues, allowed_names
from liftgate_hil.formats.open import open_recording
from liftgate_hil.formats.recording import AS_IT_IS, ReadOptions, Recording
from liftgate_hil.plan.recorded_setup import recorded_setup
from liftgate_hil.plan.setup import rig_from
from liftgate_hil.signals import OUTPUT_COLUMNS

if TYPE_CHECKING:
    from cantools.database.can import Message

    from liftgate_hil.codec.bus_config import SignalMapping

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DecodedRows(Recording):
    """Recording whose rows are decoded from frames: one for each time at which a frame came."""

    source: Recording
    messages: tuple[Message, ...]
    left_out: tuple[str, ...] = ()  # what of the database is faulty

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the file whose frames are decoded, and on the database."""
        return (*self.source.notes, *self.left_out)

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) of the wanted signals; NaN: no value yet."""
        order = list(self.signals)
        places = [order.index(name) for name in wanted]
        for rows in Decoder(self.messages, str(self.path)).rows(self.source.frames()):
            yield rows[:, places]


@dataclass(frozen=True, kw_only=True)
class RowsAndSignals(Recording):
    """Recording that joins its rows and the signals decoded from its frames, each value held until the next."""

    source: Recording
    decoded: DecodedRows

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the file and on the database."""
        return self.decoded.notes

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Yield rows (n, len(wanted)) per time of a row or, for decoded signals, of a frame; NaN: no value yet."""
        parts = []
        for each in (self.source, self.decoded):
            own = [name for name in wanted if name in each.signals and name != "time_s"]
            if own or each is self.source:
                rows = np.concatenate([np.empty((0, 1 + len(own))), *each.rows(["time_s", *own])])
                rows = rows[np.argsort(rows[:, 0], kind="stable")]
                parts.append((own, rows, np.rint(1e9 * rows[:, 0])))
        ticks, first = np.unique(np.concatenate([own_ticks for _, _, own_ticks in parts]), return_index=True)
        found = {"time_s": np.concatenate([rows[:, 0] for _, rows, _ in parts])[first]}
        for own, rows, own_ticks in parts:
            place = np.searchsorted(own_ticks, ticks, side="right") - 1
            held = np.where(place[:, np.newaxis] >= 0, rows[np.maximum(place, 0), 1:], np.nan)
            found |= {name: held[:, k] for k, name in enumerate(own)}
        yield np.column_stack([found[name] for name in wanted])


def decoded(source: Recording, rig: str) -> DecodedRows:
    """Return a recording's frames, decoded by a rig or a database, as rows. Raises ConfigError."""
    if source.channel is None:
        raise ConfigError(f"`rig` {rig}: allowed with a recording that holds frames; this one has rows")
    known = messages_of(rig)
    left_out = tuple(f"{rig}: {note}" for note in known.notes)
    messages = tuple(seen_in(source.frames(), known))
    if not messages:
        raise ConfigError([f"`rig` {rig}: no frame of its messages is in {source.path}", *left_out])
    signals = Decoder(messages).signals
    return DecodedRows(
        path=source.path,
        signals=signals,
        start_ns=source.start_ns,
        source=source,
        messages=messages,
        left_out=left_out,
    )


def messages_of(rig: str) -> Messages:
    """Return the messages of a rig's database, or of a database named itself. Raises ConfigError."""
    if is_database(rig):
        issues = ConfigIssues(f"`rig` {rig}")
        messages = load_messages(issues, database_file(rig))
        issues.raise_if_any()
        return messages
    from liftgate_hil.config.rig import load_rig

    return load_rig(find_config("rigs", rig)).messages


def files_of(rig: str) -> list[Path]:
    """Return the paths of a rig and its database, or of a database itself, as far as they can be found."""
    if is_database(rig):
        return [database_file(rig).path]
    from liftgate_hil.config.rig import load_rig

    with contextlib.suppress(ConfigError):  # which is raised where it is used
        found = load_rig(find_config("rigs", rig))
        return [Path(found.source), found.database]
    return []


def open_table(path: Path, rig: str | None = None, how: ReadOptions = AS_IT_IS) -> Recording:
    """Open the columns of a recording; with `rig`, those decoded from its frames. Raises ConfigError."""
    source = open_recording(path, how)
    if rig is not None:
        return decoded(source, rig)
    if not source.signals:
        raise ConfigError(f"{path}: holds only frames; allowed: with `rig`, which decodes them")
    return source


def open_whole(
    path: Path, rig: str | None = None, how: ReadOptions = AS_IT_IS, columns: Sequence[str] = ()
) -> Recording:
    """Open a recording's rows, joined with its frames' signals by `rig` or if in `columns`. Raises ConfigError.

    Frames are decoded by `rig`, else by that of the run where one of the `columns` is none of the rows.
    """
    source = open_recording(path, how)
    if not source.signals or source.channel is None:
        return open_table(path, rig, how)
    if rig is None and any(name not in source.signals for name in columns):
        recorded = recorded_setup([path]).rig
        rig = None if recorded is None else recorded.source
    if rig is None:
        return source
    found = decoded(source, rig)
    own = {name: signal for name, signal in found.signals.items() if name not in source.signals}
    return RowsAndSignals(
        path=path,
        signals={**source.signals, **own},
        names=source.names,
        start_ns=source.start_ns,
        about=source.about,
        marks=source.marks,
        source=source,
        decoded=found,
    )


class Window(NamedTuple):
    """Time window [s], both ends included."""

    begin: float = -np.inf
    end: float = np.inf

    def check(self) -> None:
        """Raise ConfigError if the window is empty."""
        if not self.begin <= self.end:
            raise ConfigError(f"`from_s` {self.begin:g}: after `to_s` {self.end:g}; allowed: before it")

    def of(self, blocks: Iterator[Floats]) -> Iterator[Floats]:
        """Yield the rows inside the window; the time is in the first column."""
        for rows in blocks:
            inside = (rows[:, 0] >= self.begin) & (rows[:, 0] <= self.end)
            if inside.any():
                yield rows[inside]


def window_of(begin: float | None, end: float | None) -> Window:
    """Return the window between two times [s]; None: no limit. Raises ConfigError if it is empty."""
    whole = Window()
    window = Window(whole.begin if begin is None else begin, whole.end if end is None else end)
    window.check()
    return window


def chosen(table: Recording, columns: Sequence[str], argument: str = "columns") -> list[str]:
    """Return the names of columns that an argument lists, once each. Raises ConfigError for missing ones."""
    issues = []
    for name in columns:
        if name not in table.signals or name == "time_s":
            known = [each for each in table.signals if each != "time_s"]
            issues.append(f"`{argument}` {name}: not in {table.path}; allowed: {allowed_names(name, known)}")
    if issues:
        raise ConfigError(issues)
    return list(dict.fromkeys(columns))


def columns_in(table: Recording, names: Sequence[str], window: Window) -> dict[str, Floats]:
    """Return times, as `time_s`, and columns as arrays. Raises ConfigError if no row is in the window."""
    wanted = ["time_s", *names]
    blocks = list(window.of(table.rows(wanted)))
    if not blocks:
        raise ConfigError(f"{table.path}: no rows in the time window; allowed: a window that holds rows")
    rows = np.concatenate(blocks)
    return {name: np.ascontiguousarray(rows[:, k]) for k, name in enumerate(wanted)}


# The output that a rig must map for each column.
OUTPUT_OF = {column: output for output, column in OUTPUT_COLUMNS.items()}


def mappings_of(rig: str) -> dict[str, SignalMapping]:
    """Return a rig's signal mappings by the column of ours that each carries; none for a bare database."""
    try:
        outputs = rig_from(rig).outputs
    except ConfigError:
        return {}
    return {OUTPUT_COLUMNS[each.quantity]: each for each in outputs if each.quantity in OUTPUT_COLUMNS}


def ours_in(rig: str, names: Sequence[str]) -> dict[str, str]:
    """Return for our columns the decoded signals that carry them, as the rig maps them, if in `names`."""
    wired = {column: f"{wire.message}.{wire.signal}" for column, wire in mappings_of(rig).items()}
    return {column: name for column, name in wired.items() if name in names}
