"""Scenarios started from a page, with a stand-in for the client of a run that is being compiled."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest
from hil_support import wait_for
from json_paths import written

from liftgate_hil.dashboard.page_state import Startable
from liftgate_hil.dashboard.starting import Starter
from liftgate_hil.described_result import keys_of
from liftgate_hil.errors import ConfigError, RunGoneError


class NeverReady:
    """A stand-in for the client of a run that is still being compiled."""

    def __init__(self, pid: int) -> None:
        raise ConfigError("it has not begun")


@pytest.fixture
def starter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Starter:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("liftgate_hil.dashboard.starting.Client", NeverReady)
    (tmp_path / "a.toml").write_text("")
    return Starter(tmp_path, ["--bus", f"virtual:starting-{time.monotonic_ns()}", "--overrun-limit", "60"])


def starts(starter: Starter, said: list[str]) -> threading.Thread:
    def start() -> None:
        try:
            starter.start("a.toml")
        except RunGoneError as error:
            said.append(str(error))

    thread = threading.Thread(target=start)
    thread.start()
    wait_for(lambda: starter.running is not None)
    return thread


def test_a_second_start_is_refused_while_the_first_one_compiles(starter: Starter) -> None:
    said: list[str] = []
    thread = starts(starter, said)
    with pytest.raises(ConfigError, match="another one is starting"):
        starter.start("a.toml")
    starter.stop()
    thread.join(30)
    assert said == ["a.toml was stopped before it began"]
    assert starter.running is None


def test_no_run_starts_after_the_dashboard_was_closed(starter: Starter) -> None:
    said: list[str] = []
    thread = starts(starter, said)
    starter.close()
    thread.join(30)
    with pytest.raises(ConfigError, match="the page ends"):
        starter.start("a.toml")
    assert starter.running is None


def test_a_run_that_does_not_begin_is_reported_with_the_reason(starter: Starter, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("nonsense = 1")
    with pytest.raises(RunGoneError, match=r"a.toml did not begin \(exit code 2\): .*nonsense"):
        starter.start("a.toml")


def test_entries_of_startable_scenarios_have_the_documented_keys(starter: Starter) -> None:
    keys = keys_of(Startable)
    assert {*written(starter.state(), keys)} == {*keys}


class Ended:
    """A stand-in for the client of a run that has begun."""

    def __init__(self, pid: int) -> None:
        self.pid = pid


def test_the_last_verdict_is_kept_for_each_scenario(
    starter: Starter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("liftgate_hil.dashboard.starting.Client", Ended)
    (tmp_path / "b.toml").write_text("")

    def verdicts() -> list[str]:
        return [each["verdict"] for each in starter.state()["scenarios"]]

    assert verdicts() == ["", ""]
    pid = starter.start("b.toml").pid
    starter.note_end(
        pid + 1, {"verdict": "error", "ending": "error", "expectations": []}
    )  # another run, which the page showed
    assert verdicts() == ["", ""]
    starter.note_end(pid, {"verdict": "fail", "ending": "fail", "expectations": [{}]})
    assert verdicts() == ["", "fail"]
    starter.note_end(pid, {"verdict": "inconclusive", "ending": "stopped", "expectations": [{}]})
    assert verdicts() == ["", "stopped"]
    starter.note_end(pid, {"verdict": "pass", "ending": "pass", "expectations": []})  # nothing was expected
    assert verdicts() == ["", ""]
    starter.close()
