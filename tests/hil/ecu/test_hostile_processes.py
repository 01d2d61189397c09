"""ECUs that damage their own process: the run ends with the cause, and the next run works.

Each of them as a C library or as a Python class; deadlines are short here. A clock's loop decides how an
exception of the ECU reaches the worker's answer, how a call that hangs is seen, and when the ECU is destroyed:
those are here on every clock. How a process has ended, stands still or does not exit is seen from outside of it,
on any clock alike: those are here on one each.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from test_bad_libraries import check_that_the_caller_lives_on, library, needs_compiler

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.drive.run import execute
from liftgate_hil.plan.plan import plan_of
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI

SCENARIO = Scenario(NO_STIMULI, (), 0.1)
CLOCKS = ("free", "lockstep", "realtime")
AT = "now_ns == 50000000"
NOT_EXITED = ("the ECU's process did not exit within 1 s after the run, and was killed",)

PYTHON = """
import atexit, os, re, signal, sys, threading, time
def hang(*_):
    while True:
        time.sleep(1)
class Base:
    period_s = 0.01
    def step(self, now_s, frames):
        if now_s > 0.045:
            self.act()
        return []
    def act(self): pass
class Ends(Base):
    def act(self): os._exit(3)
class EndsWell(Base):
    def act(self): os._exit(0)
class Interrupts(Base):
    def act(self): raise KeyboardInterrupt
class Exits(Base):
    def act(self): sys.exit(0)
class Hangs(Base):
    def act(self): hang()
class Stops(Base):
    def act(self): os.kill(os.getpid(), signal.SIGSTOP)
class ClosesAndHangs(Base):
    def act(self):
        os.closerange(0, 500)
        hang()
class Destroyed(Base):
    def __del__(self): hang()
class Thread(Base):
    def __init__(self): threading.Thread(target=hang).start()
class AtExit(Base):
    def __init__(self): atexit.register(hang)
class Property(Base):
    @property
    def period_s(self): raise ValueError("no such thing")
class Prints(Base):
    def act(self): print("its own words", flush=True)
class Writes(Base):
    def act(self):
        for each in range(3, 500):
            try: os.write(each, b"rubbish " * 20)
            except OSError: pass
class Closes(Base):
    def act(self): os.closerange(0, 500)
class Leaves(Base):
    def __init__(self):
        if not os.fork():
            os.setsid()
            if not os.fork():
                with open("child", "w") as stream: stream.write(str(os.getpid()))
                time.sleep(600)
            os._exit(0)
        while not (os.path.exists("child") and open("child").read()): time.sleep(0.01)
class KeepsTheLock(Base):
    def __init__(self):
        def keep():
            time.sleep(0.05)
            re.match(r"(a+)+$", "a" * 60 + "b")
        threading.Thread(target=keep, daemon=True).start()
class ClosesEarly(Base):
    def __init__(self): sys.stdout.close(); sys.stderr.close(); os.closerange(0, 500)
"""


@pytest.fixture(autouse=True)
def _short_deadlines(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("liftgate_hil.isolate.isolation.HANG_S", 1.0)
    monkeypatch.setattr("liftgate_hil.isolate.isolation.EXIT_S", 1.0)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hostile.py").write_text(PYTHON)


def be_patient(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Prolong a deadline, given by its name, so that a busy machine does not end a healthy ECU."""
    monkeypatch.setattr(f"liftgate_hil.isolate.isolation.{name}", 60.0)


def run_of_class(name: str, clock: str = "free") -> lh.Result:
    """Run SCENARIO with a class of hostile.py as ECU, in a process of its own."""
    return execute(plan_of(Job(RunRequest(SCENARIO, f"hostile:{name}", clock), is_isolated=True)))


def on(clocks: Sequence[str], *case: Any) -> list[Any]:
    """Return a test case for each of these clocks: the clock, then the values of `case`, whose first is a name."""
    return [pytest.param(clock, *case, id=f"{clock}-{case[0]}") for clock in clocks]


@pytest.mark.parametrize(
    ("clock", "name", "said"),
    [
        *on(["free"], "Ends", "its process ended (exit code 3)"),
        *on(["lockstep"], "EndsWell", "its process ended (exit code 0)"),
        *on(CLOCKS, "Interrupts", "KeyboardInterrupt (hostile.py, line "),
        *on(CLOCKS, "Exits", "SystemExit: 0 (hostile.py, line "),
        *on(CLOCKS, "Hangs", "no response for 1 s (hostile.py, line "),
        *on(["realtime"], "Stops", "no response for 1 s"),
        *on(["lockstep"], "ClosesAndHangs", "no response for 1 s"),
        *on(CLOCKS, "Destroyed", "no response for 1 s"),
        *on(["realtime"], "KeepsTheLock", "1 s"),  # one of its threads, whatever runs
    ],
)
def test_an_ecu_class_that_exits_or_hangs_is_an_error_with_its_cause(clock: str, name: str, said: str) -> None:
    result = run_of_class(name, clock)
    assert result.verdict == "error"
    assert result.reason.startswith("the ECU at 0.")
    assert said in result.reason
    check_that_the_caller_lives_on()


