"""Operations on text in arrays of bytes; machine code copies several words at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ROOM = 32  # bytes that machine code copies at once


def put_text(target: NDArray[np.uint8], at: int, source: NDArray[np.uint8], start: int, length: int) -> None:
    """Copy `length` bytes of `source` (m,) from `start` on to `target` (n,) from `at` on.

    The source may lie before the target in the same array. Of the target's ROOM bytes from `at` on, those behind
    the copied ones may hold anything afterwards.
    """
    target[at : at + length] = source[start : start + length]
