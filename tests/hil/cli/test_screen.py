"""Live pictures at the bottom of a terminal, and messages printed above them."""

from __future__ import annotations

import os
import re

import pytest
from pseudo_terminal import as_stderr

from liftgate_hil.cli.terminal.screen import Screen

COLOUR = re.compile(r"\x1b\[[\d;]*(3[1-7]|9[0-7])m")


def two(width):
    return "first line\nsecond line"


def test_a_picture_stays_at_the_bottom_and_messages_scroll_above_it(monkeypatch):
    with as_stderr(monkeypatch, rows=8) as terminal:
        screen = Screen()
        screen.say("before")
        screen.show(screen, two)
        assert terminal.lines() == ["before", "", "first line", "second line"]
        for k in range(20):
            screen.say(f"message {k}")
        assert terminal.lines() == [*(f"message {k}" for k in range(15, 20)), "", "first line", "second line"]
        screen.take(screen)
        assert terminal.lines()[-1] == "message 19"
        screen.say("after")
        assert terminal.lines()[-2:] == ["message 19", "after"]


def test_a_shorter_picture_erases_a_longer_one_completely(monkeypatch):
    with as_stderr(monkeypatch) as terminal:
        screen = Screen()
        screen.show(screen, two)
        screen.show(screen, lambda width: "one")
        assert terminal.lines() == ["", "one"]


def test_an_inner_picture_hides_updates_of_the_outer_one_until_it_is_removed(monkeypatch):
    with as_stderr(monkeypatch) as terminal:
        screen = Screen()
        screen.show("outer", lambda width: "outer")
        screen.show("inner", lambda width: "inner")
        screen.show("outer", lambda width: "outer again")
        assert terminal.lines() == ["", "inner"]
        screen.take("inner")
        assert terminal.lines() == ["", "outer again"]
        screen.take("outer")
        assert terminal.lines() == []


@pytest.mark.parametrize("others", [b"^C", b"http://127.0.0.1:8765/\r\n"])
def test_output_of_other_programs_does_not_mix_with_the_picture(monkeypatch, others):
    with as_stderr(monkeypatch) as terminal:
        screen = Screen()
        screen.say("before")
        screen.show(screen, two)
        terminal.lines()
        os.write(terminal.slave, others)
        screen.show(screen, two)
        above = [others.decode().strip()] if others.endswith(b"\n") else []
        assert terminal.lines() == ["before", *above, "", "first line", "second line"]


def test_results_are_printed_above_the_picture(monkeypatch):
    with as_stderr(monkeypatch) as terminal:
        screen = Screen()
        screen.show(screen, two)
        with screen.aside():
            assert terminal.lines() == []
            os.write(terminal.slave, b"result\r\n")
        assert terminal.lines() == ["result", "", "first line", "second line"]


@pytest.mark.parametrize("columns", [2, 5, 10, 11, 40])
def test_a_line_is_cut_at_the_width_and_never_wrapped(monkeypatch, columns):
    with as_stderr(monkeypatch, columns=columns) as terminal:
        screen = Screen()
        for _ in range(2):
            screen.show(screen, two)
        lines = terminal.lines()
        assert len(lines) == 3
        assert lines[1][:1] in ("f", "…")
        assert max(map(len, lines)) < columns


def test_a_picture_higher_than_the_terminal_is_cut(monkeypatch):
    with as_stderr(monkeypatch, rows=4) as terminal:
        screen = Screen()
        for k in range(3):
            screen.say(f"message {k}")
            screen.show(screen, lambda width: "\n".join("abcdefgh"))
        assert terminal.lines() == ["message 2", "", "a", "b"]


def test_the_picture_follows_a_resized_terminal(monkeypatch):
    with as_stderr(monkeypatch, columns=80) as terminal:
        screen = Screen()
        screen.show(screen, lambda width: f"{width} columns")
        terminal.resize(60, 24)
        screen.say("smaller")
        assert terminal.lines() == ["smaller", "", "59 columns"]


def test_a_terminal_that_is_closed_raises_no_error(monkeypatch):
    with as_stderr(monkeypatch) as terminal:
        screen = Screen()
        screen.show(screen, two)
        terminal.hang_up()
        screen.show(screen, two)
        assert not screen.is_there
        screen.say("said to nobody")
        with screen.aside():
            pass
        screen.take(screen)


@pytest.mark.parametrize("term", ["dumb", "unknown", ""])
def test_a_terminal_that_cannot_move_its_cursor_gets_plain_lines(monkeypatch, term):
    with as_stderr(monkeypatch, term=term) as terminal:
        screen = Screen()
        screen.show(screen, two)
        screen.say("a message")
        screen.take(screen)
        assert terminal.raw() == "a message\r\n"


def test_the_variable_no_color_switches_colours_off(monkeypatch):
    def coloured(width):
        from rich.text import Text

        return Text("red", "red")

    for value, is_coloured in (("", True), ("1", False)):
        with as_stderr(monkeypatch) as terminal:
            monkeypatch.setenv("NO_COLOR", value)
            screen = Screen()
            screen.show(screen, coloured)
            assert terminal.lines() == ["", "red"]
            assert bool(COLOUR.search(terminal.raw())) == is_coloured


def test_the_picture_of_a_crashed_worker_process_is_erased(monkeypatch):
    """A worker that has crashed cannot erase its own picture."""
    with as_stderr(monkeypatch) as terminal:
        screen, of_worker = Screen(), Screen()
        screen.lend()
        of_worker.show(of_worker, two)
        screen.say("the worker has crashed")
        assert terminal.lines() == ["the worker has crashed"]
        of_worker.show(of_worker, two)
        screen.lend()
        screen.take(screen)
        assert terminal.lines() == ["the worker has crashed"]


def test_without_a_terminal_messages_are_plain_lines(monkeypatch, capsys):
    monkeypatch.setenv("TERM", "xterm")
    screen = Screen()
    screen.show(screen, two)
    screen.say("a message")
    with screen.aside():
        pass
    screen.take(screen)
    assert capsys.readouterr().err == "a message\n"


def test_a_terminal_without_unicode_gets_ascii_bars(monkeypatch):
    from rich.progress_bar import ProgressBar

    with as_stderr(monkeypatch, columns=12) as terminal:
        terminal.stream.reconfigure(encoding="ascii")
        screen = Screen()
        screen.show(screen, lambda width: ProgressBar(10, 10))
        assert terminal.lines() == ["", 11 * "-"]
