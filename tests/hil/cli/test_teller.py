"""Messages on stderr while a command runs."""

from __future__ import annotations

import io
import pickle
import sys
from types import SimpleNamespace

import pytest
from pseudo_terminal import Clock, as_stderr

from liftgate_hil.cli.terminal.panel import PanelView
from liftgate_hil.cli.terminal.teller import Teller
from liftgate_hil.loop.listener import RunStatus

STATUS = RunStatus(1.25, 12.5, 1.5, -0.25, 0.012, 30, 12, 0, 0, 0)


def test_the_panel_stays_below_the_messages(monkeypatch: pytest.MonkeyPatch):
    with as_stderr(monkeypatch) as terminal:
        teller = Teller(is_quiet=False, how="1000 Hz")
        teller.starts("suv on can0")
        teller.status(STATUS)
        teller.say("`record` run.log: full")
        teller.happened(0.5, "opening")
        *above, empty, time, gate, motors, command, frames = terminal.lines()
        assert above == ["suv on can0, 1000 Hz", "--record run.log: full", "ecu   0.500 s  opening"]
        assert empty == ""
        assert [each.split()[0] for each in (time, gate, motors, command, frames)] == [
            "time", "gate", "motors", "command", "frames",
        ]  # fmt: skip
        teller.clear()
        assert terminal.lines() == above


def test_the_panel_is_drawn_a_few_times_a_second(monkeypatch: pytest.MonkeyPatch):
    with as_stderr(monkeypatch) as terminal:
        clock = Clock()
        teller = Teller(is_quiet=False, clock=clock)
        for k in range(10):
            teller.status(STATUS._replace(time_s=float(k)))
            clock.now += 0.101
        assert [picture[1].split()[1] for picture in terminal.pictures()] == ["0.0", "2.0", "4.0", "6.0", "8.0"]


def test_a_panel_with_a_delay_is_drawn_only_after_the_delay(monkeypatch: pytest.MonkeyPatch):
    with as_stderr(monkeypatch) as terminal:
        clock = Clock()
        teller = Teller(is_quiet=False, view=PanelView(after_s=2.0), clock=clock)
        for _ in range(2):
            teller.status(STATUS)
            clock.now += 1.9
        assert terminal.lines() == []
        teller.status(STATUS)
        assert len(terminal.lines()) == 6


def test_compilation_shows_its_elapsed_time(monkeypatch: pytest.MonkeyPatch):
    with as_stderr(monkeypatch) as terminal:
        clock = Clock()
        teller = Teller(is_quiet=False, clock=clock)
        teller.compiles("compiling the model", 0.0)
        assert terminal.lines() == []
        clock.now += 7.4
        teller.compiles("compiling the model", 7.4)
        assert terminal.lines() == ["", "compiling the model  7 s", "once for this version and machine"]
        clock.now += 1.0
        teller.compiles("compiling the model", 8.4, 30.0)
        assert terminal.lines()[1].startswith("compiling the model  ━")
        assert terminal.lines()[1].endswith("  8 s, 22 s left")
        clock.now += 90.0
        teller.compiles("compiling the model", 98.4, 30.0)
        assert terminal.lines()[1].endswith("━  1 min 38 s")
        teller.compiled("the model", 98.4)
        assert terminal.lines() == []
        teller.compiles("compiling another", 0.0)
        teller.compiled("another", 0.1)
        assert terminal.lines() == []


def test_without_a_terminal_each_message_is_printed_once(capsys: pytest.CaptureFixture[str]):
    teller = Teller(is_quiet=False, how="1000 Hz")
    teller.starts("suv on can0")
    for seconds in (0.0, 0.1, 9.0):
        teller.compiles("compiling the model", seconds)
    teller.compiled("the model", 9.0)
    teller.status(STATUS)
    teller.happened(0.5, "opening")
    assert capsys.readouterr().err.splitlines() == [
        "suv on can0, 1000 Hz",
        "compiling the model, once for this version and machine …",
        "ready after 9.0 s",
        "ecu   0.500 s  opening",
    ]


@pytest.mark.parametrize("is_json", [False, True])
def test_quiet_prints_nothing_and_json_only_problems(is_json: bool, monkeypatch: pytest.MonkeyPatch):
    with as_stderr(monkeypatch) as terminal:
        clock = Clock()
        teller = Teller(is_quiet=not is_json, is_json=is_json, clock=clock)
        teller.starts("suv")
        teller.compiles("compiling the model", 3.0)
        clock.now += 3.0
        teller.compiles("compiling the model", 6.0)
        teller.compiled("the model", 6.0)
        teller.status(STATUS)
        teller.happened(0.5, "opening")
        teller.say("the link is down")
        assert terminal.raw() == ("the link is down\r\n" if is_json else "")


def test_a_closed_stderr_raises_no_error(monkeypatch: pytest.MonkeyPatch):
    class Broken(io.StringIO):
        def isatty(self) -> bool:
            return True

        def write(self, text: str) -> int:
            raise BrokenPipeError

    monkeypatch.setenv("TERM", "xterm")
    for stream in (None, Broken()):
        monkeypatch.setattr(sys, "stderr", stream)
        teller = Teller(is_quiet=False)
        teller.status(STATUS)
        teller.say("told to nobody")
        teller.clear()


def test_a_teller_sent_to_a_worker_process_draws_the_panel_there(monkeypatch: pytest.MonkeyPatch):
    with as_stderr(monkeypatch) as terminal:
        teller = Teller(is_quiet=False, view=PanelView(drives=1))
        there = pickle.loads(pickle.dumps(teller))
        there.status(STATUS)
        assert "motors   1.50 A" in terminal.lines()
        teller.say("the worker has crashed")
        teller.clear()
        assert terminal.lines() == ["the worker has crashed"]


def test_a_line_is_written_in_one_call_so_that_other_output_cannot_split_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An unbuffered stream (PYTHONUNBUFFERED) passes each write on, so that another line could split it."""
    writes: list[str] = []
    for is_terminal in (False, True):
        stream = SimpleNamespace(
            write=writes.append, flush=lambda: None, isatty=lambda seen=is_terminal: seen, fileno=lambda: -1
        )
        monkeypatch.setattr("sys.stderr", stream)
        monkeypatch.setenv("TERM", "xterm")
        teller = Teller(False)
        teller.status(STATUS)
        writes.clear()
        teller.say("http://127.0.0.1:8765/?token=x")
        assert len(writes) == 1
        assert "http://127.0.0.1:8765/?token=x\n" in writes[0]
