"""A recording's columns: its own, or what a rig's database makes of its frames."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.database import KINDS, load_messages
from liftgate_hil.config.shipped import find_config
from liftgate_hil.conversion.decode import Decoder, seen_in
from liftgate_hil.errors import ConfigError
from liftgate_hil.issues import ConfigIssues
from liftgate_hil.measurement.recorded import Recorded, open_recorded
from liftgate_plant.signals import Signal

if TYPE_CHECKING:
    from cantools.database.can import Message

Floats = NDArray[np.float64]


class Table(Protocol):
    """Columns of a recording; iterating opens the file anew."""

    @property
    def path(self) -> Path:
        """The file."""

    @property
    def signals(self) -> Mapping[str, Signal]:
        """The columns, the time first."""

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """Rows (n, len(wanted)) of these columns; NaN: no value."""


@dataclass(frozen=True)
class DecodedTable:
    """See Table: a row for each time at which a frame of these messages came."""

    source: Recorded
    messages: tuple[Message, ...]

    @property
    def path(self) -> Path:
        """See Table."""
        return self.source.path

    @cached_property
    def signals(self) -> Mapping[str, Signal]:
        """See Table."""
        return Decoder(self.messages).signals

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """See Table."""
        order = list(self.signals)
        places = [order.index(name) for name in wanted]
        for rows in Decoder(self.messages, str(self.path)).rows(self.source.frames()):
            yield rows[:, places]


def decoded(source: Recorded, rig: str) -> DecodedTable:
    """The frames of a recording by a rig, or by a database. Raises ConfigError."""
    if source.channel is None:
        raise ConfigError(f"`rig` {rig}: allowed with a recording that holds frames; this has rows")
    messages = tuple(seen_in(source.frames(), messages_of(rig)))
    if not messages:
        raise ConfigError(f"`rig` {rig}: no frame of its messages is in {source.path}")
    return DecodedTable(source, messages)


def messages_of(rig: str) -> Mapping[str, Message]:
    """The messages of a rig's database, or of a database itself. Raises ConfigError."""
    path = Path(rig)
    if path.suffix.lower() in KINDS:
        issues = ConfigIssues(f"`rig` {rig}")
        messages = load_messages(issues, path)
        issues.raise_if_any()
        return messages
    from liftgate_hil.config.rig import load_rig

    return load_rig(find_config("rigs", rig)).messages


def open_table(path: Path, rig: str | None = None) -> Table:
    """The columns of a recording; with `rig` those of its frames. Raises ConfigError."""
    source = open_recorded(path)
    if rig is not None:
        return decoded(source, rig)
    if not source.signals:
        raise ConfigError(f"{path}: holds frames alone; allowed: with `rig`, which decodes them")
    return source


class Window(NamedTuple):
    """From when to when [s]; both ends are in it."""

    begin: float = -np.inf
    end: float = np.inf

    def check(self) -> None:
        """Raises ConfigError where nothing can be in it."""
        if not self.begin <= self.end:
            raise ConfigError(f"`from` {self.begin:g}: after `to` {self.end:g}; allowed: before it")

    def of(self, blocks: Iterator[Floats]) -> Iterator[Floats]:
        """The rows in it, the time in the first column."""
        for rows in blocks:
            inside = (rows[:, 0] >= self.begin) & (rows[:, 0] <= self.end)
            if inside.any():
                yield rows[inside]


def chosen(table: Table, columns: Sequence[str]) -> list[str]:
    """These columns of a table, once each. Raises ConfigError with those that it has not."""
    issues = []
    for name in columns:
        if name not in table.signals or name == "time_s":
            near = difflib.get_close_matches(name, table.signals, n=3) or list(table.signals)[1:9]
            issues.append(f"`columns` {name}: not in {table.path}; allowed: {', '.join(near)}, …")
    if issues:
        raise ConfigError(issues)
    return list(dict.fromkeys(columns))


def columns_in(table: Table, names: Sequence[str], window: Window) -> dict[str, Floats]:
    """Times, as `time_s`, and columns as arrays. Raises ConfigError where there is none in the window."""
    wanted = ["time_s", *names]
    blocks = list(window.of(table.rows(wanted)))
    if not blocks:
        raise ConfigError(
            f"{table.path}: no rows there; allowed: a recording with rows in that time"
        )
    rows = np.concatenate(blocks)
    return {name: np.ascontiguousarray(rows[:, k]) for k, name in enumerate(wanted)}
