"""Whole commands on a terminal: the screen while they run, and afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from pseudo_terminal import PseudoTerminal, as_stderr, at_once

from liftgate_hil.cli.main import main

PANEL = ["time", "gate", "motors", "command", "frames"]
RUN = ["demo", "--clock", "lockstep", "--duration", "1", "--no-record"]


def names_of(screen: list[str]) -> list[str]:
    """Return the names at the beginning of the last lines of a screen, if these are a panel."""
    return [line.split()[0] for line in screen[-5:] if line]


@pytest.fixture(autouse=True)
def _in_a_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("columns", [80, 40])
def test_a_run_has_a_panel_below_its_messages(
    columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("liftgate_hil.cli.terminal.teller._EVERY_S", 0.0)
    with as_stderr(monkeypatch, columns) as terminal:
        assert main(RUN) == 0
        pictures = [each for each in terminal.pictures() if names_of(each) == PANEL]
        assert pictures
        assert all(picture[-6] == "" for picture in pictures)
        last = pictures[-1]
        assert last[0].startswith("suv on virtual, 1000 Hz")
        assert "ecu   0.500 s  opening" in last
        assert max(map(len, last)) < columns
        assert ("closed" in last[-4]) == (columns == 80)
        assert terminal.lines() == last[:-6]  # the panel has gone, the messages stay
    assert "ticks 1001, model time 1.001 s" in capsys.readouterr().out


def test_a_run_continues_when_its_terminal_is_closed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from liftgate_hil.cli.terminal.teller import Teller

    with as_stderr(monkeypatch) as terminal:
        shown = Teller.status

        def last_sight(self: Teller, status: object) -> None:
            shown(self, status)  # type: ignore[arg-type]
            if terminal.is_there:
                assert names_of(terminal.lines()) == PANEL
                terminal.hang_up()

        monkeypatch.setattr(Teller, "status", last_sight)
        assert main(RUN) == 0
        assert not terminal.is_there
    assert "ticks 1001, model time 1.001 s" in capsys.readouterr().out


@pytest.mark.parametrize("term", ["dumb", "xterm"])
def test_without_a_capable_terminal_a_run_prints_plain_lines(
    term: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TERM", term)
    if term == "dumb":
        with as_stderr(monkeypatch, term=term) as terminal:
            assert main(RUN) == 0
            told = terminal.raw().replace("\r\n", "\n")
    else:
        assert main(RUN) == 0
        told = capsys.readouterr().err
    assert "ecu   0.500 s  opening\n" in told
    assert "\r" not in told
    assert "\x1b" not in told
    assert "frames" not in told


def test_ctrl_c_ends_a_run_and_leaves_its_messages_and_the_summary() -> None:
    terminal = PseudoTerminal(rows=40)
    command = [sys.executable, "-P", "-m", "liftgate_hil", "--interface", "virtual", "--channel", "ctrl-c"]
    run = subprocess.Popen(
        command,
        stdin=terminal.slave,
        stdout=terminal.slave,
        stderr=terminal.slave,
        env={**os.environ, "TERM": "xterm"},
        start_new_session=True,
        # It becomes the terminal of the session.
        preexec_fn=lambda: os.close(os.open(os.ttyname(0), os.O_RDWR)),  # noqa: PLW1509
    )
    try:
        terminal.wait_for_picture("no command")
        terminal.types(b"\x03")
        assert run.wait(60) == 0
    finally:
        run.kill()
        run.wait()
    lines = terminal.lines()
    assert lines[0].startswith("suv on ctrl-c")
    assert [line for line in lines if line.startswith("ticks ")]
    assert "closed" not in "".join(lines)
    assert "^C" not in "".join(lines)


def test_a_conversion_shows_its_progress(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    at_once(monkeypatch)
    assert main(["simulate", "--voltage", "5", "--duration", "2", "--output", "run.csv"]) == 0
    with as_stderr(monkeypatch) as terminal:
        assert main(["convert", "run.csv", "run.parquet"]) == 0
        seen = [picture[-2:] for picture in terminal.pictures()]
        assert seen[-1] == ["convert  0 s", "2001 rows, 0 frames"]
        assert terminal.lines() == []
    assert "run.parquet: 2001 rows" in capsys.readouterr().out
    capsys.readouterr()
    assert main(["convert", "run.csv", "again.parquet"]) == 0
    assert capsys.readouterr().err == ""


def test_a_simulation_shows_its_remaining_time(monkeypatch: pytest.MonkeyPatch) -> None:
    at_once(monkeypatch)
    with as_stderr(monkeypatch) as terminal:
        assert main(["simulate", "--voltage", "5", "--duration", "30", "--output", "run.csv"]) == 0
        seen = [picture[-2:] for picture in terminal.pictures()]
        assert seen[-1][0].startswith("simulate  ━")
        assert seen[-1][1] == "30.0 s of 30 s"


@pytest.mark.parametrize(
    "command",
    [
        ["compare", "run.csv", "run.csv"],
        ["plot", "run.csv", "--output", "run.png"],
        ["judge", "run.csv", "--scenario", "s.toml"],
        ["rig", "check", "liftgate"],
        ["validate", "run.csv"],
        ["doctor", "--duration", "0.1"],
        ["campaign", "s.toml", "--vary", "gate.mass=30,31", "--jobs", "1"],
    ],
    ids=lambda command: command[0],
)
def test_every_command_that_may_take_long_shows_progress(
    command: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each command begins and ends a progress display, whatever text it shows.

    The doctor waits 5 s for drivers to answer.
    """
    from liftgate_hil.cli.terminal.progress import ProgressDisplay

    Path("s.toml").write_text('duration = 0.05\n[[expect]]\nname = "rests"\nalways = "gate_angle_deg < 1"\n')
    assert main(["simulate", "--voltage", "5", "--duration", "1", "--output", "run.csv"]) == 0
    ended: list[str] = []
    closed = ProgressDisplay.close

    def close(self: ProgressDisplay) -> None:
        closed(self)
        ended.append(self._what)

    monkeypatch.setattr(ProgressDisplay, "close", close)
    at_once(monkeypatch)
    with as_stderr(monkeypatch) as terminal:
        main(command)
        assert ended
        assert not [line for line in terminal.lines() if "━" in line]
