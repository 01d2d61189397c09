"""What is told on stderr while something runs."""

from __future__ import annotations

import io
import pickle
import sys
from types import SimpleNamespace

import pytest

from liftgate_hil.cli.teller import Teller, line_of
from liftgate_hil.loop.listener import Status

STATUS = Status(1.25, 12.5, 1.5, -0.25, 0.012, 30, 12, 0, 0, 0)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    stream = Terminal()
    # Not sys.stderr itself: that is pytest's, and set anew between fixture and test.
    monkeypatch.setattr("liftgate_hil.cli.teller.sys", SimpleNamespace(stderr=stream))
    return stream


def test_a_line_says_where_the_run_is():
    assert line_of(STATUS, 100) == (
        "     1.2 s   12.50 deg    1.50 A  -0.25 A  command 12 ms  accepted 12  sent 30"
    )
    worse = STATUS._replace(command_age_s=None, rejected=2, foreign=9, overruns=7)
    assert line_of(worse, 200).endswith("no command  overruns 7  rejected 2  foreign 9  accepted 12  sent 30")


def test_what_has_no_room_is_left_out_whole():
    worse = STATUS._replace(overruns=123456)
    whole = line_of(worse, 200)
    for width in range(len(whole) + 1):
        shorter = line_of(worse, width)
        assert len(shorter) <= width
        assert whole == shorter or not shorter or whole.startswith(f"{shorter}  ")


def test_the_line_is_rewritten_and_makes_room_for_what_is_said(terminal: Terminal):
    teller = Teller(is_quiet=False)
    teller.status(STATUS)
    teller.status(STATUS)
    line = line_of(STATUS, 77)
    assert terminal.getvalue() == f"\r{line}\x1b[K"
    teller.say("`record` run.log: full")
    assert terminal.getvalue() == f"\r{line}\x1b[K\r\x1b[K--record run.log: full\n\r{line}\x1b[K"
    teller.clear()
    assert terminal.getvalue().endswith("\r\x1b[K")


def test_the_line_never_fills_a_narrow_terminal(terminal: Terminal, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(terminal, "fileno", lambda: 2)
    monkeypatch.setattr("os.get_terminal_size", lambda _: SimpleNamespace(columns=30))
    Teller(is_quiet=False).status(STATUS)
    assert terminal.getvalue() == "\r     1.2 s   12.50 deg\x1b[K"


def test_compiling_shows_how_long_it_has_taken(terminal: Terminal):
    teller = Teller(is_quiet=False)
    teller.compiles("compiling the model", 0.0)
    teller.compiles("compiling the model", 7.4)
    assert terminal.getvalue().endswith(
        "\rcompiling the model, once for this version and machine: 7 s so far\x1b[K"
    )
    teller.compiles("compiling the model", 7.4, 30.0)
    bar = "[####................]"
    assert terminal.getvalue().endswith(f"\rcompiling the model {bar} 7 s of about 30 s\x1b[K")
    teller.compiles("compiling the model", 99.0, 30.0)
    assert terminal.getvalue().endswith(f"[{20 * '#'}] 99 s of about 30 s\x1b[K")
    teller.compiled("the model", 8.0)
    assert terminal.getvalue().endswith("\r\x1b[K")


def test_where_there_is_no_terminal_each_thing_is_reported_once(capsys: pytest.CaptureFixture[str]):
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
def test_quiet_is_quiet_and_beside_json_only_what_goes_wrong_is_reported(terminal: Terminal, is_json: bool):
    teller = Teller(is_quiet=not is_json, is_json=is_json)
    teller.starts("suv")
    teller.compiles("compiling the model", 3.0)
    teller.compiled("the model", 4.0)
    teller.status(STATUS)
    teller.happened(0.5, "opening")
    teller.say("the link is down")
    assert terminal.getvalue() == ("the link is down\n" if is_json else "")


def test_nobody_has_to_listen(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, "stderr", None)
    Teller(is_quiet=False).say("told to nobody")
    broken = Terminal()
    broken.write = lambda text: (_ for _ in ()).throw(BrokenPipeError)  # type: ignore[method-assign]
    monkeypatch.setattr(sys, "stderr", broken)
    teller = Teller(is_quiet=False)
    teller.status(STATUS)
    teller.say("told to nobody")


def test_it_goes_to_a_worker_without_its_line(terminal: Terminal):
    teller = Teller(is_quiet=False)
    teller.status(STATUS)
    there = pickle.loads(pickle.dumps(teller))
    there.clear()
    assert terminal.getvalue().count("\r") == 1


def test_a_line_is_one_write_so_that_another_process_cannot_write_into_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """An unbuffered stream (PYTHONUNBUFFERED) passes each write on: a page's address got another line into it."""
    writes: list[str] = []
    stream = SimpleNamespace(write=writes.append, flush=lambda: None, isatty=lambda: False)
    monkeypatch.setattr("liftgate_hil.cli.teller.sys", SimpleNamespace(stderr=stream))
    Teller(False).say("http://127.0.0.1:8765/?token=x")
    assert writes == ["http://127.0.0.1:8765/?token=x\n"]
