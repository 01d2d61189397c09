"""Work on all CPUs: results in order, and all work ends when one item fails or the caller stops."""

from __future__ import annotations

import threading

import pytest

from liftgate_hil.identification import trajectory
from liftgate_hil.identification.trajectory import UnwantedError, check_wanted, on_all_cpus


@pytest.fixture(autouse=True)
def two_cpus(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trajectory, "_cpus", lambda: 2)


def test_results_of_workers_come_in_the_order_of_their_items() -> None:
    second_is_done = threading.Event()

    def result(item: int) -> int:
        if item == 0:
            assert second_is_done.wait(30.0)
        else:
            second_is_done.set()
        return 10 * item

    assert on_all_cpus(result, range(5), 1) == [0, 10, 20, 30, 40]


@pytest.mark.parametrize("cause", [ValueError, KeyboardInterrupt])
def test_an_exception_in_one_worker_ends_the_others(cause: type[BaseException]) -> None:
    runs = threading.Event()
    ended = threading.Event()

    def work(item: int) -> None:
        if item == 0:
            assert runs.wait(30.0)
            raise cause
        runs.set()
        try:
            while True:
                check_wanted()
        except UnwantedError:
            ended.set()
            raise

    with pytest.raises(cause):
        on_all_cpus(work, range(2), 1)
    assert ended.is_set()


def test_long_simulations_run_one_at_a_time_in_the_calling_thread() -> None:
    threads = on_all_cpus(lambda _: threading.get_ident(), range(3), 3_000_000)
    assert threads == [threading.get_ident()] * 3
    check_wanted()  # nobody has given up here
