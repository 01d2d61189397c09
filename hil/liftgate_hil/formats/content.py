"""Content of a recording to be written, and batches of rows or frames that are written together."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import printable
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS, FAULT_IN_FORCE, InForce
from liftgate_plant.signals import Signal

# Keys of the provenance that comments list.
_LISTED = ("seed", "clock", "rate_hz", "duration_s", "initial_deg")
_MOST_BUSES = 254  # fits into a byte, also for formats that count from 1


@dataclass(frozen=True)
class Content:
    """Content of a recording to be written: columns, bus name, remark, provenance; formats store what they can."""

    columns: Sequence[str]  # columns of the row to record, the time first
    channel: str = "can0"  # name of the frames' bus
    title: str = "liftgate-hil"
    remark: Callable[[], str] = str  # by default "": remark on the recording, called on closing
    about: str = ""  # provenance of the run, as JSON; empty: unknown
    inputs: Sequence[Path] = ()  # files that it is made from, none of which is written
    # The columns of a row, in their order.
    row: Mapping[str, Signal] = field(default_factory=lambda: COLUMNS)
    faults: Mapping[str, int] = field(default_factory=dict)  # of columns of faults: bits in `faults_in_force`

    def with_faults(self, faults: Mapping[str, int]) -> Content:
        """Return the content with a 0/1 column per fault, appended to its columns and to its row."""
        if not faults:
            return self
        row = {**self.row, **dict.fromkeys(faults, FAULT_IN_FORCE)}
        return replace(self, columns=[*self.columns, *faults], row=row, faults=faults)

    def whole(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return rows (n, ROW_WIDTH) with a 0/1 column appended per fault, from the bits in `faults_in_force`."""
        if not self.faults:
            return rows
        bits = rows[:, COLUMN_PLACE[InForce._fields[0]]].astype(np.int64)
        masks = np.array(list(self.faults.values()))
        return np.concatenate([rows, (bits[:, None] & masks != 0).astype(float)], axis=1)

    @cached_property
    def places(self) -> list[int]:
        """Indices of the recorded columns in a row."""
        order = {name: place for place, name in enumerate(self.row)}
        return [order[name] for name in self.columns]

    def unit_of(self, name: str) -> str:
        """Return a column's unit: of a standard column as in its name (degps), of any other its signal's unit."""
        signal = self.row[name]
        return signal.suffix.removeprefix("_") if signal == COLUMNS.get(name) else signal.unit

    @cached_property
    def time_place(self) -> int:
        """Index of the time column in a row."""
        return list(self.row).index("time_s")

    @property
    def bus_number(self) -> int:
        """Bus number for formats without bus names: the digits at the name's end (can1: 1), else 0."""
        # The end of an IP address, as of a multicast group, numbers nothing.
        is_address = self.channel.count(".") == 3 or self.channel.count(":") > 1
        number = None if is_address else re.search(r"\d+$", self.channel)
        return int(number[0]) if number and int(number[0]) <= _MOST_BUSES else 0


def lines_about(about: str) -> list[str]:
    """Return a run's provenance as lines for comments, without the contents of its files and vehicle."""
    if not about:
        return []
    origin = json.loads(about)
    lines = [f"liftgate-hil {origin['versions']['liftgate-hil']}"]
    lines += [f"{name} = {origin[name]}" for name in _LISTED]
    lines += [f"{name} = {value}" for name, value in origin["parameters"].items()]
    lines += [f"ecu = {_ecu_in_words(origin['ecu'])}"] if "ecu" in origin else []
    if "recorded" in origin:
        when, before, after = (origin["recorded"][name] for name in ("when", "before_s", "after_s"))
        lines.append(f"recorded only from {before:g} s before to {after:g} s after {' or '.join(when)}")
    lines += [f"{name} = {x['path']}, SHA-256 {x['sha256']}" for name, x in origin["files"].items()]
    return [printable(line) for line in lines]


def _ecu_in_words(ecu: Mapping[str, object]) -> str:
    known = [str(ecu[name]) for name in ("version", "mutant", "class", "path") if name in ecu]
    digest = f", SHA-256 {ecu['sha256']}" if "sha256" in ecu else ""
    return " ".join([str(ecu["kind"]), *known]) + digest


class RowBatch:
    """Collector of blocks of rows or frames that are written together, as columnar formats need many rows."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._blocks: list[NDArray[Any]] = []
        self._count = 0

    @property
    def nbytes(self) -> int:
        """Size of all collected blocks [bytes]."""
        return sum(block.nbytes for block in self._blocks)

    def add(self, block: NDArray[Any]) -> NDArray[Any] | None:
        """Collect a copy of a block; return all blocks joined once they reach the size of a batch, else None."""
        self._blocks.append(block.copy())
        self._count += len(block)
        return self.take() if self._count >= self._size else None

    def take(self) -> NDArray[Any] | None:
        """Return all collected blocks joined, and forget them; None if there are none."""
        blocks, self._blocks, self._count = self._blocks, [], 0
        return np.concatenate(blocks) if blocks else None
