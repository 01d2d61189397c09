"""The frames of a bus log that are ours, by python-can's readers, or from an MF4 or MCAP file that holds some."""

from __future__ import annotations

import io
import os
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from liftgate_hil.codec.frames import EXTENDED, FD, REMOTE, Frames, empty_frames
from liftgate_hil.config.files import check_file
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.measurement import Floats

_MOST_BYTES = 64  # of a frame
CUT = "its last line is cut off, and left out"


def read_frames(
    path: Path, messages: Collection[str], rig: Rig
) -> tuple[Floats, Frames, tuple[str, ...]]:
    """Times [s] and frames of these messages of the rig, and what was noticed. Raises ConfigError where the log
    cannot be read.
    """
    wanted = {
        rig.messages[name].frame_id | (EXTENDED if rig.messages[name].is_extended_frame else 0)
        for name in messages
    }
    kind = path.suffix.lower()
    if kind == ".mf4":
        from liftgate_hil.measurement.mf4_file import read_mf4_frames as read
    elif kind == ".mcap":
        from liftgate_hil.measurement.mcap_file import read_mcap_frames as read
    else:
        return _by_python_can(path, wanted)
    times, frames = read(path)
    ours = np.flatnonzero(np.isin(frames.identifiers & ~FD, list(wanted)))
    return (
        times[ours],
        Frames(len(ours), frames.identifiers[ours], frames.lengths[ours], frames.data[ours]),
        (),
    )


def is_cut(path: Path) -> bool:
    """Whether a text ends within a line, as a full disk or a kill leaves it. Raises OSError."""
    with path.open("rb") as stream:
        if stream.seek(0, os.SEEK_END) == 0:
            return False
        stream.seek(-1, os.SEEK_END)
        return stream.read() != b"\n"


def _opened(can: Any, path: Path, is_cut: bool) -> Any:
    """A reader of the log; of one that is cut of its whole lines."""
    if not is_cut:
        return can.LogReader(path)
    text = path.read_text(encoding="utf-8", errors="replace")
    return can.CanutilsLogReader(io.StringIO(text[: text.rfind("\n") + 1]))


def _by_python_can(path: Path, wanted: Collection[int]) -> tuple[Floats, Frames, tuple[str, ...]]:
    from liftgate_hil.python_can import can

    check_file(path)
    times: list[float] = []
    rows: list[tuple[int, bytes]] = []
    try:
        has_rest = path.suffix.lower() == ".log" and is_cut(path)
        with _opened(can, path, has_rest) as reader:
            for message in reader:
                identifier = message.arbitration_id
                identifier |= EXTENDED if message.is_extended_id else 0
                if message.is_error_frame or identifier not in wanted:
                    continue
                identifier |= REMOTE if message.is_remote_frame else 0
                identifier |= FD if message.is_fd else 0
                if len(message.data) > _MOST_BYTES:
                    raise ValueError(
                        f"{len(message.data)} bytes in a frame at {message.timestamp} s; "
                        f"allowed: up to {_MOST_BYTES}"
                    )
                times.append(message.timestamp)
                rows.append((identifier, bytes(message.data)))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # python-can's readers raise what their parsers raise
        said = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(f"{path}: cannot be read: {said}") from error
    frames = empty_frames(len(rows))
    for row, (identifier, payload) in enumerate(rows):
        frames.identifiers[row] = identifier
        frames.lengths[row] = len(payload)
        frames.data[row, : len(payload)] = np.frombuffer(payload, dtype=np.uint8)
    notes = (CUT,) if has_rest else ()
    return np.array(times, dtype=np.float64), frames._replace(count=len(rows)), notes
