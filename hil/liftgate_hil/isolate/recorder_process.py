"""Recording in a process of its own, so that neither formatting nor a slow disk ever holds up a tick.

It waits for its order, which a line on stdin announces: as it has started before, a recording begins with the
request. Then it reads the loop's rings, and from stdin, a JSON value per line, the operator's marks and where to
end. When stdin ends, because the emulator ends or is killed, it writes what is left and completes the files. Its
replies, a JSON object per line, go through a pipe of their own, as libraries print to stdout.

    python -m liftgate_hil.isolate.recorder_process ORDER ANSWERS MEMORY ROWS FRAMES FILE…

ORDER, ANSWERS and MEMORY are descriptors, ORDER is to hold a pickled `Order`; ROWS and FRAMES are the sizes of the
rings, the files are named for the list of processes only.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import pickle
import queue
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from liftgate_hil.errors import ConfigError, RecordingError
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.guarded import GuardedWriter, Say, failures_of, silent
from liftgate_hil.formats.open import open_writer
from liftgate_hil.formats.suffixes import Limit
from liftgate_hil.isolate.children import in_memory, keep_nice_value
from liftgate_hil.isolate.recorders import RingPlace, RingRecorder, place_in
from liftgate_hil.loop.rings import Memory
from liftgate_hil.plan.recording_trigger import Trigger, Triggered

_PAUSE = 0.05  # s between two reads of the rings
_READY_S = 60.0  # s that it may take to start and to open its files
_COMPLETE_S = 60.0  # s that completing the files may take, plus the run's length
_PATIENCE_S = 2.0  # s for the reader of a pipe: the rings hold 4 s, of which other files shall lose nothing
_EXIT_S = 5.0  # s that it may take to end after its last reply


class Order(NamedTuple):
    """Order to the recording process: files, content, size limit, trigger, and range of the rings to record."""

    paths: Sequence[Path]
    content: Content
    limit: Limit | None  # of a file's size
    trigger: Trigger | None
    begin: RingPlace | None  # None: with the run's first row
    end: RingPlace | None  # None: not known yet


class RecorderProcess:
    """The recording process, as the emulator controls it: waits for its `order`; process lists show `names`."""

    def __init__(self, memory: Memory, names: Sequence[str] = ()) -> None:
        self._names = ""
        self._say: Say = silent
        self._ended_too: Callable[[], None] = lambda: None
        self._answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._is_ready = self._is_closing = self._has_ended_early = False
        self._count, self._failed = 0, 0  # files, and those that could not be written any further
        self._began = time.monotonic()
        heard, reply_fd = os.pipe()
        self._given = in_memory(b"")
        try:
            descriptors = [self._given, reply_fd, memory.descriptor]
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__, *map(str, (*descriptors, *memory.sizes)), *names],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                pass_fds=descriptors,
                start_new_session=True,  # a Ctrl-C is for the emulator
            )
        except BaseException:
            os.close(heard)
            os.close(self._given)
            raise
        finally:
            os.close(reply_fd)
        keep_nice_value(self._process)
        assert self._process.stdin is not None
        os.set_blocking(self._process.stdin.fileno(), False)
        self._reader = threading.Thread(target=self._read, args=(heard,), name="recorder's answers", daemon=True)
        self._reader.start()
        self.lost_rows = 0
        self.windows: int | None = None  # how many were recorded; None: no trigger
        self.files: list[str] = []
        self.span: tuple[float, float] | None = None  # s, first and last row; None: there was none

    @property
    def is_there(self) -> bool:
        """Whether the recording process is still running."""
        return self._process.poll() is None

    def order(
        self,
        paths: Sequence[Path],
        content: Content,
        limit: Limit | None = None,
        say: Say = silent,
        trigger: Trigger | None = None,
        begin: RingPlace | None = None,
        end: RingPlace | None = None,
        ended: Callable[[], None] = lambda: None,
    ) -> None:
        """Send the order to record to `paths`; `say` is called at once with what fails.

        The recording begins at a place in the rings, which hold 4 s, else with the run's first row, and ends at
        one that is given here or to `end_at`. `ended` is called once the process has ended, for whatever reason.
        """
        self._names = ", ".join(map(str, paths))
        self._say, self._ended_too, self._count = say, ended, len(paths)
        self._began = time.monotonic()
        given, self._given = self._given, -1
        with os.fdopen(given, "wb") as stream:
            stream.write(pickle.dumps(Order(paths, content, limit, trigger, begin, end)))
        self._tell(True)
        if not self.is_there:  # before it had a file to report of
            ended()

    def end_at(self, place: RingPlace) -> None:
        """Set the place in the rings at which the recording ends, unless it is past; `close` completes files."""
        self._tell({"end": place})

    def wait_until_ready(self) -> None:
        """Wait until the recording's files are open. Raises ConfigError."""
        answer = self._answer(_READY_S) or {}
        if "ready" not in answer:
            self._kill()
            raise ConfigError(
                answer.get("issues") or f"`record` {self._names}: the recording process could not be started"
            )
        self._is_ready = True

    def mark(self, time_s: float, text: str) -> bool:
        """Send a mark of up to 200 characters at a time [s], without waiting; False: nobody writes it."""
        return self._failed < self._count and self._tell([time_s, text])

    def _tell(self, what: Any) -> bool:
        """Write a line to the process without waiting; False: the process does not accept it."""
        assert self._process.stdin is not None
        try:  # as a whole: a pipe takes 4096 bytes or nothing
            os.write(self._process.stdin.fileno(), json.dumps(what).encode() + b"\n")
        except (OSError, ValueError):
            return False
        return True

    def close(self) -> None:
        """Wait for the files, up to the run's duration and a minute; set `files`. Raises RecordingError."""
        assert self._process.stdin is not None
        self._is_closing = True
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        if self._given >= 0:  # it has had no order
            os.close(self._given)
            self._kill()
            return
        if not self._is_ready and "ready" not in (self._answer(_EXIT_S) or {}):
            self._kill()
            return  # there is nothing to complete, and the reason was reported
        patience = _COMPLETE_S + time.monotonic() - self._began
        answer = self._answer(patience)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(0.0 if answer is None else _EXIT_S)
        is_late = answer is None and self._process.poll() is None and self._reader.is_alive()
        self._kill()
        if is_late:
            text = f"the files were not complete after {patience:.0f} s"
            raise RecordingError(f"`record` {self._names}: {text}; the recording process was killed")
        if answer is None:
            raise RecordingError(self._ended())
        self.lost_rows, self.files = int(answer["lost"]), answer["files"]
        self.windows = answer["windows"]
        self.span = None if answer["span"] is None else tuple(answer["span"])
        if self._has_ended_early:
            raise RecordingError(self._ended_early())
        if answer["failures"]:
            raise RecordingError("; ".join(answer["failures"]))

    def _answer(self, patience: float) -> dict[str, Any] | None:
        """Return the process's next reply within `patience` [s]; None: none came, or the process has ended."""
        with contextlib.suppress(queue.Empty):
            return self._answers.get(timeout=patience)
        return None

    def _kill(self) -> None:
        """Kill the recording process, if it has not ended."""
        self._process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_EXIT_S)
        self._reader.join(_EXIT_S)

    def _ended_early(self) -> str:
        return f"`record` {self._names}: the recording was ended before its run"

    def _ended(self) -> str:
        return f"`record` {self._names}: the recording process was ended from outside"

    def _read(self, heard: int) -> None:
        """Read replies from `heard` until the process ends; pass messages to `say`, queue others."""
        is_complete = False
        try:
            with os.fdopen(heard, encoding="utf-8", errors="replace") as stream:
                for line in stream:
                    answer = _decoded(line)
                    if "said" in answer:
                        self._failed = answer["failed"]
                        self._say(str(answer["said"]))
                    elif answer:
                        is_complete = "files" in answer
                        self._answers.put(answer)
            if self._is_ready and not self._is_closing:
                self._say(self._ended_early() if is_complete else self._ended())
                self._has_ended_early = is_complete
        except OSError as error:  # foreign code in this process has closed the pipe
            self._say(f"`record` {self._names}: its answers are lost: {error.strerror}")
        finally:
            self._answers.put(None)
            self._ended_too()


