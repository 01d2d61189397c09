"""Executor on a Dask cluster: a task is a batch, evaluated in a child process of a Dask worker.

The scheduler holds no results: a task writes its batch to the store and returns its name. Where a worker does not
see the store, the task hands the table back, and this process stores it.
"""

from __future__ import annotations

import contextlib
import logging
import math
import re
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from functools import partial
from typing import Any

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.executors.executor import Batch, Done
from liftgate_hil.campaigns.executors.task import PickledBase, TaskResult, differs, end_slots, evaluated
from liftgate_hil.campaigns.store import KEPT, Store, StoreError, unpacked
from liftgate_hil.errors import ConfigError, LiftgateError, text_of, words_of
from liftgate_hil.version import versions

_ADDRESS = re.compile(r"(?:tcp|tls)://(\[[^\]]+\]|[^:/\[\]]+):(\d{1,5})")
_CONNECT_S = 20.0  # s that a scheduler may take to answer
_GONE_S = 30.0  # s without a connection to the scheduler until it is given up
_NOBODY_S = 120.0  # s without any worker until the campaign is given up
_ANSWER_S = 10.0  # s that the scheduler may take for an answer
_ASK_S = 1.0  # s from one question for its workers to the next
_POLL_S = 0.02
_IN_FLIGHT = 2  # batches for each thread of a worker: one at work, one that waits
_TOGETHER = 256  # answers that are fetched with one question
_DEATHS = 100  # of workers while they have a task in hand, until Dask gives the task up
_LOST = (OSError, TimeoutError, CancelledError)  # errors of asking for an answer, not of the task
_NO_WORKER = ("KilledWorker", "NoWorkerError", "NoValidWorkerError")  # errors with which Dask gives a task up


class GoneError(LiftgateError):
    """Raised where the scheduler of a Dask cluster, or all of its workers, can no longer be reached."""


