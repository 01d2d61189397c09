"""Measurement of how late this machine wakes the real-time loop: by its own wait, without the work in between."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, compiled
from liftgate_hil.loop.histogram import BINS, Quantiles, distribution, note
from liftgate_hil.loop.priority import Realtime, prepare_thread
from liftgate_hil.loop.realtime_loop import MONOTONIC, Room, clock_ns, make_room, wait_until

# Half the shipped rig's command cycle, the default of a scenario's `timing_tolerance_s`.
LONG_NS = 5_000_000
_HEAD_START = 1_000_000  # ns until the first period begins, for the thread to settle

Result = TypeVar("Result")


@compilable
def note_wakeups(
    period_ns: int, count: int, long_ns: int, histogram: NDArray[np.int64], stop: NDArray[np.int64], room: Room
) -> tuple[int, int]:
    """Wait for `count` deadlines as the real-time loop does, and count how late each wake-up is in a histogram.

    Returns how many periods were skipped, and how often it was late by more than `long_ns`.
    """
    start = clock_ns(MONOTONIC, room) + _HEAD_START
    done, missed, long = 0, 0, 0
    while done < count and stop[0] == 0:
        deadline = start + (done + 1) * period_ns
        late = wait_until(deadline, room) - deadline
        note(histogram, late)
        steps = min(1 + late // period_ns, count - done)
        missed += steps - 1
        long += int(late > long_ns)
        done += steps
    return missed, long


def measure_wakeups(
    period_ns: int, count: int, realtime: Realtime | None = None, long_ns: int = LONG_NS
) -> tuple[Quantiles, int, int]:
    """Measure how late a thread wakes up that waits as the real-time loop does.

    Returns the distribution of the lateness, how many of `count` periods [ns] were skipped, and how often the
    thread was late by more than `long_ns`. What `realtime` was refused is noted in it.
    """
    histogram = np.zeros(BINS, dtype=np.int64)
    stop = np.zeros(1, dtype=np.int64)
    room = make_room()
    machine_code = compiled(note_wakeups)
    machine_code(period_ns, 0, long_ns, histogram, stop, room)  # compiles before time counts

    def end() -> None:
        stop[0] = 1

    missed, long = in_own_thread(
        lambda: machine_code(period_ns, count, long_ns, histogram, stop, room), end, realtime
    )
    return distribution(histogram), int(missed), int(long)


def in_own_thread(action: Callable[[], Result], end: Callable[[], None], realtime: Realtime | None) -> Result:
    """Run `action` in a thread like that of the real-time loop; return its result, or raise what it raised.

    `end` makes it return early, for Ctrl-C.
    """
    results: list[Result] = []
    failures: list[BaseException] = []

    def run() -> None:
        try:
            prepare_thread(realtime)
            results.append(action())
        except BaseException as error:  # raised by the calling thread
            failures.append(error)

    if realtime is not None:
        realtime.prepare()
    thread = threading.Thread(target=run, name="wake-ups")
    try:
        thread.start()
        thread.join()
    finally:
        end()
        thread.join()
        if realtime is not None:
            realtime.release()
    if failures:
        raise failures[0]
    return results[0]
