"""Worker process of a campaign: evaluates the variants that it receives, and answers with a result row each.

python -P -m liftgate_hil.campaigns.executors.worker SOCKET FILE      descriptors: the other end of the socket is a
`Slot`, the file holds the pickled base and the caller's module path

A user's ECU may crash, hang or keep statics: each of its variants is evaluated in a child of this process, which
is forked before any of the user's code is loaded.
"""

from __future__ import annotations

import contextlib
import gc
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from liftgate_hil.campaigns.evaluation import Evaluator, Row

READY, FAILED, ROW, BEAT = "ready", "failed", "row", "beat"  # first part of a message to the caller
BEAT_S = 1.0  # from one sign of life to the next


def main() -> int:
    """Evaluate the variants that the caller sends until it closes the connection; return the exit code."""
    from liftgate_hil.campaigns.executors.forked import become_reaper
    from liftgate_hil.config.can_libraries import unpickled

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the caller's
    signal.signal(signal.SIGTERM, _end)
    become_reaper()
    connection = Connection(int(sys.argv[1]))
    with os.fdopen(int(sys.argv[2]), "rb") as stream:
        content, path = pickle.load(stream)
    # Appended last, so that a module of an ECU does not hide one that this program needs.
    with contextlib.suppress(OSError):  # the folder may be gone
        path = [*path, str(Path.cwd())]
    sys.path += [each for each in path if each and each not in sys.path]
    messenger = _Messenger(connection)
    try:
        with messenger.beating():
            from liftgate_hil.campaigns.evaluation import Evaluator
            from liftgate_hil.ecu.find import is_foreign

            evaluator = Evaluator(unpickled(content))
            is_forked = is_foreign(evaluator.base.job.request.ecu)
            if is_forked:
                evaluator.load()
        messenger.send(READY)
        gc.collect()
        gc.freeze()  # the plan's objects live as long as this process
        _serve(connection, messenger, evaluator, is_forked)
    except (EOFError, OSError):  # nobody is left to answer to
        return 0
    except BaseException as error:
        from liftgate_hil.errors import LiftgateError, text_of

        is_ours = isinstance(error, LiftgateError)
        messenger.send(FAILED, text_of(error) if is_ours else f"{type(error).__name__}: {text_of(error)}")
        return 1
    finally:
        # It ends by itself now. Python removes its handlers then, and reports a signal that comes meanwhile.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    return 0


def _end(number: int, frame: FrameType | None) -> None:
    """Handle a signal: end this process, and all processes that users' ECUs have started."""
    from liftgate_hil.campaigns.executors.forked import end_children

    end_children()
    os._exit(128 + number)


def _serve(connection: Connection, messenger: _Messenger, evaluator: Evaluator, is_forked: bool) -> None:
    rows_of = partial(map, partial(_row_of, evaluator)) if is_forked else evaluator.rows
    while True:
        variants, size = connection.recv()
        for first in range(0, len(variants), size):
            with messenger.beating(evaluator):
                for row in rows_of(variants[first : first + size].tolist()):
                    messenger.send(ROW, tuple(row))


class _Messenger:
    """Sender of messages to the caller, with heartbeats during long operations."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._lock = connection, threading.Lock()
        self._evaluator: Evaluator | None = None
        self._is_busy = threading.Event()
        threading.Thread(target=self._beat, daemon=True).start()

    def send(self, *message: Any) -> None:
        """Send a message to the caller."""
        with self._lock:
            self._connection.send(message)

    @contextlib.contextmanager
    def beating(self, evaluator: Evaluator | None = None) -> Iterator[None]:
        """Context in which heartbeats are sent to the caller, with the progress of an evaluator."""
        self._evaluator = evaluator
        self._is_busy.set()
        try:
            yield
        finally:
            self._is_busy.clear()

    def _beat(self) -> None:
        while True:
            self._is_busy.wait()
            time.sleep(BEAT_S)
            if not self._is_busy.is_set():
                continue
            ticks = foreign = 0
            if (evaluator := self._evaluator) is not None:
                control = evaluator.memory.shared.control[0]
                ticks, foreign = int(control.tick), int(control.foreign)
            try:
                self.send(BEAT, ticks, foreign)
            except OSError:  # the caller has died: what this process does is of no use
                os._exit(0)


def _row_of(evaluator: Evaluator, values: Sequence[float]) -> Row:
    """Evaluate a variant in a child process, and return its result row: an error if two children die."""
    from liftgate_hil.campaigns.evaluation import error_row

    began, cause = time.perf_counter(), ""
    for _ in range(2):
        row, cause = _tried(evaluator, values)
        if row is not None:
            return row
    return error_row(evaluator.base, cause, time.perf_counter() - began)


def _tried(evaluator: Evaluator, values: Sequence[float]) -> tuple[Row | None, str]:
    """Evaluate a variant once in a child process; return (its row, ""), or (None, why there is none)."""
    from liftgate_hil.campaigns.executors.forked import answer_of

    evaluator.reset()
    control, step = evaluator.memory.shared.control[0], 1.0 / evaluator.base.job.request.rate
    payload, cause = answer_of(lambda: pickle.dumps(evaluator.row(values)), control)
    if payload is None:
        who = "the ECU" if int(control.foreign) % 2 else "the run"
        return None, f"{who} at {int(control.tick) * step:.3f} s: {cause}"
    try:
        row: Row = pickle.loads(payload)
    except Exception as error:  # foreign code can write there too
        return None, f"the ECU: the answer of its process cannot be read: {type(error).__name__}"
    return row, ""


if __name__ == "__main__":
    sys.exit(main())
