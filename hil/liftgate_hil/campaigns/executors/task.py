"""Task of a Dask cluster: evaluates a batch of variants in a slot (worker process) of a Dask worker.

A slot that evaluates is its task's alone: nobody can take it or end it from outside. Idle ones are kept.
"""

from __future__ import annotations

import pickle
import threading
import time
import zlib
from collections.abc import Mapping
from multiprocessing.connection import wait
from typing import Any, NamedTuple

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.campaigns.executors.slot import Slot
from liftgate_hil.campaigns.results import table_of
from liftgate_hil.campaigns.store import Store, packed
from liftgate_hil.config.can_libraries import unpickled
from liftgate_hil.errors import words_of
from liftgate_hil.version import versions

_IDLE_S = 60.0  # s without a batch until a slot is ended; another one starts within two
_WATCH_S = 5.0
_LOOK_S = 0.5
_COMPARED = ("liftgate-hil", "python", "numba", "llvmlite", "numpy")  # packages that results depend on


class _Idle(NamedTuple):
    token: str  # of the client
    since: float  # s, monotonic
    slot: Slot


class IdleSlots:
    """Pool of this process's idle slots, shared by its threads.

    A slot that is not taken for a minute is ended: a client that was killed has not asked for its end.
    """

    def __init__(self) -> None:
        self._idle: list[_Idle] = []
        self._lock = threading.Lock()
        self._is_watched = False

    def take(self, token: str) -> Slot | None:
        """Take the most recently used idle slot of a client from the pool; None: the client has none."""
        with self._lock:
            for place in reversed(range(len(self._idle))):
                if self._idle[place].token == token:
                    return self._idle.pop(place).slot
        return None

    def put(self, token: str, slot: Slot) -> None:
        """Put a slot into the pool, for the next batch of its client."""
        with self._lock:
            self._idle.append(_Idle(token, time.monotonic(), slot))
            if not self._is_watched:
                self._is_watched = True
                threading.Thread(target=self._watch, name="idle slots", daemon=True).start()

    def end(self, token: str) -> None:
        """End the idle slots of a client."""
        with self._lock:
            ended = [each for each in self._idle if each.token == token]
            self._idle = [each for each in self._idle if each.token != token]
        for each in ended:
            each.slot.close()

    def _watch(self) -> None:
        """End slots that have been idle for too long, until the pool is empty."""
        while True:
            time.sleep(_WATCH_S)
            first = time.monotonic() - _IDLE_S
            with self._lock:
                ended = [each for each in self._idle if each.since <= first]
                self._idle = [each for each in self._idle if each.since > first]
                self._is_watched = goes_on = bool(self._idle)
            for each in ended:
                each.slot.close()
            if not goes_on:
                return


_idle = IdleSlots()  # of this worker of the cluster


class TaskResult(NamedTuple):
    """Result of a task: the batch was stored, or its table is returned, or the worker refused it."""

    retried: int
    table: bytes = b""  # Parquet; empty: the worker has stored it
    refused: str = ""  # why this worker does not take part, with its name


class PickledBase(NamedTuple):
    """Compressed, pickled base of a campaign, sent with each task: Dask loses scattered data with its workers."""

    packed: bytes

    @classmethod
    def of(cls, base: Base) -> PickledBase:
        """Return the base pickled and compressed."""
        return cls(zlib.compress(pickle.dumps(base)))

    def pickled(self) -> bytes:
        """Return the pickled base, decompressed."""
        return zlib.decompress(self.packed)


def evaluated(content: PickledBase, token: str, values: Floats, name: str, store: Store, mark: str) -> TaskResult:
    """Evaluate a batch in this Dask worker, in a slot of the client that `token` names; return the result.

    Raises LiftgateError, StoreError; Reschedule, on which the scheduler has the task run again, where nobody waits
    for it any more.
    """
    from distributed import get_worker

    pickled = content.pickled()
    base: Base = unpickled(pickled)
    if text := differs(versions(), base.versions):
        return TaskResult(0, refused=f"worker {get_worker().address}: {text}")
    is_shared = store.is_shared(mark)
    if is_shared and store.get(name) is not None:  # evaluated by a worker that died before it could say so
        return TaskResult(0)
    slot = _idle.take(token) or Slot(base, pickled)
    before = slot.retried
    try:
        _evaluate(slot, values)
    except BaseException:
        slot.close()
        raise
    rows, retried = slot.rows, slot.retried - before
    _idle.put(token, slot)
    table = table_of(base, values, rows)
    if is_shared:
        store.put(name, table)
        return TaskResult(retried)
    return TaskResult(retried, packed(table))


def _evaluate(slot: Slot, values: Floats) -> None:
    """Evaluate a batch in a slot, and return once all result rows are in `slot.rows`. Raises as `evaluated`."""
    from distributed import Reschedule, get_worker

    worker = get_worker()
    key = worker.get_current_task()
    slot.begin(values)
    while not slot.look():
        if not _is_wanted(worker, key):
            raise Reschedule
        if slot.connection is not None:
            wait([slot.connection], _LOOK_S)


def _is_wanted(worker: Any, key: Any) -> bool:
    """Whether a client still waits for a task: the scheduler cancels the tasks of a client that has ended."""
    task = worker.state.tasks.get(key)
    return task is not None and task.state != "cancelled"


def end_slots(token: str) -> None:
    """End a client's idle slots in this Dask worker; slots at work end with their tasks."""
    _idle.end(token)


def differs(given: Any, wanted: Mapping[str, str]) -> str:
    """Return the differences between a worker's package versions and the wanted ones, in words; "": none."""
    if not isinstance(given, Mapping):
        return f"liftgate-hil is not there: {words_of(given) if isinstance(given, BaseException) else given}"
    wrong = [
        f"{name} {given.get(name)}, here {wanted[name]}" for name in _COMPARED if given.get(name) != wanted[name]
    ]
    return f"{', '.join(wrong)}; allowed: the same versions, or results would differ" if wrong else ""