@pytest.mark.parametrize(
    ("clock", "name", "notes"),
    [("free", "Thread", NOT_EXITED), ("lockstep", "AtExit", NOT_EXITED), ("realtime", "Prints", ())],
)
def test_side_effects_of_an_ecu_class_do_not_change_the_verdict(
    clock: str, name: str, notes: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    be_patient(monkeypatch, "HANG_S")
    if not notes:
        be_patient(monkeypatch, "EXIT_S")
    result = run_of_class(name, clock)
    assert (result.verdict, result.reason, result.notes) == ("pass", "", notes)


@pytest.mark.parametrize("name", ["Writes", "Closes", "ClosesEarly"])
def test_an_ecu_class_that_closes_or_writes_to_all_descriptors_can_be_judged(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    be_patient(monkeypatch, "HANG_S")
    result = run_of_class(name)
    assert (result.verdict, result.reason) == ("pass", "")


@pytest.mark.parametrize(
    ("clock", "name"),
    [
        *on(["free", "realtime"], "Writes"),
        *on(["free", "realtime"], "Closes"),
        *on(["free"], "Hangs"),
        *on(["realtime"], "Ends"),
    ],
)
def test_the_recording_with_a_hostile_ecu_is_complete_or_its_loss_is_reported(
    clock: str, name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    record = tmp_path / "run.csv"
    request = RunRequest(SCENARIO, f"hostile:{name}", clock, record=record)
    result = execute(plan_of(Job(request, is_isolated=True)))
    rows = record.read_text(errors="replace").count("\n") if record.is_file() else 0
    assert rows > 100 or result.reason
    assert "Traceback" not in capfd.readouterr().err


def test_an_exception_in_a_property_of_an_ecu_class_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    Path("s.toml").write_text('duration = 0.1\n[[expect]]\nname = "rests"\nalways = "gate_angle_deg < 1"\n')
    assert main(["test", "s.toml", "--ecu", "hostile:Property"]) == 2
    said = "period_s: ValueError: no such thing (hostile.py, line "
    assert said in capsys.readouterr().out


def test_processes_started_by_an_ecu_end_with_its_run(monkeypatch: pytest.MonkeyPatch) -> None:
    be_patient(monkeypatch, "HANG_S")
    assert run_of_class("Leaves", "lockstep").verdict == "pass"
    child = int(Path("child").read_text())
    until = time.monotonic() + 20.0
    while Path(f"/proc/{child}").exists() and time.monotonic() < until:
        time.sleep(0.01)
    assert not Path(f"/proc/{child}").exists()


def test_output_printed_by_an_ecu_is_not_in_the_results(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    be_patient(monkeypatch, "HANG_S")
    assert run_of_class("Prints").verdict == "pass"
    said = capfd.readouterr()
    assert said.out == ""
    assert "its own words" in said.err


RUBBISH = 'for (int each = 3; each < 500; each++) { if (write(each, "rubbish", 7) < 0) continue; }'
CLOSED = "for (int each = 0; each < 500; each++) close(each);"


@needs_compiler
@pytest.mark.parametrize(
    ("clock", "name", "bodies", "verdict", "said"),
    [
        *on(["realtime"], "ends", {"step": f"if ({AT}) _exit(0);"}, "error", "its process ended (exit code 0)"),
        *on(
            ["free"],
            "closes and hangs",
            {"step": f"if ({AT}) {{ {CLOSED} for (;;) pause(); }}"},
            "error",
            "no response for 1 s",
        ),
        *on(["lockstep"], "stops", {"step": f"if ({AT}) raise(SIGSTOP);"}, "error", "no response for 1 s"),
        *on(
            CLOCKS, "hangs at its end", {"destroy": f"{CLOSED} for (;;) pause();"}, "error", "no response for 1 s"
        ),
        *on(["lockstep"], "prints", {"step": f'if ({AT}) write(1, "its own words", 13);'}, "pass", ""),
        *on(["free", "realtime"], "writes at its end", {"destroy": f"{RUBBISH}"}, "pass", ""),
        *on(["free", "realtime"], "closes at its end", {"destroy": f"{CLOSED}"}, "pass", ""),
    ],
)
def test_a_hostile_library_is_judged_or_reported_with_its_cause(
    tmp_path: Path,
    clock: str,
    name: str,
    bodies: dict[str, str],
    verdict: str,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if "no response" not in said:
        be_patient(monkeypatch, "HANG_S")
    time_given = {key: text.replace(AT, "now_ns >= 50000000") for key, text in bodies.items()}
    result = lh.run(SCENARIO, library(tmp_path, **time_given), clock)
    assert result.verdict == verdict, result.reason
    assert said in result.reason
    check_that_the_caller_lives_on()


@needs_compiler
def test_a_library_that_hangs_at_exit_is_still_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    be_patient(monkeypatch, "HANG_S")
    at_exit = "{ extern int atexit(void (*)(void)); atexit((void (*)(void))pause); }"
    result = lh.run(SCENARIO, library(tmp_path, create=at_exit))
    assert (result.verdict, result.notes) == ("pass", NOT_EXITED)


def test_a_stop_request_works_while_the_ecus_process_does_not_exit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("liftgate_hil.isolate.isolation.EXIT_S", 600.0)
    job = Job(RunRequest(SCENARIO, "hostile:Thread"), is_isolated=True)
    asked = []

    def stopped() -> bool:
        asked.append(time.monotonic())
        return len(asked) > 20

    result = execute(plan_of(job), stopped)
    assert result.verdict in ("pass", "error")
