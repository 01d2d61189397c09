"""Opening of an MF4 file by asammdf, whose errors become ConfigError, and reading in blocks."""

from __future__ import annotations

import contextlib
import errno
import gc
import io
import logging
import shutil
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from liftgate_hil.config.files import check_file
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.account import Account
from liftgate_hil.formats.recording import DAMAGED


@contextmanager
def opened_mf4(path: Path, in_blocks: bool = False) -> Iterator[Any]:
    """Context that opens an MF4 file as asammdf's MDF, and raises errors as ConfigError.

    With `in_blocks` the file is read in blocks, of which only the current one is loaded.
    """
    try:
        from asammdf import MDF
        from asammdf.blocks import mdf_v4
    except ImportError as error:
        raise ConfigError(f"{path}: MF4 needs asammdf; allowed after: pip install 'liftgate-hil[mf4]'") from error
    check_file(path)
    is_finished = _is_finished(path)
    _check_groups(path)
    text, logger = "", logging.getLogger("asammdf")
    level = logger.level
    # asammdf logs to stderr what it then raises, or can do without, and prints tracebacks to stdout.
    logger.setLevel(logging.CRITICAL + 1)
    vars(mdf_v4)["print"] = lambda *_: None
    try:
        with path.open("rb") as file, ExitStack() as stack:
            stream = file if is_finished else stack.enter_context(_copy_of(file))
            # asammdf loads whole channels of a file that it has opened itself.
            source: Any = path if is_finished and not in_blocks else stream
            yield stack.enter_context(MDF(source))
    except ConfigError:
        raise
    except Exception as error:  # asammdf raises what its parsers raise
        text = why_not_read(error)
        with _silent_end():
            error.__traceback__ = None  # deletes objects that are half open
    finally:
        logger.setLevel(level)
    if text:
        raise ConfigError(f"{path}: cannot be read: {text}")


def why_not_read(error: Exception) -> str:
    """Return as text why a file or a channel cannot be read; asammdf's own text is about its code."""
    if isinstance(error, MemoryError):
        return "it needs more memory than there is"
    if isinstance(error, OSError) and error.strerror and error.errno != errno.EINVAL:  # a place before the file
        return error.strerror
    return DAMAGED


def _is_finished(path: Path) -> bool:
    """Whether a file is finalized, by its identification block. Raises ConfigError if it is no MDF file."""
    with path.open("rb") as stream:
        head = stream.read(_HEADER_BLOCK)
    if head[:7] not in (b"MDF    ", b"UnFinMF"):
        raise ConfigError(f"{path}: cannot be read: no MDF file; allowed: one that begins with MDF")
    if len(head) < _HEADER_BLOCK:
        raise ConfigError(f"{path}: cannot be read: {DAMAGED}")
    return head[:7] == b"MDF    "


def _copy_of(file: BinaryIO) -> BinaryIO:
    """Return a temporary copy of an unfinalized file, as asammdf finalizes in place the file that it opens."""
    copy = tempfile.TemporaryFile()  # noqa: SIM115  # closed by the caller
    shutil.copyfileobj(file, copy)
    copy.seek(0)
    return copy


# MDF 4: address of the header block, and length of a block's own header; links follow it.
_HEADER_BLOCK, _BLOCK_HEAD = 64, 24


def _check_groups(path: Path) -> None:
    """Raise ConfigError if a chain of data or channel groups is circular: asammdf would never end."""
    with path.open("rb") as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(_HEADER_BLOCK)
        if file.read(4) != b"##HD":  # MDF 3, or no MDF
            return

        def links_at(block: int) -> tuple[int, int]:
            """Return the positions of the next block in the chain and of the first one below `block`; 0: none."""
            if not 0 < block <= size - _BLOCK_HEAD - 16:
                return 0, 0
            file.seek(block + _BLOCK_HEAD)
            following, below = struct.unpack("<QQ", file.read(16))
            return following, below

        seen: set[int] = set()

        def chain(block: int) -> Iterator[int]:
            """Yield for each block of a chain, from `block` on, the position of the first block below it."""
            while block:
                if block in seen:
                    raise ConfigError(f"{path}: cannot be read: its blocks form a ring at byte {block}")
                seen.add(block)
                block, below = links_at(block)
                yield below

        for channel_groups in chain(links_at(_HEADER_BLOCK)[0]):
            for _ in chain(channel_groups):
                pass


@contextmanager
def _silent_end() -> Iterator[None]:
    """Context that suppresses unraisable errors on deletion of objects that asammdf failed to open."""
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        yield
        gc.collect()
    finally:
        sys.unraisablehook = hook


_BLOCK = 20_000  # rows or frames that are read at a time


def blocks_of(measured: Any, asked: Sequence[tuple[None, int, int]], account: Account) -> Iterator[list[Any]]:
    """Yield the signals `asked` of one group in blocks of rows; rows cut off at the end are left to `account`."""
    count = measured.groups[asked[0][1]].channel_group.cycles_nr

    def read(first: int, rows: int) -> list[Any]:
        found: list[Any] = measured.select(
            list(asked), record_offset=first, record_count=rows, raw=True, copy_master=False
        )
        return found

    for first in range(0, count, _BLOCK):
        rows = min(_BLOCK, count - first)
        try:
            yield read(first, rows)
        except ConfigError:
            raise
        except Exception:
            whole = _most(rows, partial(read, first)) if first + rows == count else 0
            if not whole:
                raise
            account.leave_out(
                "record", "the file was cut off within it", f"record {first + whole + 1}", rows - whole
            )
            yield read(first, whole)


def _most(count: int, read: Callable[[int], object]) -> int:
    """Return how many records, fewer than `count`, `read(number)` can read from the first on without an error."""
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        with contextlib.suppress(Exception):  # asammdf raises what its parsers raise
            read(middle)
            low = middle
            continue
        high = middle
    return low
