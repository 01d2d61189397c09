"""Recording in a process of its own, so that neither formatting nor a slow disk ever holds up a tick.

It reads the loop's rings. When the emulator ends, or is killed, it writes what is left and completes the files.
On its stdout it says what is worth knowing, a JSON object a line.

    python -m liftgate_hil.recording.process JOB      JOB: what `Job` holds, as JSON
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import pickle
import queue
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.errors import ConfigError, RecordingError
from liftgate_hil.loop.datagrams import CAPACITY
from liftgate_hil.loop.recorder import Recorder, Sieve, truncated_to_us
from liftgate_hil.loop.rings import Memory, RingReader
from liftgate_hil.recording.content import Content
from liftgate_hil.recording.guarded import GuardedRecorder, Say, failures_of, silent
from liftgate_hil.recording.open import open_recorder
from liftgate_hil.recording.rotation import Limit
from liftgate_hil.recording.trigger import Trigger, Triggered

_PAUSE = 0.05  # s between two looks at the rings
_LATE_NS = 100_000_000  # that a frame may come out of turn: received ones are logged a tick after they came


@dataclass
class Job:
    """What to record."""

    paths: list[str]
    columns: list[str]
    channel: str
    limit: int | None  # of a file, bytes
    keep: int | None
    rows: int  # sizes of the rings
    frames: int
    descriptor: int


class RecorderProcess:
    """The process, seen from the emulator's side; `say` is told at once what fails."""

    def __init__(
        self,
        paths: Sequence[Path],
        content: Content,
        limit: Limit | None,
        memory: Memory,
        say: Say = silent,
        trigger: Trigger | None = None,
    ) -> None:
        rows, frames = memory.sizes
        names = [str(path) for path in paths]
        job = Job(
            paths=names,
            columns=list(content.columns),
            channel=content.channel,
            limit=limit.size if limit else None,
            keep=limit.keep if limit else None,
            rows=rows,
            frames=frames,
            descriptor=memory.descriptor,
        )
        self._names = ", ".join(names)
        self._say = say
        self._answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._is_ready = self._is_closing = False
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, json.dumps(asdict(job))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=[memory.descriptor],
            start_new_session=True,  # a Ctrl-C is for the emulator
            text=True,
        )
        self._reader = threading.Thread(target=self._read, name="recorder's words", daemon=True)
        self._reader.start()
        self._tell(content.about)
        self._tell("" if trigger is None else base64.b64encode(pickle.dumps(trigger)).decode())
        self.lost_rows = 0
        self.windows: int | None = None  # recorded around so many triggers
        self.files: list[str] = []

    def _tell(self, text: str) -> None:
        """What may be longer than an argument."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # it has ended; that is told by and by
            self._process.stdin.write(json.dumps(text) + "\n")
            self._process.stdin.flush()

    def wait_until_ready(self) -> None:
        """Until its files are open. Raises ConfigError."""
        answer = self._answers.get() or {}
        if "ready" not in answer:
            self._process.wait()
            raise ConfigError(
                answer.get("issues")
                or f"`record` {self._names}: the recording process could not be started"
            )
        self._is_ready = True

    def close(self) -> None:
        """Have the files completed. Raises RecordingError."""
        assert self._process.stdin is not None
        self._is_closing = True
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        self._reader.join()
        self._process.wait()
        if not self._is_ready:
            return  # there is nothing to complete, and the reason has been told
        answer = self._answers.get()
        if answer is None:
            raise RecordingError(self._ended())
        self.lost_rows, self.files = int(answer["lost"]), answer["files"]
        self.windows = answer["windows"]
        if answer["failures"]:
            raise RecordingError("; ".join(answer["failures"]))

    def _ended(self) -> str:
        return f"`record` {self._names}: the recording process was ended from outside"

    def _read(self) -> None:
        """What it says, until it ends."""
        assert self._process.stdout is not None
        is_complete = False
        with self._process.stdout as stream:
            for line in stream:
                answer = json.loads(line) if line.endswith("\n") else {}
                if "failed" in answer:
                    self._say(answer["failed"])
                elif answer:
                    is_complete = "files" in answer
                    self._answers.put(answer)
        if self._is_ready and not self._is_closing and not is_complete:
            self._say(self._ended())
        self._answers.put(None)


class Writer:
    """Takes rows and frames from the rings to the recorders."""

    def __init__(
        self, memory: Memory, recorders: Sequence[Recorder], sieve: Sieve | None = None
    ) -> None:
        shared = memory.shared
        self._rows = RingReader(shared.rows, shared.control, "rows")
        self._frames = RingReader(shared.frames, shared.control, "frames", CAPACITY)
        self._control = shared.control
        self._recorders, self._sieve = recorders, sieve
        self._waiting: Any = no_logged()
        self._has_begun = False

    @property
    def lost(self) -> int:
        """Rows that came and went between two looks."""
        return self._rows.lost + self._frames.lost

    def take(self, is_last: bool = False) -> None:
        """Write what has come since the last time, down to the operating system; frames in the order of time."""
        rows = self._rows.take()
        come = self._frames.take()
        frames = self._in_order(come, is_last)
        if not self._has_begun and (len(rows) or len(frames)):
            self._has_begun = True
            epoch_ns = truncated_to_us(int(self._control["epoch_ns"][0]))
            for recorder in self._recorders:
                recorder.begin(epoch_ns)
        if self._sieve is not None:
            rows, frames = self._sieve.kept(rows, frames, come)
        for recorder in self._recorders:
            if len(rows):
                recorder.write_rows(rows)
            if len(frames):
                recorder.write_frames(frames)
            recorder.flush()

    def _in_order(self, come: Any, is_last: bool) -> Any:
        """The frames that none will come before; the others wait."""
        frames = np.concatenate([self._waiting, come])
        frames = frames[np.argsort(frames["time_ns"], kind="stable")]
        count = len(frames)
        if count and not is_last:
            count = int(np.searchsorted(frames["time_ns"], frames["time_ns"][-1] - _LATE_NS))
        self._waiting = frames[count:]
        return frames[:count]


def main() -> int:
    """Record until stdin ends."""
    for number in (signal.SIGINT, signal.SIGTERM):  # a service's stop, too, is for the emulator
        signal.signal(number, signal.SIG_IGN)
    job = Job(**json.loads(sys.argv[1]))
    memory = Memory(job.rows, job.frames, job.descriptor)
    content = Content(job.columns, job.channel, about=_heard())
    told = _heard()  # by the process that has started this one
    triggered = Triggered(pickle.loads(base64.b64decode(told))) if told else None
    limit = None if job.limit is None else Limit(job.limit, job.keep)
    recorders: list[GuardedRecorder] = []
    try:
        for path in job.paths:
            recorders.append(
                open_recorder(Path(path), content, limit, lambda text: _tell(failed=text))
            )
    except ConfigError as error:
        for recorder in recorders:  # what stays would be taken for the rest of a recording
            recorder.close()
        _tell(issues=error.issues)
        return 2
    _tell(ready=True)
    writer = Writer(memory, recorders, triggered)
    while not select.select([0], [], [], _PAUSE)[0]:
        writer.take()
    writer.take(is_last=True)
    for recorder in recorders:
        recorder.close()
    failures = failures_of(recorders)
    files = [file for recorder in recorders for file in recorder.files]
    windows = None if triggered is None else triggered.count
    _tell(failures=failures, files=files, lost=writer.lost, windows=windows)
    # A file on a full disk would be tried again, with a traceback.
    os._exit(1 if failures else 0)


def _heard() -> str:
    """A line of stdin."""
    return str(json.loads(sys.stdin.readline() or '""'))


def _tell(**words: Any) -> None:
    with contextlib.suppress(OSError):  # whoever asked may be gone
        print(json.dumps(words), flush=True)


if __name__ == "__main__":
    sys.exit(main())
