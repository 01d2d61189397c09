"""What is done with text in arrays of bytes; machine code does it some words at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ROOM = 32  # bytes that machine code copies at once


def put_text(
    target: NDArray[np.uint8], at: int, source: NDArray[np.uint8], start: int, length: int
) -> None:
    """Copy so many bytes (m,) from `start` to (n,) from `at` on; where they come from may be before it in the same
    array. The target's ROOM bytes from there on may hold anything behind them.
    """
    target[at : at + length] = source[start : start + length]
