"""The progress display of long operations, on a clock of the test."""

from __future__ import annotations

import re

import pytest
from pseudo_terminal import Clock, as_stderr

from liftgate_hil.cli.terminal.progress import ProgressDisplay, duration_of
from liftgate_hil.cli.terminal.screen import Screen


def test_an_operation_of_less_than_two_seconds_is_not_shown(monkeypatch):
    with as_stderr(monkeypatch) as terminal:
        clock = Clock()
        progress = ProgressDisplay(Screen(), "convert", clock=clock)
        for _ in range(20):
            progress.update(text="rows")
            clock.now += 0.0999
        progress.close()
        assert terminal.raw() == ""


def test_a_longer_operation_shows_elapsed_and_remaining_time(monkeypatch):
    with as_stderr(monkeypatch) as terminal:
        clock = Clock()
        progress = ProgressDisplay(Screen(), "scenarios", 8, clock=clock)
        clock.now += 3.0
        progress.update(2, text="2/8 done")
        line, text = terminal.lines()[1:]
        assert line.startswith("scenarios  ━")
        assert line.endswith("  3 s, 9 s left")
        assert text == "2/8 done"
        clock.now += 1.0
        progress.update(8)
        assert terminal.lines()[1:] == [line.partition(" ")[0] + "  " + "━" * 63 + "  4 s"]
        progress.close()
        assert terminal.lines() == []


def test_the_display_is_redrawn_only_a_few_times_a_second(monkeypatch):
    with as_stderr(monkeypatch) as terminal:
        clock = Clock()
        progress = ProgressDisplay(Screen(), "convert", clock=clock)
        clock.now += 2.0
        for k in range(10):
            progress.update(text=f"{k} rows")
            clock.now += 0.1
        assert [picture[-1] for picture in terminal.pictures()] == ["0 rows", "3 rows", "6 rows", "9 rows"]


def test_work_done_before_the_start_does_not_count_for_the_speed(monkeypatch):
    with as_stderr(monkeypatch) as terminal:
        clock = Clock()
        progress = ProgressDisplay(Screen(), "campaign", clock=clock)
        clock.now += 10.0
        progress.update(60, 100, before=50)
        assert terminal.lines()[1].endswith("10 s, 40 s left")


def test_an_operation_of_known_duration_needs_no_reports(monkeypatch):
    with as_stderr(monkeypatch) as terminal:
        clock = Clock()
        progress = ProgressDisplay(Screen(), "doctor", clock=clock)
        clock.now += 5.0
        progress.lasts(60.0, "measuring")
        clock.now += 20.0
        progress.draw()
        assert terminal.lines()[1].startswith("measuring  ━")
        assert terminal.lines()[1].endswith("20 s, 40 s left")


def test_the_display_fits_into_forty_columns(monkeypatch):
    with as_stderr(monkeypatch, columns=40) as terminal:
        clock = Clock()
        progress = ProgressDisplay(Screen(), "compiling the real-time loop", clock=clock)
        clock.now += 7.0
        progress.update(7.0, 30.0, "once for this version and machine, which is long")
        line, text = terminal.lines()[1:]
        assert line.endswith("7 s, 23 s left")
        assert line.startswith("compiling")
        assert text.endswith("…")


def test_a_closed_display_is_not_drawn(monkeypatch):
    with as_stderr(monkeypatch) as terminal:
        clock = Clock()
        progress = ProgressDisplay(Screen(), "convert", clock=clock)
        progress.close()
        clock.now += 5.0
        progress.draw()
        assert terminal.raw() == ""


def test_a_thread_draws_the_display_while_nothing_is_reported(monkeypatch):
    with as_stderr(monkeypatch) as terminal:
        with ProgressDisplay(Screen(), "plot", after_s=0.0):
            terminal.wait_for("plot")
        assert terminal.lines() == []


def test_without_a_terminal_there_is_no_thread_and_a_short_operation_writes_nothing(capsys):
    with ProgressDisplay(Screen(), "plot", after_s=0.0) as progress:
        assert progress._thread is None
        progress.update(text="rows")
    assert capsys.readouterr().err == ""


def test_durations_are_written_in_hours_minutes_and_seconds():
    assert [duration_of(each) for each in (0.4, 59.4, 60.0, 3599.0, 3700.0)] == [
        "0 s", "59 s", "1 min 0 s", "59 min 59 s", "1 h 1 min",
    ]  # fmt: skip


def test_without_a_terminal_there_is_a_plain_line_every_half_minute():
    said, clock = [], Clock()
    progress = ProgressDisplay(Screen(is_off=True), "identify", clock=clock, plain=said.append)
    for k in range(70):
        progress.update(text=f"iteration {k}")
        clock.now += 1.0
    progress.update(3, 12, what="plan")
    progress.close()
    progress.update()
    assert said == ["identify: 30 s, iteration 30", "identify: 1 min 0 s, iteration 60"]
    clock.now += 60.0
    other = ProgressDisplay(Screen(is_off=True), "scenarios", 8, clock=clock, plain=said.append)
    clock.now += 45.0
    other.update(2)
    assert said[2:] == ["scenarios: 45 s, 25%"]
    ProgressDisplay(Screen(is_off=True), "nothing", clock=clock).update()
    clock.now += 60.0
    other.update(8)  # done: the result comes next
    assert len(said) == 3


@pytest.mark.parametrize(
    ("is_quiet", "is_json", "is_said"), [(False, False, True), (True, False, False), (False, True, False)]
)
def test_quiet_and_json_suppress_the_plain_line(
    is_quiet: bool,
    is_json: bool,
    is_said: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    from liftgate_hil.cli.terminal import progress as module
    from liftgate_hil.cli.terminal.teller import Teller

    monkeypatch.setattr(module, "PLAIN_S", 0.0)
    Teller(is_quiet, is_json).progress("identify").update(text="iteration 1")
    assert bool(re.search(r"identify: \d+ s, iteration 1", capsys.readouterr().err)) == is_said
