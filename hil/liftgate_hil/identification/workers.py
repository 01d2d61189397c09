"""Simulations on all CPUs: machine code does not hold the interpreter lock, so threads are enough.

While they run the main thread only waits, so that an interrupt (Ctrl-C) reaches it at once; a simulation checks
between its stretches whether its result is still needed.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_MOST_ROWS = 4_000_000  # rows of all simulations that run at a time; each needs some 150 bytes a row
_this_thread = threading.local()


class UnwantedError(Exception):
    """Raised in a worker whose result is no longer needed."""


def on_all_cpus(function: Callable[[Item], Result], items: Sequence[Item], rows: int) -> list[Result]:
    """Return `function` of each item, in their order, computed by threads on all CPUs.

    `rows` is the number of rows of one simulation, which limits how many run at a time. An exception of
    `function`, or an interrupt of the caller, ends all of them.
    """
    count = min(len(items), _cpus(), max(1, _MOST_ROWS // max(rows, 1)))
    if count <= 1:
        return [function(item) for item in items]
    is_over = threading.Event()
    with ThreadPoolExecutor(count, initializer=_begin, initargs=(is_over,)) as pool:
        try:
            return [each.result() for each in [pool.submit(function, item) for item in items]]
        except BaseException:
            is_over.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def check_wanted() -> None:
    """Raise UnwantedError if the calling thread is a worker of `on_all_cpus` whose result is no longer needed."""
    is_over: threading.Event | None = getattr(_this_thread, "is_over", None)
    if is_over is not None and is_over.is_set():
        raise UnwantedError


def _begin(is_over: threading.Event) -> None:
    _this_thread.is_over = is_over


def _cpus() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
