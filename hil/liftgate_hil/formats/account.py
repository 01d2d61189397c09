"""Account of what a reader left out of a file: lines and objects that are neither a frame nor a row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import number_of, printable

CUT = "its last line is truncated and ignored"
_MOST_KINDS = 12  # that are named
_EXACT = 2**53  # integers up to this are exact as floats
_MOST_QUOTED = 60  # characters of a line


@dataclass
class _Kind:
    count: int
    first: str  # where the first one stands


class Account:
    """Account of what one pass over a file left out: lines or objects, counted by kind, with the first place.

    Lines and objects known not to be frames (comments, headers, statistics) are not counted.
    """

    def __init__(self) -> None:
        self._kinds: dict[tuple[str, str], _Kind] = {}
        self._rounded: dict[str, _Kind] = {}  # integers, by column
        self._is_cut = False

    def clear(self) -> None:
        """Clear the account of what was left out, for another pass over the file."""
        self._kinds.clear()
        self._rounded.clear()
        self._is_cut = False

    def cut_off(self) -> None:
        """Record in the account that the file's last line is incomplete, as after a full disk or a kill."""
        self._is_cut = True

    def leave_out(self, noun: str, why: str, first: str, count: int = 1) -> None:
        """Count lines or objects of one kind that are left out.

        `noun`: what one of them is; `why`: the reason; `first`: where the first of them stands, if it is the first
        of its kind.
        """
        if count:
            self._kinds.setdefault((noun, why), _Kind(0, first)).count += count

    def not_understood(self, line: int, text: str) -> None:
        """Count a line of a text log that matches no form of the format."""
        self.leave_out("line", "not understood", f"line {line}: {quoted(text)}")

    def floats_of(self, name: str, numbers: NDArray[Any] | Sequence[int]) -> NDArray[np.float64]:
        """Return a column's numbers (n,) as floats, and count the integers that a float cannot hold."""
        values = np.asarray(numbers, dtype=np.float64)
        is_whole = np.asarray(numbers).dtype.kind != "f"
        large = np.flatnonzero(np.abs(values) >= _EXACT).tolist() if is_whole else []
        rounded = [int(numbers[k]) for k in large if int(numbers[k]) != int(values[k])]
        if rounded:
            self._rounded.setdefault(name, _Kind(0, str(rounded[0]))).count += len(rounded)
        return values

    def notes(self) -> list[str]:
        """Return the account as notes, one for each kind; kinds beyond the first dozen share one."""
        notes = [CUT] if self._is_cut else []
        notes += [
            f"{number_of(each.count, noun)} left out ({why}), the first in {each.first}"
            for (noun, why), each in list(self._kinds.items())[:_MOST_KINDS]
        ]
        rest = [each.count for each in list(self._kinds.values())[_MOST_KINDS:]]
        notes += [f"{sum(rest)} more of {number_of(len(rest), 'other kind')} left out"] if rest else []
        rounded = list(self._rounded.items())
        notes += [
            f"{name}: {number_of(each.count, 'integer')} beyond 2^53 rounded to 53 bits, the first is {each.first}"
            for name, each in rounded[:_MOST_KINDS]
        ]
        more = len(rounded) - _MOST_KINDS
        return [*notes, f"integers of {number_of(more, 'more column')} rounded"] if more > 0 else notes


def quoted(text: str) -> str:
    """Return the beginning of a line of a foreign file in quotes, for notes."""
    text = printable(text.strip())
    return repr(text if len(text) <= _MOST_QUOTED else text[:_MOST_QUOTED] + "…")
