"""Recording into one file or several of limited size: `run.0001.csv`, `run.0002.csv`, … for `run.csv`.

Beside formats that a kill corrupts (`.blf`, `.mf4`, `.parquet`, …) there are text files until these are complete:
`run.mf4.log` holds the frames, `run.mf4.csv` the rows.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import RecordingError
from liftgate_hil.formats.ours import is_ours, sign
from liftgate_hil.formats.suffixes import Limit
from liftgate_hil.formats.target import aside_of, check_free, is_one_of, set_aside, why
from liftgate_hil.formats.writer import Writer

_SLICE = 512  # rows or frames after which the size is checked


class Parts:
    """Writer of one file or, with a limit, of several consecutive ones, each opened by `open_part(path)`.

    Closing a file does not delay the next one. The files of an earlier recording are set aside; they count among
    those that a limit keeps, and are the first to be deleted. None of the `inputs` is.
    """

    def __init__(
        self,
        path: Path,
        open_part: Callable[[Path], SalvagedWriter],
        limit: Limit | None,
        inputs: Sequence[Path] = (),
    ) -> None:
        self._path = path
        self._open_part = open_part
        self._limit = limit
        self._epoch_ns = 0
        self._number = 0
        self._most = 0  # bytes of the largest slice so far
        self._closing: list[Future[None]] = []
        self._pool = ThreadPoolExecutor(1)
        self._written: list[Path] = []
        self._earlier = [] if limit is None else _earlier_set_aside(path, inputs)  # the oldest first
        self._part = self._next()
        if limit is not None:
            self._delete_beyond(limit)

    @property
    def files(self) -> list[str]:
        """Paths of the recording's files that are kept."""
        return [str(path) for path in self._written]

    @property
    def texts(self) -> Sequence[str]:
        """Paths of the text files that duplicate the open file until it is complete."""
        return self._part.texts

    @property
    def written(self) -> int:
        """Number of bytes written so far to the open file."""
        return self._part.written

    def begin(self, epoch_ns: int) -> None:
        """Begin the recording; wall clock at the run's start [ns since 1970], 0: none applies."""
        self._epoch_ns = epoch_ns
        self._part.begin(epoch_ns)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write rows (n, ROW_WIDTH), into the next file once the limit is reached."""
        self._write(Writer.write_rows.__name__, rows)

    def write_frames(self, frames: Any) -> None:
        """Write frames (n,) LOGGED, into the next file once the limit is reached."""
        self._write(Writer.write_frames.__name__, frames)

    def write_mark(self, time_s: float, text: str) -> None:
        """Write an operator's mark at a time [s] to the open file."""
        self._part.write_mark(time_s, text)

    def flush(self) -> None:
        """Flush the open file."""
        self._part.flush()

    def close(self, is_whole: bool = True) -> None:
        """Close the open file, unfinished if `is_whole` is false, and wait until all earlier ones are closed."""
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
        """Continue in the next file, close the old one in the background, and delete files beyond the limit."""
        self._closing.append(self._pool.submit(self._part.close))
        self._part = self._next()
        self._part.begin(self._epoch_ns)
        self._delete_beyond(limit)
        for each in [each for each in self._closing if each.done()]:
            self._closing.remove(each)
            each.result()

    def _delete_beyond(self, limit: Limit) -> None:
        """Delete in the background the oldest files beyond the number that the limit keeps."""
        while limit.keep is not None and len(self._earlier) + len(self._written) > limit.keep:
            remove = _remove_ours if self._earlier else Path.unlink
            oldest = (self._earlier or self._written).pop(0)
            self._closing.append(self._pool.submit(remove, oldest))

    def _next(self) -> SalvagedWriter:
        """Open the recording's next file, or its only one; return the writer."""
        path = self._path
        if self._limit is not None:
            self._number += 1
            path = path.with_name(f"{path.stem}.{self._number:04d}{path.suffix}")
        part = self._open_part(path)
        self._written.append(path)
        return part


def _remove_ours(path: Path) -> None:
    """Delete a file of an earlier recording, unless it has been replaced since. Raises OSError."""
    if is_ours(path):
        path.unlink()


