"""MF4 files by asammdf: channels, each with times and a unit of its own, or the frames of a bus."""

from __future__ import annotations

import gc
import io
import logging
import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from liftgate_hil.codec.frames import EXTENDED, FD, Frames, empty_frames
from liftgate_hil.config.files import check_file
from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.measurement import Floats
from liftgate_hil.measurement.series import FRAME, Series


@dataclass(frozen=True)
class Mf4File:
    """See Columns."""

    path: Path
    names: Sequence[str]
    sample: str = "sample"
    notes: Sequence[str] = ()

    def read(self, wanted: Sequence[str], issues: list[str]) -> dict[str, Series]:
        """See Columns."""
        result = {}
        with opened_mf4(self.path) as measurement:
            for name in wanted:
                where = measurement.channels_db[name]
                if len(where) > 1:
                    issues.append(f"{self.path}: {name}: in {len(where)} groups; allowed: in one")
                    continue
                signal = measurement.get(name).validate()
                if np.asarray(signal.samples).dtype.kind not in "fiub":  # a conversion to text
                    signal = measurement.get(name, raw=True).validate()
                samples = np.asarray(signal.samples)
                if samples.dtype.kind not in "fiub" or samples.ndim != 1:
                    issues.append(f"{self.path}: {name}: no numbers; allowed: one number a sample")
                    continue
                times = np.asarray(signal.timestamps, dtype=np.float64)
                values = samples.astype(np.float64)
                if _is_sound(self.path, name, times, values, issues):
                    result[name] = Series(values, times, signal.unit or None)
        return result


def open_mf4(path: Path) -> Mf4File:
    """The file's channels. Raises ConfigError where it cannot be read."""
    with opened_mf4(path) as measurement:
        return Mf4File(path, list(measurement.channels_db))


def read_mf4_frames(path: Path) -> tuple[Floats, Frames]:
    """Times [s] and frames of a bus log, in the order of time."""
    parts: list[tuple[Floats, Frames]] = []
    with opened_mf4(path) as measurement:
        for group, index in measurement.channels_db.get(FRAME, ()):
            signal = measurement.get(group=group, index=index, raw=True)
            if len(signal.samples):
                times = np.asarray(signal.timestamps, dtype=np.float64)
                parts.append((times, _frames(signal.samples)))
    if not parts:
        return np.zeros(0), empty_frames(0)
    times = np.concatenate([part for part, _ in parts])
    order = np.argsort(times, kind="stable")
    return times[order], Frames(
        len(times),
        np.concatenate([frames.identifiers for _, frames in parts])[order],
        np.concatenate([frames.lengths for _, frames in parts])[order],
        np.concatenate([frames.data for _, frames in parts])[order],
    )


def _frames(samples: Any) -> Frames:
    fields = samples.dtype.names

    def field(name: str) -> Any:
        return samples[f"{FRAME}.{name}"] if f"{FRAME}.{name}" in fields else 0

    frames = empty_frames(len(samples))
    identifiers = field("ID").astype(np.int64)
    extended = (np.asarray(field("IDE")) != 0) | (identifiers & EXTENDED != 0)
    frames.identifiers[:] = (identifiers & 0x1FFFFFFF) + extended * EXTENDED
    frames.identifiers[:] += (np.asarray(field("EDL")) != 0) * FD
    frames.lengths[:] = field("DataLength")
    content = field("DataBytes")
    frames.data[:, : content.shape[1]] = content
    beyond = np.arange(frames.data.shape[1]) >= frames.lengths[:, None]
    frames.data[beyond] = 0
    return frames._replace(count=len(samples))


def _is_sound(path: Path, name: str, times: Floats, values: Floats, issues: list[str]) -> bool:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        more = f" ({len(bad)} such samples)" if len(bad) > 1 else ""
        said = f"{values[bad[0]]} in sample {bad[0] + 1}{more}"
        issues.append(f"{path}: {name}: {said}; allowed: a finite number")
        return False
    late = np.flatnonzero(~(np.diff(times) > 0.0))
    if len(late):
        issues.append(
            f"{path}: {name}: its time {times[late[0] + 1]:.9g} s in sample {late[0] + 2} does not "
            "come after the one before; allowed: finite and rising"
        )
        return False
    return True


@contextmanager
def opened_mf4(path: Path, in_blocks: bool = False) -> Iterator[Any]:
    """An MF4 file, as asammdf's MDF; `in_blocks`: to be read a part at a time, of which only that is loaded. What
    goes wrong with it is told as ConfigError.
    """
    try:
        from asammdf import MDF
    except ImportError as error:
        raise ConfigError(
            f"{path}: MF4 needs asammdf; allowed after: pip install 'liftgate-hil[mf4]'"
        ) from error
    check_file(path)
    _check_groups(path)
    said, logger = "", logging.getLogger("asammdf")
    level = logger.level
    logger.setLevel(
        logging.CRITICAL + 1
    )  # it tells on stderr what it then raises, or can do without
    try:
        # asammdf takes whole channels out of a file that it has opened itself.
        with path.open("rb") as stream, MDF(stream if in_blocks else path) as measurement:
            yield measurement
    except ConfigError:
        raise
    except Exception as error:  # asammdf raises what its parsers raise
        said = " ".join(str(error).split()) or type(error).__name__
        with _silent_end():
            error.__traceback__ = None  # what is half open goes here
    finally:
        logger.setLevel(level)
    if said:
        raise ConfigError(f"{path}: cannot be read: {said}")


# Of MDF 4: where the header's block stands, and how long a block's own header is; links follow it.
_HEADER_BLOCK, _BLOCK_HEAD = 64, 24


def _check_groups(path: Path) -> None:
    """Follow the chains of data groups and channel groups: asammdf goes round and round where one bites its tail.

    Raises ConfigError.
    """
    with path.open("rb") as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(_HEADER_BLOCK)
        if file.read(4) != b"##HD":  # MDF 3, or nothing of the kind
            return

        def links_at(block: int) -> tuple[int, int]:
            """The next block of the chain, and the first that is below this one; 0: none."""
            if not 0 < block <= size - _BLOCK_HEAD - 16:
                return 0, 0
            file.seek(block + _BLOCK_HEAD)
            following, below = struct.unpack("<QQ", file.read(16))
            return following, below

        seen: set[int] = set()

        def chain(block: int) -> Iterator[int]:
            """What hangs below each block from this one on."""
            while block:
                if block in seen:
                    raise ConfigError(
                        f"{path}: cannot be read: its blocks form a ring at byte {block}"
                    )
                seen.add(block)
                block, below = links_at(block)
                yield below

        for channel_groups in chain(links_at(_HEADER_BLOCK)[0]):
            for _ in chain(channel_groups):
                pass


@contextmanager
def _silent_end() -> Iterator[None]:
    """What asammdf could not open fails once more as it goes, which Python would tell."""
    told, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        yield
        gc.collect()
    finally:
        sys.unraisablehook = told
