"""Recording in a process of its own, so that neither formatting nor a slow disk ever holds up a tick.

It reads the loop's rings. When the emulator ends, or is killed, it writes what is left and completes the files.

    python -m liftgate_hil.recording.process JOB      JOB: what `Job` holds, as JSON
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from liftgate_hil.codec.frames import Frames
from liftgate_hil.errors import ConfigError, RecordingError
from liftgate_hil.loop.datagrams import CAPACITY
from liftgate_hil.loop.recorder import Recorder
from liftgate_hil.loop.rings import Memory, RingReader
from liftgate_hil.recording.open import GuardedRecorder, open_recorder

_PAUSE = 0.05  # s between two looks at the rings
_READY = "ready"


@dataclass
class Job:
    """What to record."""

    paths: list[str]
    drives: int
    channel: str
    rows: int  # sizes of the rings
    frames: int
    descriptor: int


class RecorderProcess:
    """The process, seen from the emulator's side. Raises ConfigError where a file cannot be written."""

    def __init__(self, paths: Sequence[Path], memory: Memory, drives: int, channel: str) -> None:
        rows, frames = memory.sizes
        names = [str(path) for path in paths]
        job = Job(names, drives, channel, rows, frames, memory.descriptor)
        self._names = ", ".join(names)
        self._is_ready = False
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, json.dumps(asdict(job))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=[memory.descriptor],
            start_new_session=True,  # a Ctrl-C is for the emulator
            text=True,
        )
        self.lost_rows = 0

    def wait_until_ready(self) -> None:
        """Until its files are open. Raises ConfigError."""
        assert self._process.stdout is not None
        answer = self._process.stdout.readline().strip()
        if answer != _READY:
            self._process.wait()
            raise ConfigError(
                answer or f"`record` {self._names}: the recording process could not be started"
            )
        self._is_ready = True

    def close(self) -> None:
        """Have the files completed. Raises RecordingError."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        with self._process.stdout as stream:
            lines = stream.read().splitlines()
        self._process.wait()
        if not self._is_ready:
            return  # there is nothing to complete, and the reason has been told
        if not lines or not lines[-1].startswith("{"):
            raise RecordingError(
                f"`record` {self._names}: the recording process was ended from outside"
            )
        answer = json.loads(lines[-1])
        self.lost_rows = int(answer["lost"])
        if answer["failures"]:
            raise RecordingError("; ".join(answer["failures"]))


class Writer:
    """Takes rows from the rings to the recorders."""

    def __init__(self, memory: Memory, recorders: Sequence[Recorder]) -> None:
        shared = memory.shared
        self._rows = RingReader(shared.rows, shared.control, "rows")
        self._frames = RingReader(shared.frames, shared.control, "frames", CAPACITY)
        self._control = shared.control
        self._recorders = recorders

    @property
    def lost(self) -> int:
        """Rows that came and went between two looks."""
        return self._rows.lost + self._frames.lost

    def take(self) -> None:
        """Write what has come since the last time, down to the operating system."""
        rows = self._rows.take()
        logged = self._frames.take()
        frames = Frames(len(logged), logged["identifier"], logged["length"], logged["payload"])
        times = ((logged["time_ns"] + self._control["epoch_ns"]) * 1e-9).tolist()
        for recorder in self._recorders:
            if len(rows):
                recorder.write_rows(rows)
            if frames.count:
                recorder.write_frames(frames, times)
            recorder.flush()


def main() -> int:
    """Record until stdin ends."""
    for number in (signal.SIGINT, signal.SIGTERM):  # a service's stop, too, is for the emulator
        signal.signal(number, signal.SIG_IGN)
    job = Job(**json.loads(sys.argv[1]))
    memory = Memory(job.rows, job.frames, job.descriptor)
    recorders: list[GuardedRecorder] = []
    try:
        for path in job.paths:
            recorders.append(open_recorder(Path(path), job.drives, job.channel, 0.0))
    except ConfigError as error:
        print(error, flush=True)
        return 2
    with contextlib.suppress(OSError):  # whoever asked may be gone
        print(_READY, flush=True)
    writer = Writer(memory, recorders)
    while not select.select([0], [], [], _PAUSE)[0]:
        writer.take()
    writer.take()
    for recorder in recorders:
        recorder.close()
    failures = [recorder.failure for recorder in recorders if recorder.failure]
    with contextlib.suppress(OSError):
        print(json.dumps({"failures": failures, "lost": writer.lost}), flush=True)
    # A file on a full disk would be tried again, with a traceback.
    os._exit(1 if failures else 0)


if __name__ == "__main__":
    sys.exit(main())
