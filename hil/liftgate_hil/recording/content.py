"""What a recording is to hold, and rows that wait until there are enough of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST_BUSES = 254  # a byte, of which some formats count from 1


def no_remark() -> str:
    """That of a recording of which nothing is to be said."""
    return ""


@dataclass(frozen=True)
class Content:
    """What a recording is to hold, as far as its format can."""

    columns: Sequence[str]  # of signals.COLUMNS, the time first
    channel: str = "can0"  # what frames' bus is called
    title: str = "liftgate-hil"
    remark: Callable[[], str] = no_remark  # on the whole, asked for when it is closed

    @property
    def bus_number(self) -> int:
        """What formats call the bus that have numbers only: that at the name's end (can1), else 0."""
        number = re.search(r"\d+$", self.channel)
        return int(number[0]) if number and int(number[0]) <= _MOST_BUSES else 0


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