class Cluster:
    """Executor on the workers of a Dask scheduler. Raises ConfigError where it cannot be used."""

    def __init__(self, base: Base, address: str, tell: Callable[[str], None] = lambda text: None) -> None:
        self._base, self._address, self._tell = base, address, tell
        distributed = _distributed()
        _check_address(address)
        # Its own log tells of lost connections with tracebacks; this class says what matters.
        for name in ("distributed", "distributed.client", "distributed.core", "distributed.comm"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            self._client = distributed.Client(
                address, timeout=_CONNECT_S, set_as_default=False, name="liftgate-hil"
            )
        except (OSError, ValueError, TimeoutError) as error:
            raise ConfigError(
                f"`scheduler` {address}: {words_of(error)}; allowed: the address of a Dask scheduler"
            ) from None
        self._refused: set[str] = set()
        self._content = PickledBase.of(base)
        try:
            self._prepare()
        except BaseException:
            self.close()
            raise

    def _prepare(self) -> None:
        """Check the workers' versions, and set how many worker deaths a task survives. Raises ConfigError."""
        try:
            has_workers = within(_ANSWER_S, self._client.nthreads)
        except Exception as error:
            raise ConfigError(f"`scheduler` {self._address}: it does not answer: {words_of(error)}") from None
        if not has_workers:
            raise ConfigError(
                f"`scheduler` {self._address}: it has no workers; allowed: one with `dask worker` processes"
            )
        try:
            found = within(_CONNECT_S, partial(self._client.run, versions, on_error="return"))
        except Exception as error:
            raise ConfigError(
                f"`scheduler` {self._address}: its workers do not answer: {words_of(error)}"
            ) from None
        issues = [
            f"worker {name}: {text}"
            for name, given in found.items()
            if (text := differs(given, self._base.versions))
        ]
        if issues:
            raise ConfigError(issues)
        try:
            within(_CONNECT_S, partial(self._client.run_on_scheduler, _set_allowed_deaths, deaths=_DEATHS))
        except Exception as error:
            raise ConfigError(f"`scheduler` {self._address}: it does not answer: {words_of(error)}") from None

    @property
    def workers(self) -> int:
        """Number of threads of all workers that were not refused, at least 1. Raises GoneError."""
        return max(1, sum(self._threads().values()))

    def _threads(self) -> Mapping[str, int]:
        """Return the number of threads of each worker that was not refused, by address. Raises GoneError."""
        try:
            threads: Mapping[str, int] = within(_ANSWER_S, self._client.nthreads)
        except Exception as error:
            raise GoneError(f"the scheduler at {self._address}: {words_of(error)}; {KEPT}") from None
        return {name: count for name, count in threads.items() if name not in self._refused}

    def run(
        self, batches: Iterable[Batch], store: Store, stopped: Callable[[], bool], count: Callable[[int], None]
    ) -> Iterator[Done]:
        """Evaluate batches, yield each when done: `Executor.run`. Raises GoneError, LiftgateError, StoreError."""
        waiting, again = iter(batches), list[Batch]()
        busy: dict[Any, Batch] = {}
        mark, is_empty = store.mark(), False
        watch = _Watch(self._client, self._address)
        try:
            while not stopped():
                threads = watch.look(self._threads)
                while watch.is_there() and len(busy) < _IN_FLIGHT * threads:
                    batch = again.pop() if again else next(waiting, None)
                    if batch is None:
                        is_empty = True
                        break
                    busy[self._submit(batch, store, mark)] = batch
                if is_empty and not (busy or again):
                    return
                time.sleep(_POLL_S)
                for future, answer in self._answers([each for each in busy if each.done()]):
                    batch = busy.pop(future)
                    if answer is None:
                        again.append(batch)
                        continue
                    if answer.table:
                        table = unpacked(answer.table)
                        if table is None:
                            text = "a batch that a worker handed back cannot be read: its file is damaged"
                            raise StoreError(text)
                        store.put(batch.name, table)
                    count(batch.count)
                    yield Done(batch, answer.retried)
        finally:
            store.unmark(mark)
            if self._client.status == "running":
                with contextlib.suppress(Exception):  # what is left of it is not waited for
                    within(_ANSWER_S, partial(self._client.cancel, list(busy)))

    def _submit(self, batch: Batch, store: Store, mark: str) -> Any:
        allowed = list(self._threads()) if self._refused else None
        return self._client.submit(
            evaluated, self._content, self._client.id, batch.values, batch.name, store, mark,
            pure=False, retries=0, workers=allowed,
        )  # fmt: skip

    def _answers(self, futures: list[Any]) -> Iterator[tuple[Any, TaskResult | None]]:
        """Yield the first ended tasks with results, fetched at once if possible; None: submit the batch again."""
        futures = futures[:_TOGETHER]
        good = [each for each in futures if each.status == "finished"]
        fetched: dict[Any, TaskResult] = {}
        with contextlib.suppress(Exception):  # they are fetched one by one then, which tells whose it is
            answers = within(_CONNECT_S, partial(self._client.gather, good))
            fetched = dict(zip(good, answers, strict=True))
        for each in futures:
            yield each, self._answer(each, fetched.get(each))

    def _answer(self, future: Any, answer: TaskResult | None = None) -> TaskResult | None:
        """Return a task's result; None: submit its batch again (it is lost or refused). Raises LiftgateError."""
        try:
            answer = answer or future.result(timeout=_CONNECT_S)
            assert answer is not None
        except StoreError:
            raise
        except Exception as error:
            is_lost = future.status != "error" and isinstance(error, _LOST)
            if is_lost or type(error).__name__ in _NO_WORKER:
                return None  # `_Watch` looks at whether scheduler and workers are there
            kind = "" if isinstance(error, LiftgateError) else f"{type(error).__name__}: "
            raise LiftgateError(f"{self._address}: a task failed: {kind}{text_of(error)}; {KEPT}") from error
        if answer.refused:
            name = answer.refused.partition(": ")[0].removeprefix("worker ")
            if name not in self._refused:
                self._tell(f"note: {answer.refused}: it is not used")
            self._refused.add(name)
            return None
        return answer

    def close(self) -> None:
        """End this client's slots and close the connection; the cluster keeps running for other clients."""
        with contextlib.suppress(Exception):  # the scheduler may be gone, with all that could be closed
            if self._client.status == "running":
                within(_ANSWER_S, partial(self._client.run, end_slots, self._client.id, on_error="ignore"))
        with contextlib.suppress(Exception):
            within(_ANSWER_S, partial(self._client.close, timeout=2.0))


class _Watch:
    """Monitor of a Dask cluster: raises GoneError once its scheduler or workers are gone for too long."""

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address = client, address
        self._seen = self._worked = time.monotonic()
        self._asked, self._threads = -math.inf, 0

    def is_there(self) -> bool:
        """Whether the scheduler is connected."""
        return bool(self._client.status == "running")

    def look(self, threads: Callable[[], Mapping[str, int]]) -> int:
        """Return the workers' number of threads, which `threads` queries from the scheduler at intervals.

        Raises GoneError where the scheduler or its workers have been gone for too long.
        """
        now = time.monotonic()
        if self.is_there() and now - self._asked > _ASK_S:
            self._asked = now
            with contextlib.suppress(Exception):  # a scheduler that does not answer is gone, in the end
                self._threads = sum(threads().values())
                self._seen = time.monotonic()
        if self._threads or not self.is_there():
            self._worked = now
        if now - self._seen > _GONE_S or self._client.status == "closed":
            raise GoneError(f"the scheduler at {self._address} is gone; {KEPT}")
        if now - self._worked > _NOBODY_S:
            raise GoneError(f"{self._address}: no worker for {_NOBODY_S:g} s; {KEPT}")
        return self._threads


def within(seconds: float, ask: Callable[[], Any]) -> Any:
    """Return the result of calling `ask`, waiting at most `seconds`, as calls of Dask's client may block for ever.

    Raises TimeoutError, and what the call raises.
    """
    found: list[Any] = []
    failed: list[BaseException] = []

    def call() -> None:
        try:
            found.append(ask())
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    thread.join(seconds)
    if failed:
        raise failed[0]
    if not found:
        raise TimeoutError(f"no answer within {seconds:g} s")
    return found[0]


def _check_address(address: str) -> None:
    """Raise ConfigError where nothing listens at an address, before a Dask client keeps trying to connect."""
    match = _ADDRESS.fullmatch(address)
    if match is None:
        raise ConfigError(f"`scheduler` {address}: allowed: tcp://HOST:PORT of a Dask scheduler")
    host = match[1].removeprefix("[").removesuffix("]")
    try:
        socket.create_connection((host, int(match[2])), _CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"`scheduler` {address}: {words_of(error)}; allowed: the address of a Dask scheduler"
        ) from None


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise ConfigError("`scheduler`: allowed: with liftgate-hil[cluster] installed") from None
    return distributed


def _set_allowed_deaths(dask_scheduler: Any, deaths: int) -> None:
    """Set the number of worker deaths that a task survives, as most tasks of a dead worker are not to blame."""
    dask_scheduler.allowed_failures = deaths
