"""Stages of `make test` and of CI: which run, and the report at the end."""

from __future__ import annotations

import itertools
import os
import re
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tools import stages

Told = Callable[[str], tuple[int, str]]
# A stand-in for make: the stage's name says how it ends.
MAKE = """#!/bin/sh
echo "vcan: $VCAN"
case "$2" in
    bad)
        echo "FAILED tests/x.py::test_y - AssertionError"
        echo "=== 1 failed, 3 passed in 2.50s (0:00:02) ==="
        exit 2;;
    good) echo "======= 4 passed in 1.00s =======";;
    leaves) sleep 20 & ;;
    chatters) (for each in $(seq 200); do echo x; sleep 0.05; done) & ;;
    closes) exec >&- 2>&-; exec sleep 60;;
    slow) printf 'gr\\303'; sleep 0.3; printf '\\274\\303\\237\\n';;
    hangs*) echo begun; sleep 60;;
esac
"""


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    program = tmp_path / "make"
    program.write_text(MAKE)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    for name in ("VCAN", "LEAVE_A_CPU_WHILE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(stages, "LOGS", tmp_path / "logs")
    monkeypatch.setattr(stages, "PLANS", {"test": (("good",), ("other", "bad")), "ci": (("good",),)})
    return tmp_path


@pytest.fixture
def told(bench: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Told:
    """Run a plan and return its exit code and its output, without the durations."""

    def run(plan: str) -> tuple[int, str]:
        monkeypatch.setattr("sys.argv", ["stages", plan])
        code = stages.main()
        return code, re.sub(r"\d+\.\d s|after \d+ s", "T", capsys.readouterr().out)

    return run


def lines_of(text: str) -> list[str]:
    """Lines with one space in place of several."""
    return [" ".join(each.split()) for each in text.splitlines()]


def test_the_final_report_lists_the_stages_that_ran_and_failed(bench: Path, told: Told) -> None:
    code, out = told("test")
    assert code == 1
    assert out.startswith("vcan: optional\n======= 4 passed in 1.00s =======\n----- other\n")
    assert lines_of(out.partition("----- what ran, how long, what failed\n")[2]) == [
        "good passed T 4 passed",
        "other passed T",
        "bad FAILED (2) T 1 failed, 3 passed",
        "FAILED tests/x.py::test_y - AssertionError",
        "FAILED: bad, T",
    ]
    assert (bench / "logs" / "bad.log").read_text().count("\n") == 3


def test_a_stage_waits_for_those_that_it_needs_in_other_lanes(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where those failed; stages that are in no lane are not waited for."""
    run_stage, order = stages.run_stage, []

    def noted(stage: str, *others: Any) -> stages.Outcome:
        order.append(f"{stage} begins")
        found = run_stage(stage, *others)
        order.append(f"{stage} ends")
        return found

    monkeypatch.setattr(stages, "run_stage", noted)
    monkeypatch.setattr(stages, "NEEDS", {"good": ("bad", "nowhere")})
    assert told("test")[0] == 1
    assert order.index("bad ends") < order.index("good begins")


def test_the_other_stages_can_see_by_a_file_whether_a_timed_stage_is_running(
    bench: Path, told: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    look = 'echo "$2 is told $LEAVE_A_CPU_WHILE"; ls "$LOGS"\n'
    (bench / "make").write_text(f"#!/bin/sh\n{look}")
    monkeypatch.setenv("LOGS", str(bench / "logs"))
    monkeypatch.setattr(stages, "TIMED", ("timed-one",))
    monkeypatch.setattr(stages, "PLANS", {"test": (("timed-one", "other"),), "ci": ()})
    code, out = told("test")
    first, _, second = out.partition("other is told ")
    assert code == 0
    assert first == "timed-one is told \ntimed\ntimed-one.log\n"
    assert second.startswith(f"{bench}/logs/timed\nother.log\ntimed-one.log\n")


def test_the_users_setting_of_vcan_is_obeyed(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VCAN", "required")
    code, out = told("ci")
    assert code == 0
    assert out.startswith("vcan: required\n")
    assert out.endswith("\nall passed, T\n")


@pytest.mark.parametrize("stage", ["hangs", "closes"])
def test_a_stage_that_hangs_is_ended_and_reported(told: Told, monkeypatch: pytest.MonkeyPatch, stage: str) -> None:
    monkeypatch.setattr(stages, "PLANS", {"test": ((stage,), ("good",)), "ci": ()})
    monkeypatch.setattr(stages, "_PATIENCE_S", 1.0)
    code, out = told("test")
    assert code == 1
    assert lines_of(out)[-3:] == [
        f"{stage} FAILED (-15) T was ended",
        "good passed T 4 passed",
        f"FAILED: {stage}, T",
    ]


@pytest.mark.parametrize("stage", ["leaves", "chatters"])
def test_processes_left_by_a_stage_are_not_waited_for(
    told: Told, monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    monkeypatch.setattr(stages, "PLANS", {"test": ((stage,),), "ci": ()})
    monkeypatch.setattr(stages, "_PATIENCE_S", 8.0)
    code, out = told("test")
    assert (code, lines_of(out)[-2]) == (0, f"{stage} passed T")


def test_a_stage_that_cannot_start_is_reported_and_not_waited_for(
    bench: Path, told: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stages, "NEEDS", {"good": ("other",)})
    monkeypatch.setenv("PATH", str(bench / "nowhere"))
    code, out = told("test")
    assert code == 1
    assert out.count("No such file or directory: 'make'") == 3


def test_split_characters_of_an_output_are_shown_correctly(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stage prints half of the bytes of a character, and later the rest."""
    monkeypatch.setattr(stages, "PLANS", {"test": (("slow",),), "ci": ()})
    assert "gr\u00fc\u00df\n" in told("test")[1]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_stop_ends_all_lanes_and_lists_the_stages_not_run(
    bench: Path, told: Told, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """The signal comes twice, while two stages run and others wait."""
    monkeypatch.setattr(stages, "PLANS", {"test": (("hangs",), ("hangs-too", "good"), ("other",)), "ci": ()})
    monkeypatch.setattr(stages, "NEEDS", {"other": ("good",)})

    def tell_twice() -> None:
        for _ in range(2):
            os.kill(os.getpid(), number)

    threading.Timer(1.0, tell_twice).start()
    handlers = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        code, out = told("test")
    finally:
        for each, handler in handlers.items():
            signal.signal(each, handler)
    assert code == 130
    assert lines_of(out)[-6:] == [
        "hangs FAILED (-15) T was ended",
        "hangs-too FAILED (-15) T was ended",
        "good FAILED (1) T has not begun",
        "other FAILED (1) T has not begun",
        "FAILED: hangs, hangs-too, good, other, T",
        "stopped",
    ]
    assert not (bench / "logs" / "good.log").exists()


def test_each_stage_is_a_target_and_all_tests_are_in_ci() -> None:
    makefile = (stages.ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([\w-]+):", makefile, re.MULTILINE))
    run = {plan: [stage for lane in lanes for stage in lane] for plan, lanes in stages.PLANS.items()}
    assert {*stages.NEEDS, *itertools.chain.from_iterable(stages.NEEDS.values())} <= set(run["ci"])
    assert set(run["ci"]) <= targets
    assert set(run["test"]) <= set(run["ci"])
    assert {"test-main", "test-realtime", "test-browser", "test-vcan", "test-package"} <= set(run["ci"])
    assert all(len(found) == len(set(found)) for found in run.values())
