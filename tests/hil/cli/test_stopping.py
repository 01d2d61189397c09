"""Effects of SIGINT and SIGTERM on a command, on a simulated clock."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from liftgate_hil.cli import stopping
from liftgate_hil.cli.stopping import StoppedError, StopSignals, interrupt
from liftgate_hil.ecu.foreign import FOREIGN, NoAnswerError
from liftgate_hil.errors import LiftgateError

NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)


class Clock:
    """A monotonic clock, and the timers that were requested of the kernel."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        self.ends: list[int] = []
        self.timers: list[tuple[float, ...]] = []
        monkeypatch.setattr(stopping.time, "monotonic", lambda: self.now)
        monkeypatch.setattr(stopping.signal, "raise_signal", self.ends.append)
        monkeypatch.setattr(stopping.signal, "setitimer", lambda _, *times: self.timers.append(times))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[Clock]:
    before = {number: signal.getsignal(number) for number in NUMBERS}
    yield Clock(monkeypatch)
    for number, handler in before.items():
        signal.signal(number, handler)


def send(number: int) -> None:
    handler = signal.getsignal(number)
    assert callable(handler)
    handler(number, None)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_within_a_second_count_once_and_a_later_one_ends_the_process(
    clock: Clock, number: int, capfd: pytest.CaptureFixture[str]
) -> None:
    stopped = StopSignals()
    assert not stopped()
    send(number)
    assert (stopped(), stopped.exit_code) == (True, 128 + number)
    for _ in range(5):
        clock.now += 0.19
        send(signal.SIGTERM)
    assert (clock.ends, stopped.exit_code) == ([], 128 + number)
    clock.now += 0.1
    send(number)
    assert clock.ends == [number]
    assert signal.getsignal(number) is signal.SIG_DFL
    assert "ended at once" in capfd.readouterr().err


def test_after_a_stop_signal_a_long_foreign_call_is_interrupted_repeatedly(clock: Clock) -> None:
    StopSignals()
    with FOREIGN:
        send(signal.SIGTERM)
        for _ in range(3):
            with pytest.raises(NoAnswerError):
                send(signal.SIGALRM)
    send(signal.SIGALRM)
    assert clock.timers == [(1.0, 0.2), (0.0,)]


def test_after_a_stop_signal_foreign_calls_that_return_are_not_interrupted(clock: Clock) -> None:
    StopSignals()
    send(signal.SIGINT)
    for _ in range(5):
        with FOREIGN:
            send(signal.SIGALRM)
    with FOREIGN:
        send(signal.SIGALRM)
        with pytest.raises(NoAnswerError):
            send(signal.SIGALRM)


def test_a_failure_after_a_stop_has_the_stops_exit_code(clock: Clock) -> None:
    stopped = StopSignals()
    assert type(stopped.failure("x")) is LiftgateError
    send(signal.SIGTERM)
    failure = stopped.failure("x")
    assert isinstance(failure, StoppedError)
    assert (str(failure), failure.exit_code) == ("x", 143)


def test_an_interrupt_inside_an_import_ends_the_process_and_elsewhere_is_raised(clock: Clock) -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupt(signal.SIGINT, None)
    assert clock.ends == []
    frozen = compile("handler(2, __import__('sys')._getframe())", "<frozen importlib._bootstrap>", "exec")
    with pytest.raises(KeyboardInterrupt):  # the fake end is none
        exec(frozen, {"handler": interrupt})
    assert clock.ends == [signal.SIGINT]
