"""Recording in files of a limited size: `run.0001.csv`, `run.0002.csv`, … instead of `run.csv`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.formats.limit import Limit
from liftgate_hil.formats.target import remove_targets
from liftgate_hil.formats.writer import Writer

_SLICE = 512  # rows or frames after which the size is checked


class Part(Writer, Protocol):
    """Writer of one file of a recording."""

    @property
    def texts(self) -> Sequence[str]:
        """Paths of text files that hold the same until the file is complete."""

    def leave(self) -> None:
        """Close the file unfinished, after an error."""


class Parts:
    """Writer of one file or, with a limit, of several one after the other.

    Closing a file does not delay the next one.
    """

    def __init__(self, path: Path, open_part: Callable[[Path], Part], limit: Limit | None) -> None:
        self._path = path
        self._open_part = open_part
        self._limit = limit
        self._epoch_ns = 0
        self._number = 0
        self._most = 0  # bytes of the largest slice so far
        self._closing: list[Future[None]] = []
        self._pool = ThreadPoolExecutor(1)
        self._written: list[Path] = []
        if limit is not None:
            remove_targets(_parts_of(path))
        self._part = self._next()

    @property
    def files(self) -> list[str]:
        """Paths of the files that are kept."""
        return [str(path) for path in self._written]

    @property
    def texts(self) -> Sequence[str]:
        """Paths of text files that hold the same as the open file until it is complete."""
        return self._part.texts

    @property
    def written(self) -> int:
        """Bytes written so far to the open file."""
        return self._part.written

    def begin(self, epoch_ns: int) -> None:
        """Begin with the wall clock at the start of the run [ns since 1970]; 0: none applies."""
        self._epoch_ns = epoch_ns
        self._part.begin(epoch_ns)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write rows (n, ROW_WIDTH), in another file once the limit is reached."""
        self._write(Writer.write_rows.__name__, rows)

    def write_frames(self, frames: Any) -> None:
        """Write frames (n,) LOGGED, in another file once the limit is reached."""
        self._write(Writer.write_frames.__name__, frames)

    def write_mark(self, time_s: float, text: str) -> None:
        """Write a mark at a time [s] to the open file."""
        self._part.write_mark(time_s, text)

    def flush(self) -> None:
        """Flush the open file."""
        self._part.flush()

    def close(self, is_whole: bool = True) -> None:
        """Close the open file, unfinished if `is_whole` is false, and wait until all others are closed."""
        try:
            self._part.close() if is_whole else self._part.leave()
        finally:
            self._pool.shutdown()
        for each in self._closing:
            each.result()

    def _write(self, how: str, block: NDArray[Any]) -> None:
        if self._limit is None:
            getattr(self._part, how)(block)
            return
        for first in range(0, len(block), _SLICE):
            if self._part.written + self._most > self._limit.size:
                self._rotate(self._limit)
            before = self._part.written
            getattr(self._part, how)(block[first : first + _SLICE])
            self._most = max(self._most, self._part.written - before)

    def _rotate(self, limit: Limit) -> None:
        """Continue in another file."""
        self._closing.append(self._pool.submit(self._part.close))
        self._part = self._next()
        self._part.begin(self._epoch_ns)
        while limit.keep is not None and len(self._written) > limit.keep:
            self._closing.append(self._pool.submit(self._written.pop(0).unlink))
        for each in [each for each in self._closing if each.done()]:
            self._closing.remove(each)
            each.result()

    def _next(self) -> Part:
        path = self._path
        if self._limit is not None:
            self._number += 1
            path = path.with_name(f"{path.stem}.{self._number:04d}{path.suffix}")
        part = self._open_part(path)
        self._written.append(path)
        return part


def _parts_of(path: Path) -> list[Path]:
    """Return the files that an earlier run with a limit has left."""
    pattern = re.compile(rf"{re.escape(path.stem)}\.\d{{4,}}{re.escape(path.suffix)}")
    return [each for each in path.parent.iterdir() if pattern.fullmatch(each.name)]
