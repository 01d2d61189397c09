"""Lines of a bus log in text: each is a frame, known to be none, or left out and counted."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from liftgate_hil.formats.account import Account
from liftgate_hil.formats.bus_log import NO_TIME_NS, Fields, Part, Sorter
from liftgate_hil.formats.text_blocks import lines_in


class NotUnderstoodError(Exception):
    """A line that is neither a frame nor known to be none."""


class LogLines:
    """Base class of the readers of lines: a format says by `frame_in` which frame a line is."""

    def __init__(self, account: Account) -> None:
        self._account = account

    def frame_in(self, number: int, line: str) -> tuple[str, Fields] | None:
        """Return the bus and the fields of the frame in a line; None: it is known to be none.

        Raises NotUnderstoodError, ValueError, LookupError, OverflowError for a line that no form of the format
        covers.
        """
        raise NotImplementedError

    def parts(self, path: Path) -> Iterator[Part]:
        """Yield the frames in a log, bus by bus; the account is told of lines that are left out."""
        frames = Sorter()
        for number, line, is_whole in lines_in(path):
            try:
                found = self.frame_in(number, line)
                if found is not None and abs(found[1][0]) >= NO_TIME_NS:
                    raise NotUnderstoodError
            except (NotUnderstoodError, ValueError, LookupError, OverflowError):
                found = None
                if is_whole:
                    self._account.not_understood(number, line)
                else:
                    self._account.cut_off()
            if found is not None and frames.add(*found):
                yield from frames.take()
        yield from frames.take()