def _decoded(line: str) -> dict[str, Any]:
    """Return the reply in a line; {} for an invalid line, such as one that was cut off."""
    try:
        answer = json.loads(line)
    except ValueError:
        return {}
    return answer if isinstance(answer, dict) else {}


def main() -> int:
    """Main program of the recording process: record until stdin ends, complete the files; return the exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):  # for the emulator, also a service's stop
        signal.signal(number, signal.SIG_IGN)
    given, reply_fd, memory_descriptor, *sizes = (int(each) for each in sys.argv[1:6])
    lines = _lines_until_the_end(wakes := [0])
    first = next(filter(None, lines), None)
    if first is None:
        return 0  # stdin has ended before an order came
    with os.fdopen(given, "rb") as stream:
        stream.seek(0)
        order: Order = pickle.load(stream)
    paths, content, limit = order.paths, order.content, order.limit
    replies = os.fdopen(reply_fd, "w", encoding="utf-8")

    def tell(**words: Any) -> None:
        with contextlib.suppress(OSError):  # the emulator may be gone
            print(json.dumps(words), file=replies, flush=True)

    memory = Memory(sizes[0], sizes[1], memory_descriptor)
    triggered = None if order.trigger is None else Triggered(order.trigger)
    writers: list[GuardedWriter] = []

    def say(text: str) -> None:
        tell(said=text, failed=len(failures_of(writers)))

    def open_all() -> None:
        for path in paths:
            writers.append(open_writer(path, content, limit, say, patience=_PATIENCE_S))

    recorder = RingRecorder(memory, content, triggered, order.begin)
    if order.end is not None:
        recorder.end_at(order.end)
    opened, end = os.pipe()  # it can be read once all files are open, or one of them could not be opened
    wakes.append(opened)
    opening = ThreadPoolExecutor(1).submit(open_all)
    opening.add_done_callback(lambda _: os.close(end))

    def hand_over() -> None:
        opening.result()  # raises ConfigError for a file that cannot be opened
        wakes.remove(opened)
        recorder.write_to(writers)
        tell(ready=True)

    try:
        seen = RingPlace(0, 0)
        for told in itertools.chain([first[1:]], lines):
            seen = _take(recorder, told, seen, memory)
            if opened in wakes and opening.done():
                hand_over()
        if opened in wakes:
            hand_over()
    except ConfigError as error:
        for writer in writers:  # files left behind would look like a recording
            writer.close()
        tell(issues=error.issues)
        return 2
    recorder.take(is_last=True)
    if order.begin is not None:
        recorder.begin()  # a file without rows has its header all the same
    for writer in writers:
        writer.close()
    tell(
        failures=failures_of(writers),
        files=[file for writer in writers for file in writer.files],
        lost=recorder.lost,
        windows=None if triggered is None else triggered.count,
        span=recorder.span,
    )
    # At a normal exit a file on a full disk would be written again, with a traceback.
    os._exit(1 if failures_of(writers) else 0)


def _take(recorder: RingRecorder, told: Sequence[Any], seen: RingPlace, memory: Memory) -> RingPlace:
    """Have the recorder execute commands `told` and read the rings up to place `seen`; return their place now."""
    for each in told:
        if isinstance(each, dict):
            recorder.end_at(RingPlace(*each["end"]))
    recorder.take(seen)
    seen = place_in(memory)
    for each in told:
        if isinstance(each, list):
            recorder.mark(*each)
    return seen


def _lines_until_the_end(wakes: Sequence[int]) -> Iterator[list[Any]]:
    """Yield lists of the JSON values from stdin, every 50 ms or when one of `wakes` is ready, until it ends."""
    rest = b""
    while True:
        come = b""
        if 0 in select.select(wakes, [], [], _PAUSE)[0]:
            come = os.read(0, 65_536)
            if not come:
                return
        *lines, rest = (rest + come).split(b"\n")
        yield [json.loads(line) for line in lines]


if __name__ == "__main__":
    sys.exit(main())
