"""Progress of a suite of scenarios: shown on a terminal only."""

from __future__ import annotations

import pickle
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pseudo_terminal import as_stderr, at_once

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.terminal.suite_teller import QuietListener, SuiteTeller
from liftgate_hil.cli.terminal.teller import Teller

PASSES = 'duration = 0.05\n[[expect]]\nname = "rests"\nalways = "gate_angle_deg < 1"\n'
FAILS = PASSES.replace("< 1", "> 1")


def suite(*flags: str) -> int:
    """Run a suite of three scenarios, of which b.toml fails, and return the exit code."""
    for name, content in (("a", PASSES), ("b", FAILS), ("c", PASSES)):
        Path(f"{name}.toml").write_text(content)
    return main(["test", "a.toml", "b.toml", "c.toml", "--jobs", "1", *flags])


def test_a_terminal_shows_the_progress_of_the_suite(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    at_once(monkeypatch)
    with as_stderr(monkeypatch) as terminal:
        assert suite() == 1
        states = [picture[-1] for picture in terminal.pictures() if picture[-2].startswith("scenarios")]
        assert list(dict.fromkeys(states)) == [
            "0/3 done  1 running: a.toml",
            "1/3 done",
            "1/3 done  1 running: b.toml",
            "2/3 done  1 failed",
            "2/3 done  1 failed  1 running: c.toml",
            "3/3 done  1 failed",
        ]
        assert terminal.lines() == []  # nothing is left of it


def test_a_short_suite_shows_no_progress(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("liftgate_hil.cli.terminal.progress.AFTER_S", 1e9)
    with as_stderr(monkeypatch) as terminal:
        assert suite() == 1
        assert terminal.raw() == ""


@pytest.mark.parametrize("flags", [(), ("--quiet",), ("--json", "-")])
def test_no_progress_is_written_to_a_pipe(
    flags: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    at_once(monkeypatch)
    assert suite(*flags) == 1
    shown = capsys.readouterr()
    assert [each for each in shown.err.splitlines() if not each.startswith(("compiling", "ready"))] == []
    assert "\r" not in shown.out + shown.err
    assert "\x1b" not in shown.out + shown.err


@pytest.mark.parametrize("flags", [("--quiet",), ("--json", "-")])
def test_quiet_and_json_suppress_the_progress(
    flags: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    at_once(monkeypatch)
    with as_stderr(monkeypatch) as terminal:
        assert suite(*flags) == 1
        assert terminal.raw() == ""


def test_progress_waits_while_results_are_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    at_once(monkeypatch)
    with as_stderr(monkeypatch) as terminal:
        teller = Teller(is_quiet=False)
        heard = SuiteTeller(teller, StopSignals(), is_quiet=False, is_silent=False)
        heard.phase("scenarios")
        case: Any = SimpleNamespace(file="a.toml")
        heard.began(case)
        with teller.aside():
            other = threading.Thread(target=heard.began, args=(case,))
            other.start()
            other.join(0.05)
            assert terminal.lines() == []  # the progress is away
        other.join()
        assert terminal.lines()[-1].endswith("2 running: a.toml, a.toml")


def test_the_listener_of_one_run_of_a_suite_reports_compilation_but_not_its_start() -> None:
    said: list[str] = []

    class Hears(Teller):
        def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
            said.append(name)

    listener = pickle.loads(pickle.dumps(QuietListener(Teller(is_quiet=True))))
    listener.compiles("the loop", 1.0)
    listener = QuietListener(Hears(is_quiet=False))
    listener.compiles("compiling the loop", 1.0)
    listener.starts("suv without a bus")
    assert said == ["compiling the loop"]


def test_the_progress_line_counts_verdicts_other_than_pass_and_names_running_scenarios() -> None:
    rig, vehicle = lh.load_rig("liftgate"), lh.load_vehicle("suv")
    heard = SuiteTeller(Teller(is_quiet=True), StopSignals(), is_quiet=True, is_silent=True)

    def case(name: str) -> Any:
        request = SimpleNamespace(clock="free")
        plan = SimpleNamespace(
            rig=rig, setup=SimpleNamespace(vehicle=vehicle), request=SimpleNamespace(rate=1000.0)
        )
        return SimpleNamespace(file=f"suite/{name}.toml", plan=plan, job=SimpleNamespace(request=request))

    heard.prepared([case(name) for name in "abcde"])

    for name in ("a", "b", "c"):
        heard.began(case(name))
    for name, verdict in (("a", "inconclusive"), ("c", "error")):
        heard.ended(SimpleNamespace(case=case(name), verdict=verdict))  # type: ignore[arg-type]
    assert heard.line() == "2/5 done  1 with errors  1 inconclusive  1 running: b.toml"
