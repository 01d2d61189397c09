"""The status panel of a run in the terminal."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from liftgate_hil.cli.terminal.panel import PanelView, panel_of
from liftgate_hil.loop.listener import RunStatus

STATUS = RunStatus(12.5, 45.0, 1.5, -0.25, 0.012, 30, 12, 0, 0, 0)
VIEW = PanelView(open_deg=90.0, duration_s=25.0)


def text_of(status: RunStatus, view: PanelView = VIEW, width: int = 79) -> str:
    console = Console(file=io.StringIO(), force_terminal=True, color_system=None, width=width)
    with console.capture() as capture:
        console.print(panel_of(status, view, width), width=width, no_wrap=True)
    return capture.get()


def lines_of(status: RunStatus, view: PanelView = VIEW, width: int = 79) -> list[str]:
    return [line.rstrip() for line in text_of(status, view, width).splitlines()]


def test_the_panel_has_time_angle_motors_command_and_frames():
    time, gate, *others = lines_of(STATUS)
    assert time.split()[:4] == ["time", "12.5", "s", "0"]
    assert time.endswith(" 25 s")
    assert gate.split()[:4] == ["gate", "45.00", "deg", "closed"]
    assert gate.endswith(" open")
    assert others == [
        "motors   left   1.50 A  right  -0.25 A",
        "command  12 ms old",
        "frames   12 accepted  30 sent",
    ]


@pytest.mark.parametrize(("angle", "share"), [(-1.0, 0.0), (0.0, 0.0), (22.5, 0.25), (90.0, 1.0), (91.0, 1.0)])
def test_the_bar_of_the_gate_is_proportional_to_its_angle(angle, share):
    drawn = [line.count("━") + 0.5 * line.count("╸") for line in lines_of(STATUS._replace(angle_deg=angle))[:2]]
    assert drawn[1] == pytest.approx(2.0 * share * drawn[0], abs=1.0)


def test_a_run_without_a_duration_has_no_time_bar():
    time, gate, *_ = lines_of(STATUS, VIEW._replace(duration_s=None))
    assert time.split() == ["time", "12.5", "s"]
    assert "━" in gate


def test_overruns_and_unsent_rejected_and_foreign_frames_are_shown_if_there_are_any():
    lines = lines_of(STATUS._replace(command_age_s=None, rejected=2, foreign=9, overruns=7, unsent=4))
    assert lines[3] == "command  no command"
    assert lines[-1] == "         7 overruns  4 not sent  2 rejected  9 foreign"
    assert "0 foreign" not in text_of(STATUS)


def test_a_gate_with_one_drive_has_one_current():
    assert lines_of(STATUS, VIEW._replace(drives=1))[2] == "motors   1.50 A"


def test_the_panel_fits_into_forty_columns():
    worse = STATUS._replace(command_age_s=None, rejected=200, foreign=9, overruns=7)
    text = text_of(worse, width=39)
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= 39
    assert "━" in text


@pytest.mark.parametrize("width", [1, 3, 9, 10, 20, 30, 63, 64, 200])
def test_the_panel_has_the_same_number_of_lines_at_any_width(width):
    lines = lines_of(STATUS, width=width)
    assert len(lines) == 5
    assert max(map(len, lines)) <= width
