"""Further recording, which an operator starts and stops beside the run's own ones, and an operator's marks."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigError, RecordingError
from liftgate_hil.formats.open import check_file
from liftgate_hil.formats.suffixes import RECORDED, WITH_MARKS
from liftgate_hil.isolate.recorder_process import RecorderProcess
from liftgate_hil.isolate.recorders import RingPlace, place_in
from liftgate_hil.plan.provenance import content_of
from liftgate_hil.signals import COLUMN_PLACE

if TYPE_CHECKING:
    from liftgate_hil.loop.listener import Listener
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.plan.plan import Plan

_LONGEST = 200  # bytes of a name, characters of a mark
_CLOSE_S = 180.0  # s for the last one to be complete at the end of the run; its process has deadlines of its own
STARTING, RECORDING, COMPLETING = "starting", "recording", "completing"

Mark = Callable[[float, str], bool]  # writes a mark at a time [s] of the run; False: it was not taken


class FurtherRecording:
    """Recording on an operator's request, one at a time, in the folder of the run's own recordings.

    `memory` is that of the run's loop, `channel` names its bus, which has an `interface`; the listener is
    told what becomes of the files; `own_mark` writes a mark to the run's own recordings, where these can hold one.
    """

    def __init__(
        self, plan: Plan, channel: str, interface: str, memory: Memory, listener: Listener, own_mark: Mark
    ) -> None:
        self._plan, self._channel, self._interface = plan, channel, interface
        self._memory, self._listener, self._own_mark = memory, listener, own_mark
        own = plan.request.recordings
        self._folder = own[0].parent if own else Path.cwd()
        self._own_holds_marks = any(each.suffix in WITH_MARKS for each in own)
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._spare: RecorderProcess | None = None  # has started and waits for its order
        self._spare_lock, self._is_closed = threading.Lock(), False
        self._process: RecorderProcess | None = None  # while it records
        self._early: list[tuple[float, str]] = []  # marks that it gets as soon as it has its order
        self._end: RingPlace | None = None  # in the rings, where it shall end
        self._lock = threading.Lock()  # of these
        self._path, self._phase = Path(), ""
        self.files: list[str] = []  # that are complete

    def prepare(self) -> None:
        """Start a recorder process that waits, so that a recording begins at once when it is requested."""
        with self._spare_lock, contextlib.suppress(OSError):  # then one is started with the recording
            if not self._is_closed and (self._spare is None or not self._spare.is_there):
                self._spare = RecorderProcess(self._memory, [str(self._folder)])

    def _prepared(self) -> RecorderProcess:
        """Return a recorder process for one recording: that which waits, else a new one. Raises OSError."""
        with self._spare_lock:
            spare, self._spare = self._spare, None
        if spare is not None and spare.is_there:
            return spare
        return RecorderProcess(self._memory, [str(self._folder)])

    @property
    def is_on(self) -> bool:
        """Whether a recording is open, or being opened or completed."""
        return self._thread is not None and self._thread.is_alive()

    def in_force(self) -> Mapping[str, object] | None:
        """Return the file's name and whether it is STARTING, RECORDING or COMPLETING; None: no recording."""
        return {"file": self._path.name, "phase": self._phase} if self.is_on else None

    def start(self, name: object) -> None:
        """Start a recording to a file with this name. Raises ConfigError, also while another recording is open."""
        if self.is_on:
            raise ConfigError(
                f"record {show(name)[:80]}: {self._path.name} is open; allowed: after it was stopped"
            )
        begin, path = place_in(self._memory), self._path_of(name)
        rows, begin_s = self._memory.shared.rows, 0.0  # s, time of the first row from there on
        if begin.rows:
            before = float(rows[(begin.rows - 1) % len(rows), COLUMN_PLACE["time_s"]])
            begin_s = before + 1.0 / self._plan.request.rate
        self._path, self._phase, self._stop, self._early = path, STARTING, threading.Event(), []
        self._end = None
        self._thread = threading.Thread(
            target=self._record, args=(self._stop, begin, begin_s), name="further recording", daemon=True
        )
        self._thread.start()

    def stop(self) -> str:
        """Stop the recording and return its file's name; the file is completed later. Raises ConfigError."""
        if not self.is_on or self._stop.is_set():
            raise ConfigError("record null: no recording is open that was started by a command")
        with self._lock:
            self._end = place_in(self._memory)
            if self._process is not None:
                self._process.end_at(self._end)
        self._stop.set()
        return self._path.name

    def mark(self, time_s: float, text: object) -> None:
        """Write a mark to all recordings that can hold it. Raises ConfigError if invalid, refused, or none can."""
        if not isinstance(text, str) or not 0 < len(text) <= _LONGEST or not text.isprintable():
            raise ConfigError(f"mark {show(text)[:80]}; allowed: 1 to {_LONGEST} printable characters")
        is_open = self.is_on and self._phase in (STARTING, RECORDING)
        holds = is_open and self._path.suffix in WITH_MARKS
        if not holds and not self._own_holds_marks:
            raise ConfigError(f"mark: no recording is open that holds marks; allowed: in {', '.join(WITH_MARKS)}")
        if not self.note(time_s, text):
            raise ConfigError("mark: a recording does not keep up, or has ended; allowed: when it takes marks")

    def note(self, time_s: float, text: str) -> bool:
        """Write a text, cut if too long, as a mark to the recordings that hold marks; False: one refused it."""
        text = text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
        taken = []
        with self._lock:
            if self._process is not None and self._path.suffix in WITH_MARKS:
                taken.append(self._process.mark(time_s, text))
            elif self.is_on and self._phase == STARTING:
                self._early.append((time_s, text))
        taken += [self._own_mark(time_s, text)] if self._own_holds_marks else []
        return all(taken)

    def close(self) -> None:
        """Complete the recording's file at the end of the run."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(_CLOSE_S)
        with self._spare_lock:
            self._is_closed = True
            if self._spare is not None:
                self._spare.close()
                self._spare = None

    def _path_of(self, name: object) -> Path:
        """Return the path of a new recording with this name in the folder. Raises ConfigError."""
        allowed = f"allowed: a file name, without a folder, with one of {', '.join(RECORDED)}"
        plain = isinstance(name, str) and 0 < len(name.encode()) <= _LONGEST and name.isprintable()
        if not isinstance(name, str) or not plain or name.startswith(".") or set(name) & {"/", "\\"}:
            raise ConfigError(f"record {show(name)[:80]}: {allowed}")
        path = self._folder / name
        if os.path.lexists(path):
            raise ConfigError(f"{name} already exists: choose another name")
        try:
            return check_file("record", str(path))
        except ConfigError as error:
            issues = [each.replace(f"`record` {path}", f"record {name}") for each in error.issues]
            raise ConfigError(issues) from error

    def _record(self, stop: threading.Event, begin: RingPlace, begin_s: float) -> None:
        """Record from a place in the rings, at a time [s], until `stop`; a failure ends this recording only."""
        path, process = self._path, None
        said: list[str] = []

        def failed(text: str) -> None:
            said.append(text)
            self._listener.alarm(text.replace(f"`record` {path}", f"record {path.name}"))
            stop.set()

        try:
            content = content_of(self._plan, self._channel, self._interface, is_recorded=True)
            process = self._prepared()
            with self._lock:
                process.order([path], content, say=failed, begin=begin, end=self._end, ended=stop.set)
                self._process = process
                if path.suffix in WITH_MARKS:
                    for time_s, text in self._early:
                        process.mark(time_s, text)
            process.wait_until_ready()
            if not stop.is_set():
                self._listener.say(f"record {path.name}: recording from {begin_s:.3f} s on")
            self._phase = RECORDING
            self.prepare()  # for the next one, which may follow at once
            stop.wait()
        except (ConfigError, OSError) as error:
            self._listener.alarm(f"record {path.name}: {error}")
        with self._lock:
            self._process, self._phase = None, COMPLETING
        if process is None:
            return
        try:
            process.close()
            self.files += process.files
            if process.files:
                lost = f"; {process.lost_rows} rows and frames lost" if process.lost_rows else ""
                span = process.span
                held = "without rows" if span is None else f"{span[0]:.3f} to {span[1]:.3f} s"
                self._listener.say(f"recorded: {', '.join(process.files)}, {held}{lost}")
        except RecordingError as error:
            if str(error) not in said:
                failed(str(error))
        self.prepare()
