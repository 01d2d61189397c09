"""Opens an MF4 file by asammdf, whose errors are raised as ConfigError."""

from __future__ import annotations

import gc
import io
import logging
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from liftgate_hil.config.files import check_file
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.reading import cause_text


@contextmanager
def opened_mf4(path: Path, in_blocks: bool = False) -> Iterator[Any]:
    """Open an MF4 file as asammdf's MDF; errors in the context are raised as ConfigError.

    With `in_blocks` the file shall be read in parts, of which only the current one is loaded.
    """
    try:
        from asammdf import MDF
    except ImportError as error:
        raise ConfigError(f"{path}: MF4 needs asammdf; allowed after: pip install 'liftgate-hil[mf4]'") from error
    check_file(path)
    _check_groups(path)
    text, logger = "", logging.getLogger("asammdf")
    level = logger.level
    # asammdf logs to stderr what it then raises, or can do without.
    logger.setLevel(logging.CRITICAL + 1)
    try:
        # asammdf loads whole channels of a file that it has opened itself.
        with path.open("rb") as stream, MDF(stream if in_blocks else path) as measurement:
            yield measurement
    except ConfigError:
        raise
    except Exception as error:  # asammdf raises what its parsers raise
        text = cause_text(error)
        with _silent_end():
            error.__traceback__ = None  # deletes objects that are half open
    finally:
        logger.setLevel(level)
    if text:
        raise ConfigError(f"{path}: cannot be read: {text}")


# MDF 4: address of the header block, and length of a block's own header; links follow it.
_HEADER_BLOCK, _BLOCK_HEAD = 64, 24


def _check_groups(path: Path) -> None:
    """Follow the chains of data groups and channel groups: asammdf never ends if one of them forms a ring.

    Raises ConfigError.
    """
    with path.open("rb") as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(_HEADER_BLOCK)
        if file.read(4) != b"##HD":  # MDF 3, or no MDF
            return

        def links_at(block: int) -> tuple[int, int]:
            """Return the next block of the chain, and the first one below this block; 0: none."""
            if not 0 < block <= size - _BLOCK_HEAD - 16:
                return 0, 0
            file.seek(block + _BLOCK_HEAD)
            following, below = struct.unpack("<QQ", file.read(16))
            return following, below

        seen: set[int] = set()

        def chain(block: int) -> Iterator[int]:
            """Yield the first block below each block of a chain, from `block` on."""
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
    """Suppress the unraisable errors of objects that asammdf could not open, when they are deleted."""
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        yield
        gc.collect()
    finally:
        sys.unraisablehook = hook
