"""Server of a run: passes its memory to clients that attach, reports its progress, executes their commands.

A thread of its own waits for clients, so that they cost nothing while they ask nothing; commands are executed by
the thread that supervises the loop.
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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

from liftgate_hil.errors import ConfigError, printable
from liftgate_hil.judging.verdict import Verdict, margin_text, times_text
from liftgate_hil.loop.listener import Listener, Relay, RunStatus
from liftgate_hil.loop.rings import Memory
from liftgate_hil.operate.attachment import endpoint
from liftgate_hil.operate.attachment.description import Description
from liftgate_hil.operate.attachment.drawing import Acting
from liftgate_hil.operate.attachment.phase import PhaseTracker
from liftgate_hil.operate.operator import Operator

_LINES = 200  # lines of the log that are kept
_ALARMS = 20  # of these that are kept as alarms
_LONGEST = 1000  # characters of a line or an issue
_MOST_ISSUES = 20  # issues of a command
_PATIENCE_S = 0.02  # s for a client to read a reply
_MOST = 8  # clients at a time
_WAITING = 1000  # commands that may wait
_MOST_VERDICTS = 500  # expectations that clients are told about
_AT_ONCE = 20  # commands executed between two turns of an ECU in this process


class RunEnd(NamedTuple):
    """End of a run, as it is reported to its clients.

    `ending` is its verdict, or what stands in its place: STOPPED or GIVEN_UP. `exit_code` is that of its process;
    None: unknown. `pinch_peak_n` is the largest pinch force, `pinch_peak_s` when that was; None: nothing was
    pinched.
    """

    verdict: str
    ending: str
    reason: str
    expectations: Sequence[Verdict] = ()
    exit_code: int | None = None
    pinch_peak_n: float | None = None
    pinch_peak_s: float | None = None


class Server(Relay):
    """Server of a run for its clients: a listener that forwards all calls to another listener.

    `pid` is the process that was started for the run, `verdicts` returns those that are known so far.
    """

    def __init__(self, listener: Listener, pid: int, verdicts: Callable[[], Sequence[Verdict]] = tuple) -> None:
        super().__init__(listener)
        self._pid, self._verdicts = pid, verdicts
        self._phases = PhaseTracker()
        self._lines: deque[tuple[int, float, str]] = deque(maxlen=_LINES)  # number, Unix time, text
        self._alarms: deque[tuple[int, float, str]] = deque(maxlen=_ALARMS)  # of these lines
        self._count = 0
        self._status: RunStatus | None = None
        self._operator: Operator | None = None
        self.acting: Acting | None = None  # set once the run has its stimuli
        self._waiting: queue.SimpleQueue[tuple[_Connection, Any]] = queue.SimpleQueue()
        self._connections: list[_Connection] = []
        self._lock = threading.Lock()
        self._end_report: Mapping[str, object] | None = None
        self._thread: threading.Thread | None = None

    # Listener: what the run reports.

    def say(self, text: str) -> None:
        """Log a message, and forward it."""
        self._note(text)
        self.listener.say(text)

    def alarm(self, text: str) -> None:
        """Log an urgent message, store it for the clients, and forward it."""
        self._alarms.append(self._note(text))
        self.listener.alarm(text)

    def starts(self, what: str) -> None:
        """Log the start of a run, and forward it."""
        self._note(what)
        self.listener.starts(what)

    def happened(self, time_s: float, text: str) -> None:
        """Log an event of the ECU at a time [s], and forward it."""
        self._note(f"ecu {time_s:.3f} s: {text}")
        self.listener.happened(time_s, text)

    def status(self, status: RunStatus) -> None:
        """Store the latest status for the clients, set the phase to RUNNING or LATE, and forward the status."""
        self._status = status
        self._phases.runs(status.overruns)
        self.listener.status(status)

    def ready(self) -> None:
        """Set the phase that clients see to READY, and forward the report."""
        self._phases.is_ready()
        self.listener.ready()

    def _note(self, text: str) -> tuple[int, float, str]:
        """Add a line to the log, and return it."""
        with self._lock:
            self._count += 1
            self._lines.append(line := (self._count, time.time(), text[:_LONGEST]))
            return line

    # Clients.

    def open(self, description: Description, memory: Memory, operator: Operator) -> None:
        """Accept clients from now on; where that is not possible, report it, and the run goes on without them."""
        self._operator = operator
        operator.report = self._report
        content = description.as_json(memory)
        with contextlib.ExitStack() as stack:
            try:
                self._wire = stack.enter_context(endpoint.listening(self._pid))
            except (OSError, ConfigError) as error:
                self.listener.say(f"nobody can attach to this run: {error}")
                return
            about = os.memfd_create("liftgate-hil-description")
            stack.callback(os.close, about)
            with os.fdopen(os.dup(about), "wb") as stream:
                stream.write(content)
            handed = os.dup(memory.descriptor)  # the memory may be closed before the last client has come
            stack.callback(os.close, handed)
            self._descriptors = [handed, about]
            selector = stack.enter_context(selectors.DefaultSelector())
            ended, self._end = os.pipe()
            stack.callback(os.close, ended)
            stack.callback(os.close, self._end)
            selector.register(self._wire, selectors.EVENT_READ)
            selector.register(ended, selectors.EVENT_READ, self)
            self._thread = threading.Thread(target=self._serve, args=(selector,), name="attached", daemon=True)
            self._thread.start()
            self._opened = stack.pop_all()

    def is_attended(self) -> bool:
        """Whether any client is attached."""
        return bool(self._connections)

    def ends(self, end: RunEnd) -> None:
        """Set the phase that clients see to ENDED, and store the report of the run's end for them."""
        self._phases.has_ended()
        self._end_report = {
            **end._asdict(),
            "reason": end.reason[:_LONGEST],
            "expectations": [_in_full(each) for each in end.expectations[:_MOST_VERDICTS]],
        }

    def close(self) -> None:
        """Send the clients the report of the run's end, close all connections, and accept no more."""
        self._phases.has_ended()
        if self._thread is None:
            return
        os.write(self._end, b"x")
        self._thread.join()
        self._thread = None
        for each in self._connections:
            each.answer({"end": self._end_report})
            each.close()
        self._opened.close()

    def _serve(self, selector: selectors.BaseSelector) -> None:
        while True:
            for key, _ in selector.select():
                if key.data is self:
                    return
                if isinstance(key.data, _Connection):
                    if not self._hear(key.data):
                        selector.unregister(key.fileobj)
                        self._connections.remove(key.data)
                        key.data.close()
                else:
                    self._let_in(selector)

    def _let_in(self, selector: selectors.BaseSelector) -> None:
        try:
            wire, _ = self._wire.accept()
        except OSError:
            return
        if len(self._connections) >= _MOST:
            wire.close()
            return
        handed = (socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", self._descriptors))
        try:
            wire.sendmsg([b"l"], [handed])
        except OSError:
            wire.close()
            return
        connection = _Connection(wire)
        self._connections.append(connection)
        if self._operator is not None and self._operator.recording is not None:
            self._operator.recording.prepare()
        selector.register(wire, selectors.EVENT_READ, connection)

    def _hear(self, connection: _Connection) -> bool:
        """Handle the messages that a client has sent; False: close its connection."""
        try:
            questions = connection.read()
        except (OSError, ValueError):  # disconnected, or it does not keep to the protocol
            return False
        return all(isinstance(each, dict) and self._take(connection, each) for each in questions)

    def _take(self, connection: _Connection, asked: Mapping[str, object]) -> bool:
        """Handle one question of a client; False: close its connection."""
        number = asked.get("id")
        if not isinstance(number, int | None):
            return False
        if "command" not in asked:
            known = asked.get("lines")
            news = self._news(known if isinstance(known, int) else 0)
            return connection.answer({"id": number, **news})
        if self._waiting.qsize() < _WAITING:
            self._waiting.put((connection, asked))
            return True
        issue = f"{_WAITING} commands are waiting, as the run makes no progress; allowed: when it continues"
        return connection.answer({"id": number, "issues": [issue]})

    def _news(self, known: int) -> Mapping[str, object]:
        """Return the progress of the run, and its log after the first `known` lines."""
        with self._lock:
            lines = [each for each in self._lines if each[0] > known]
        status = None if self._status is None else self._status._asdict()
        operator = self._operator
        return {
            "phase": self._phases.phase,
            "status": status,
            "verdicts": [_in_short(each) for each in self._verdicts()[:_MOST_VERDICTS]],
            "lines": lines,
            "alarms": list(self._alarms),
            "in_force": {} if operator is None else operator.in_force(),
            "acting": {} if self.acting is None or self._status is None else self.acting.at(self._status.time_s),
        }

    # Observer: called by the thread that supervises the loop.

    def look(self, frames: Any, now: float) -> None:
        """Execute up to 20 of the commands that wait, and release the buttons that are due at a time [s]."""
        operator = self._operator
        if operator is None:
            return
        operator.look(now)
        self._phases.looked()
        for _ in range(_AT_ONCE):
            if self._waiting.empty():
                return
            connection, asked = self._waiting.get()
            number = asked.get("id")
            try:
                done = operator.obey(asked["command"], now)
            except ConfigError as error:
                issues = [each[:_LONGEST] for each in error.issues[:_MOST_ISSUES]]
                connection.answer({"id": number, "issues": issues})
                continue
            except RecursionError:
                connection.answer({"id": number, "issues": ["tables nested too deeply; allowed: a command"]})
                continue
            except Exception as error:  # a bug of this program must not end the run
                issue = f"not executed, because of an internal error: {error!r}"[:_LONGEST]
                self.say(printable(f"{now:.3f} s: operator: {issue}"))
                connection.answer({"id": number, "issues": [issue]})
                continue
            connection.answer({"id": number, "done": done, "time_s": now})

    def _report(self, now: float, done: str) -> None:
        """Log that a command was executed at a time [s]."""
        self.say(printable(f"{now:.3f} s: operator: {done[:_LONGEST]}"))


def _in_short(verdict: Verdict) -> Mapping[str, object]:
    """Return the fields of a verdict that clients get while the run goes on."""
    own = ("name", "verdict", "margin", "margin_unit", "time_s")
    return {**{name: getattr(verdict, name) for name in own}, **_in_words(verdict)}


def _in_full(verdict: Verdict) -> Mapping[str, object]:
    """Return the fields of a verdict that clients get at the end of the run."""
    return {**asdict(verdict), **_in_words(verdict)}


def _in_words(verdict: Verdict) -> dict[str, str]:
    """Return the texts of a verdict's margin and times."""
    return {"margin_text": margin_text(verdict), "times_text": times_text(verdict)}


class _Connection:
    """Connection to one client, on which two threads send replies."""

    def __init__(self, wire: socket.socket) -> None:
        self._wire, self._arrivals = wire, endpoint.Arrivals()
        self._lock = threading.Lock()
        self._is_open = True
        wire.settimeout(_PATIENCE_S)

    def read(self) -> list[Any]:
        """Return the questions received. Raises OSError where the client has left, ValueError for invalid ones."""
        come = self._wire.recv(65_536)
        if not come:
            raise OSError("it has left")
        return self._arrivals.take(come)

    def answer(self, answer: Mapping[str, object]) -> bool:
        """Send a reply; False: the connection is closed, as for a client that does not read."""
        with self._lock:
            if not self._is_open:
                return False
            try:
                self._wire.sendall(endpoint.packed(answer))
            except (OSError, ConfigError):  # a message sent in part cannot be continued
                self._is_open = False
                with contextlib.suppress(OSError):
                    self._wire.shutdown(socket.SHUT_RDWR)
            return self._is_open

    def close(self) -> None:
        """Close the connection; nothing is sent on it any more."""
        with self._lock:
            self._is_open = False
            self._wire.close()
