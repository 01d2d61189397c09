"""The run's side: hands its memory to those who attach to it, tells them how it goes, has their commands obeyed.

A thread of its own waits for them, so that they cost nothing while nobody asks; commands are obeyed by the thread
that looks after the loop.
"""

from __future__ import annotations

import array
import contextlib
import os
import queue
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from liftgate_hil.attachment import endpoint
from liftgate_hil.attachment.description import Description
from liftgate_hil.errors import ConfigError, printable
from liftgate_hil.injection.operator import Operator
from liftgate_hil.listener import Listener, Status
from liftgate_hil.loop.rings import Memory

_LINES = 200  # of what was told, that are kept
_LONGEST = 1000  # characters of one
_MOST_ISSUES = 20  # of a command
_PATIENCE_S = 0.02  # for who is to read an answer
_MOST = 8  # who may be attached at a time
_WAITING = 1000  # commands that may wait
_AT_ONCE = 20  # of these that are obeyed between two turns of an ECU in this process


class Host(Listener):
    """Listens for a run, and tells its own listener the same. `pid` is the process that was started for it."""

    def __init__(self, listener: Listener, pid: int) -> None:
        self._listener, self._pid = listener, pid
        self._lines: deque[tuple[int, float, str]] = deque(maxlen=_LINES)  # number, Unix time, text
        self._count = 0
        self._status: Status | None = None
        self._operator: Operator | None = None
        self._waiting: queue.SimpleQueue[tuple[_Visitor, Any]] = queue.SimpleQueue()
        self._guests: list[_Visitor] = []
        self._lock = threading.Lock()
        self._state = "waiting"
        self._thread: threading.Thread | None = None

    # What the run says.

    def say(self, text: str) -> None:
        """See Listener."""
        self._note(text)
        self._listener.say(text)

    def starts(self, what: str) -> None:
        """See Listener."""
        self._note(what)
        self._listener.starts(what)

    def happened(self, time_s: float, text: str) -> None:
        """See Listener."""
        self._note(f"ecu {time_s:.3f} s: {text}")
        self._listener.happened(time_s, text)

    def status(self, status: Status) -> None:
        """See Listener."""
        self._status, self._state = status, "running"
        self._listener.status(status)

    def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
        """See Listener."""
        self._listener.compiles(name, seconds, expected)

    def compiled(self, name: str, seconds: float) -> None:
        """See Listener."""
        self._listener.compiled(name, seconds)

    def _note(self, text: str) -> None:
        with self._lock:
            self._count += 1
            self._lines.append((self._count, time.time(), text[:_LONGEST]))

    # Who attaches.

    def open(self, description: Description, memory: Memory, operator: Operator) -> None:
        """Let others attach from now on. Where that cannot be it is told, and the run goes on without."""
        self._operator = operator
        told = description.as_json(memory)
        with contextlib.ExitStack() as stack:
            try:
                self._wire = stack.enter_context(endpoint.listening(self._pid))
            except (OSError, ConfigError) as error:
                self._listener.say(f"nobody can attach to this run: {error}")
                return
            about = os.memfd_create("liftgate-hil-description")
            stack.callback(os.close, about)
            with os.fdopen(os.dup(about), "wb") as stream:
                stream.write(told)
            self._descriptors = [memory.descriptor, about]
            selector = stack.enter_context(selectors.DefaultSelector())
            ended, self._end = os.pipe()
            stack.callback(os.close, ended)
            stack.callback(os.close, self._end)
            selector.register(self._wire, selectors.EVENT_READ)
            selector.register(ended, selectors.EVENT_READ, self)
            self._thread = threading.Thread(
                target=self._serve, args=(selector,), name="attached", daemon=True
            )
            self._thread.start()
            self._opened = stack.pop_all()

    def is_attended(self) -> bool:
        """Whether anybody is attached."""
        return bool(self._guests)

    def close(self) -> None:
        """The run has ended: tell who is attached, and let nobody in any more."""
        self._state = "ended"
        if self._thread is None:
            return
        os.write(self._end, b"x")
        self._thread.join()
        self._thread = None
        for each in self._guests:
            each.close()
        self._opened.close()

    def _serve(self, selector: selectors.BaseSelector) -> None:
        while True:
            for key, _ in selector.select():
                if key.data is self:
                    return
                if isinstance(key.data, _Visitor):
                    if not self._hear(key.data):
                        selector.unregister(key.fileobj)
                        self._guests.remove(key.data)
                        key.data.close()
                else:
                    self._let_in(selector)

    def _let_in(self, selector: selectors.BaseSelector) -> None:
        try:
            wire, _ = self._wire.accept()
        except OSError:
            return
        if len(self._guests) >= _MOST:
            wire.close()
            return
        handed = (socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", self._descriptors))
        try:
            wire.sendmsg([b"l"], [handed])
        except OSError:
            wire.close()
            return
        guest = _Visitor(wire)
        self._guests.append(guest)
        selector.register(wire, selectors.EVENT_READ, guest)

    def _hear(self, guest: _Visitor) -> bool:
        """What has come; whether there may be more."""
        try:
            questions = guest.read()
        except (OSError, ValueError):  # gone, or it says what none of ours says
            return False
        return all(isinstance(each, dict) and self._take(guest, each) for each in questions)

    def _take(self, guest: _Visitor, asked: dict[str, Any]) -> bool:
        """A question; whether there may be more."""
        number = asked.get("id")
        if not isinstance(number, int | None):
            return False
        if "command" not in asked:
            known = asked.get("lines")
            news = self._news(known if isinstance(known, int) else 0)
            return guest.answer({"id": number, **news})
        if self._waiting.qsize() < _WAITING:
            self._waiting.put((guest, asked))
            return True
        issue = f"{_WAITING} commands wait, as the run stands still; allowed: when it goes on"
        return guest.answer({"id": number, "issues": [issue]})

    def _news(self, known: int) -> dict[str, Any]:
        """How it goes, and what was told after the first so many lines."""
        with self._lock:
            lines = [each for each in self._lines if each[0] > known]
        status = None if self._status is None else self._status._asdict()
        operator = self._operator
        return {
            "state": self._state,
            "status": status,
            "lines": lines,
            "in_force": {} if operator is None else operator.in_force(),
        }

    # See Attendant.

    def look(self, frames: Any, now: float) -> None:
        """Obey what was commanded."""
        operator = self._operator
        if operator is None:
            return
        operator.look(now)
        for _ in range(_AT_ONCE):
            if self._waiting.empty():
                return
            guest, asked = self._waiting.get()
            number = asked.get("id")
            try:
                done = operator.obey(asked["command"], now)
            except ConfigError as error:
                issues = [each[:_LONGEST] for each in error.issues[:_MOST_ISSUES]]
                guest.answer({"id": number, "issues": issues})
                continue
            except RecursionError:
                guest.answer({"id": number, "issues": ["tables in tables; allowed: a command"]})
                continue
            except Exception as error:  # a mistake of ours ends no run of theirs
                issue = f"not obeyed, by a mistake of this program: {error!r}"[:_LONGEST]
                self.say(printable(f"{now:.3f} s: operator: {issue}"))
                guest.answer({"id": number, "issues": [issue]})
                continue
            self.say(printable(f"{now:.3f} s: operator: {done[:_LONGEST]}"))
            guest.answer({"id": number, "done": done, "time_s": now})


class _Visitor:
    """One who is attached. Answers come from two threads."""

    def __init__(self, wire: socket.socket) -> None:
        self._wire, self._arrivals = wire, endpoint.Arrivals()
        self._lock = threading.Lock()
        self._is_open = True
        wire.settimeout(_PATIENCE_S)

    def read(self) -> list[Any]:
        """The questions that have come. Raises OSError where it has left, ValueError for what is none."""
        come = self._wire.recv(65_536)
        if not come:
            raise OSError("it has left")
        return self._arrivals.take(come)

    def answer(self, answer: Mapping[str, Any]) -> bool:
        """Whether it takes it; who does not read is left to himself."""
        with self._lock:
            if not self._is_open:
                return False
            try:
                self._wire.sendall(endpoint.packed(answer))
            except (OSError, ConfigError):  # what is half sent cannot be gone on with
                self._is_open = False
                with contextlib.suppress(OSError):
                    self._wire.shutdown(socket.SHUT_RDWR)
            return self._is_open

    def close(self) -> None:
        """Nobody answers it any more."""
        with self._lock:
            self._is_open = False
            self._wire.close()
