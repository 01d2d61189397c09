"""Bus logs. Live it is always candump's text (`candump -L`), which a kill cannot spoil; any other format that
python-can writes is made from it at the end.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, REMOTE, Frames
from liftgate_hil.errors import TransportError

CONVERTED = (".asc", ".blf", ".mf4", ".trc")


def candump_lines(times: Sequence[float], channel: str, frames: Frames) -> str:
    """Frames in the log format of can-utils, a line each."""
    text = frames.data[: frames.count].tobytes().hex().upper()
    width = 2 * frames.data.shape[1]
    lines = []
    for row, (time, identifier, length) in enumerate(
        zip(times, frames.identifiers.tolist(), frames.lengths.tolist(), strict=False)
    ):
        if identifier & ERROR:
            # python-can writes and knows an error frame by its class bus error (linux/can/error.h, 0x80).
            name = f"{identifier & 0x3FFFFFFF | 0x80:08X}"
        elif identifier & EXTENDED:
            name = f"{identifier & 0x1FFFFFFF:08X}"
        else:
            name = f"{identifier & 0x7FF:03X}"
        if identifier & REMOTE:
            payload = f"R{length}" if length else "R"
        else:
            payload = text[row * width : row * width + 2 * length]
        mark = "##0" if identifier & FD and not identifier & REMOTE else "#"
        lines.append(f"({time:017.6f}) {channel} {name}{mark}{payload}\n")
    return "".join(lines)


class CandumpRecorder:
    """See Recorder; `epoch` is the wall clock [s] at the run's start."""

    def __init__(self, path: Path, channel: str, epoch: float) -> None:
        plain = channel.encode("ascii", "replace").decode("ascii")
        self._channel = "".join(plain.split()) or "can0"
        self._epoch = epoch
        self._stream = path.open("w", encoding="ascii", newline="")

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""

    def write_frames(self, frames: Frames, times: Sequence[float]) -> None:
        """See Recorder."""
        moved = [self._epoch + time for time in times]
        self._stream.write(candump_lines(moved, self._channel, frames))

    def flush(self) -> None:
        """See Recorder."""
        self._stream.flush()

    def close(self) -> None:
        """See Recorder."""
        self._stream.close()


class ConvertedRecorder:
    """A candump log beside the wanted file, turned into it at the end; the log goes once that worked."""

    def __init__(self, path: Path, channel: str, epoch: float) -> None:
        self._path = path
        self._log = path.with_name(path.name + ".log")
        self._live = CandumpRecorder(self._log, channel, epoch)

    def write_rows(self, rows: NDArray[np.float64]) -> None:
        """See Recorder."""

    def write_frames(self, frames: Frames, times: Sequence[float]) -> None:
        """See Recorder."""
        self._live.write_frames(frames, times)

    def flush(self) -> None:
        """See Recorder."""
        self._live.flush()

    def close(self) -> None:
        """See Recorder."""
        self._live.close()
        if self._log.is_file():  # a device may have no end
            convert(self._log, self._path)
            self._log.unlink()


def convert(source: Path, target: Path) -> None:
    """Turn one bus log into another; the suffixes say the formats. Raises TransportError, and keeps the log."""
    done = subprocess.run(
        [sys.executable, "-P", "-m", "can.logconvert", str(source), str(target)],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        why = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise TransportError(f"{target}: not written, the recording is in {source}: {why}")