def _earlier_set_aside(path: Path, inputs: Sequence[Path]) -> list[Path]:
    """Set aside an earlier recording's files but `inputs`; return all files aside. Raises ConfigError, OSError."""
    earlier, before = (
        [each for each in _parts_of(path, is_aside) if not is_one_of(each, inputs)] for is_aside in (False, True)
    )
    for each in _numbered(path).values():  # also one that is not complete, and thus not known as ours
        check_free(each)
    if not earlier:
        return before
    asides = {aside_of(each) for each in earlier}
    for each in before:
        if each not in asides:
            each.unlink()
    return [aside for each in earlier if (aside := set_aside(each, is_ours, inputs)) is not None]


def _parts_of(path: Path, is_aside: bool = False) -> list[Path]:
    """Return an earlier limited recording's files, oldest first; `is_aside`: those renamed to `….previous`.

    The files are ours, with consecutive numbers. A file alone whose number is not the first is no part, as
    a rotation keeps two at least: `drive.2024.csv` may be a recording of that year.
    """
    found = {number: each for number, each in _numbered(path, is_aside).items() if is_ours(each)}
    numbers = list(itertools.takewhile(found.__contains__, itertools.count(min(found, default=1))))
    return [found[k] for k in numbers] if numbers[:1] == [1] or len(numbers) > 1 else []


def _numbered(path: Path, is_aside: bool = False) -> dict[int, Path]:
    """Return a limited recording's files by number; `is_aside`: the earlier one's, renamed to `….previous`."""
    stem, suffix = map(re.escape, (path.stem, f".previous{path.suffix}" if is_aside else path.suffix))
    pattern = re.compile(rf"{stem}\.(\d{{4,}}){suffix}")
    matches = ((pattern.fullmatch(each.name), each) for each in path.parent.iterdir())
    return {int(match[1]): each for match, each in matches if match is not None and not each.is_symlink()}


class SalvagedWriter:
    """Writer of a file that also writes text files, which are deleted once the file is complete.

    `signed` is the file if it is then to be marked as this program's, see `ours`.
    """

    def __init__(
        self, recorder: Writer, texts: Sequence[tuple[Path, Writer]] = (), signed: Path | None = None
    ) -> None:
        self._recorder, self._signed = recorder, signed
        self._texts = texts
        self._all = [*(text for _, text in texts), recorder]  # the text files first

    @property
    def texts(self) -> list[str]:
        """Paths of the text files, which duplicate the file until it is complete."""
        return [str(path) for path, _ in self._texts]

    @property
    def written(self) -> int:
        """Number of bytes written so far to the file itself."""
        return self._recorder.written

    def begin(self, epoch_ns: int) -> None:
        """Begin all files; wall clock at the run's start [ns since 1970], 0: none applies."""
        for each in self._all:
            each.begin(epoch_ns)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """Write rows (n, ROW_WIDTH) to the file and the text files."""
        for each in self._all:
            each.write_rows(rows)

    def write_frames(self, frames: Any) -> None:
        """Write frames (n,) LOGGED to the file and the text files."""
        for each in self._all:
            each.write_frames(frames)

    def write_mark(self, time_s: float, text: str) -> None:
        """Write an operator's mark at a time [s] to all files."""
        for each in self._all:
            each.write_mark(time_s, text)

    def flush(self) -> None:
        """Flush the file and the text files."""
        for each in self._all:
            each.flush()

    def close(self) -> None:
        """Complete the file and delete the text files. Raises RecordingError, naming these, on failure."""
        try:
            self._recorder.close()
        except Exception as error:
            for _, text in self._texts:
                text.close()
            if not self._texts:
                raise
            reason = why(error) if isinstance(error, OSError) else str(error)
            raise RecordingError(f"{reason}; the data recorded so far is in {' and '.join(self.texts)}") from error
        if self._signed is not None:
            sign(self._signed)
        for path, text in self._texts:
            text.close()
            path.unlink()

    def leave(self) -> None:
        """Close all files after an error without deleting the text files."""
        for each in self._all:
            try:
                each.close()
            except Exception:  # the error that came before has been reported
                continue
