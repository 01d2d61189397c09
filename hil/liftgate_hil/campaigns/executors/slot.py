"""Slot of an executor: a worker process and the batch that it evaluates; a worker that dies is replaced.

The rest of a batch that a worker died of is evaluated variant by variant in a new process, so that the first
variant without a row is the one that a process dies of: one that kills its process twice becomes an error row.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import socket
import subprocess
import sys
from collections import Counter
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.campaigns.evaluation import GROUP, Row, error_row
from liftgate_hil.campaigns.executors.worker import FAILED, READY, ROW
from liftgate_hil.campaigns.figures import Figures
from liftgate_hil.errors import LiftgateError
from liftgate_hil.isolate.children import Stillness, end, end_in_words, foreign_output, in_memory

_MODULE = "liftgate_hil.campaigns.executors.worker"
_SILENT_S = 60.0  # s without a sign of life, which comes every second
_STILL_S = 300.0  # s without progress of a variant: compiling takes up to a minute
_END_S = 2.0
_STARTS = 5  # failed starts of a worker, one after the other, until the campaign is given up
_DEATHS = 2  # of the same variant's process, until it is given up


class Slot:
    """Worker process that evaluates the batches of a base one by one; it is replaced when it dies or hangs.

    `content` is the pickled base.
    """

    def __init__(self, base: Base, content: bytes) -> None:
        self.base, self._content = base, content
        self.rows: list[Row] = []
        self.retried = 0  # variants that were tried again, so far
        self._values: Floats = np.zeros((0, 0))
        self._deaths: Counter[int] = Counter()
        self._process: subprocess.Popen[bytes] | None = None
        self.connection: Connection | None = None  # to the worker, to be waited for
        self._is_ready = False
        self._failed_starts = 0  # one after the other
        self._is_single = False  # variant by variant, after a death, so that the next one shows what it is of
        self._progress: tuple[Any, ...] = ()
        self._heard, self._moved, self._messages = Stillness(), Stillness(), 0

    def begin(self, values: Floats) -> None:
        """Begin to evaluate a batch of variants (n, d) in the worker; `look` returns whether it is done."""
        self._values, self.rows = values, []
        self._deaths.clear()
        self._is_single = False
        if self._process is None:
            self._start()
        elif self._is_ready:
            self._send()

    def look(self) -> bool:
        """Process messages, replace a dead worker; return whether the batch is done. Raises LiftgateError."""
        if len(self.rows) == len(self._values):
            return True
        assert self.connection is not None
        cause = ""
        try:
            while self.connection.poll(0.0):
                self._take(self.connection.recv())
        except (EOFError, OSError, ValueError) as error:
            cause = self._ended() or f"its worker's answer cannot be read: {error}"
        if not cause:
            cause = self._hangs()
        if cause and len(self.rows) < len(self._values):
            self._replace(cause)
        return len(self.rows) == len(self._values)

    def close(self) -> None:
        """End the worker process."""
        process, self._process = self._process, None
        if self.connection is not None:
            self.connection.close()
            self.connection = None
        if process is not None:
            end(process, _END_S)  # asked first: it ends what users' ECUs have started
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
        self._is_ready = False

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        given = in_memory(pickle.dumps((self._content, sys.path)))  # a socket would make this process wait
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", _MODULE, str(theirs.fileno()), str(given)],
                stdin=subprocess.DEVNULL,
                stdout=foreign_output(),
                pass_fds=[theirs.fileno(), given],
                start_new_session=True,  # signals for the caller's group are for the caller alone
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
        finally:
            theirs.close()
            os.close(given)
        self.connection = Connection(ours.detach())
        self._heard, self._moved = Stillness(), Stillness()
        self._progress = ()

    def _send(self) -> None:
        assert self.connection is not None
        self._heard, self._moved = Stillness(), Stillness()  # without a batch it has been silent
        with contextlib.suppress(OSError):
            size = 1 if self._is_single else GROUP
            self.connection.send((self._values[len(self.rows) :], size))

    def _take(self, message: tuple[Any, ...]) -> None:
        self._messages += 1
        kind = message[0]
        if kind == READY:
            self._is_ready, self._failed_starts = True, 0
            self._send()
        elif kind == FAILED:
            raise LiftgateError(f"a worker of the campaign: {message[1]}")
        elif kind == ROW:
            verdict, margins, figures, *others = message[1]
            self.rows.append(Row(verdict, margins, Figures(*figures), *others))
        else:
            self._progress = message[1:]

    def _hangs(self) -> str:
        silent, still = self._heard.of(self._messages), self._moved.of((len(self.rows), self._progress))
        if silent > _SILENT_S and self._is_ready:
            return f"its process gave no sign of life for {_SILENT_S:g} s"
        if still > _STILL_S:
            return f"its process made no progress for {_STILL_S:g} s"
        return ""

    def _ended(self) -> str:
        """Return in words how the worker process has ended, e.g. by which signal."""
        assert self._process is not None
        try:
            code = self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            return "its process closed its connection"
        return f"its process ended ({end_in_words(code)})"

    def _replace(self, cause: str) -> None:
        """Replace a dead or hung worker; a variant that ends several gets an error row. Raises LiftgateError."""
        was_ready, place = self._is_ready, len(self.rows)
        self.close()
        if not was_ready:
            self._failed_starts += 1
            if self._failed_starts >= _STARTS:
                raise LiftgateError(f"the campaign's workers cannot start: {cause.replace('its process', 'one')}")
        elif self._is_single:
            self._deaths[place] += 1
            if self._deaths[place] >= _DEATHS:
                self.rows.append(error_row(self.base, cause))
        else:
            self._is_single = True
        self.retried += 1
        if len(self.rows) == len(self._values):
            return
        self._start()
