"""What a recording is to hold, and rows that wait until there are enough of them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import printable
from liftgate_hil.signals import COLUMNS
from liftgate_plant.signals import Signal

_TOLD = ("seed", "clock", "rate_hz", "duration_s", "initial_deg")  # of a run, in a few lines
_MOST_BUSES = 254  # a byte, of which some formats count from 1


def no_remark() -> str:
    """That of a recording of which nothing is to be said."""
    return ""


@dataclass(frozen=True)
class Content:
    """What a recording is to hold, as far as its format can."""

    columns: Sequence[str]  # of the row's, the time first
    channel: str = "can0"  # what frames' bus is called
    title: str = "liftgate-hil"
    remark: Callable[[], str] = no_remark  # on the whole, asked for when it is closed
    about: str = ""  # the run that it is of, as JSON; empty: nobody knows
    row: Mapping[str, Signal] = field(
        default_factory=lambda: COLUMNS
    )  # what rows hold, in their order

    @cached_property
    def places(self) -> list[int]:
        """Where in a row the columns stand."""
        order = {name: place for place, name in enumerate(self.row)}
        return [order[name] for name in self.columns]

    def unit_of(self, name: str) -> str:
        """A column's, as our columns' names have it (degps); of one that isn't ours as it is."""
        signal = self.row[name]
        return signal.suffix.removeprefix("_") if signal is COLUMNS.get(name) else signal.unit

    @cached_property
    def time_place(self) -> int:
        """Where in a row the time stands."""
        return list(self.row).index("time_s")

    @property
    def bus_number(self) -> int:
        """What formats call the bus that have numbers only: that at the name's end (can1), else 0."""
        number = re.search(r"\d+$", self.channel)
        return int(number[0]) if number and int(number[0]) <= _MOST_BUSES else 0


def lines_about(about: str) -> list[str]:
    """What a recording says of its run in a few lines, for comments: all but the files' text and the vehicle."""
    if not about:
        return []
    told = json.loads(about)
    lines = [f"liftgate-hil {told['versions']['liftgate-hil']}"]
    lines += [f"{name} = {told[name]}" for name in _TOLD]
    lines += [f"{name} = {value}" for name, value in told["parameters"].items()]
    lines += [f"ecu = {_ecu_in_words(told['ecu'])}"] if "ecu" in told else []
    if "recorded" in told:
        when, before, after = (told["recorded"][name] for name in ("when", "before_s", "after_s"))
        lines.append(
            f"recorded only from {before:g} s before to {after:g} s after {' or '.join(when)}"
        )
    lines += [f"{name} = {x['path']}, SHA-256 {x['sha256']}" for name, x in told["files"].items()]
    return [printable(line) for line in lines]


def _ecu_in_words(ecu: Mapping[str, Any]) -> str:
    known = [ecu[name] for name in ("version", "mutant", "class", "path") if name in ecu]
    digest = f", SHA-256 {ecu['sha256']}" if "sha256" in ecu else ""
    return " ".join([ecu["kind"], *known]) + digest


class Batch:
    """Blocks that are written together: formats by columns want many rows at a time."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._blocks: list[NDArray[Any]] = []
        self._count = 0

    @property
    def nbytes(self) -> int:
        """Of all that is kept."""
        return sum(block.nbytes for block in self._blocks)

    def add(self, block: NDArray[Any]) -> NDArray[Any] | None:
        """Keep a copy of this block; all that is kept, once it is enough."""
        self._blocks.append(block.copy())
        self._count += len(block)
        return self.take() if self._count >= self._size else None

    def take(self) -> NDArray[Any] | None:
        """All that is kept; None: nothing is."""
        blocks, self._blocks, self._count = self._blocks, [], 0
        return np.concatenate(blocks) if blocks else None
