"""The demo judges the ECU, ours or a foreign one, and writes only the files that were requested."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import c_ecu
import numpy as np
import pytest
from c_library import build, needs_compiler

from liftgate_compiler import GivenUpError
from liftgate_hil.cli.demo import _Demo
from liftgate_hil.cli.main import main
from liftgate_hil.cli.terminal.teller import Teller
from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.config.shipped import find_config
from liftgate_hil.dashboard.listening import new_token
from liftgate_hil.drive.ecu_process import EcuProcess
from liftgate_hil.drive.result import Result
from liftgate_hil.ecu.events import STARTS_OPENING, TRAPPED_CLOSING, Event
from liftgate_hil.errors import EcuError
from liftgate_hil.judging.verdict import Verdict
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.plan.request import RunRequest
from liftgate_hil.plan.setup import scenario_from
from liftgate_hil.report.pinch import pinch_event
from liftgate_hil.testing.demo import busy_with, failures

TEXT = """
import os


class Silent:
    def step(self, now_s, frames):
        return []


class Stops(Silent):
    def step(self, now_s, frames):
        if now_s > 1.0:
            os.kill(int(os.environ["CALLER"]), int(os.environ.pop("SIGNAL", "0")))
        return []


class Raises:
    def step(self, now_s, frames):
        raise ValueError("not today")
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder of the demo, with a module of ECUs beside it."""
    (tmp_path / "demo_ecus.py").write_text(TEXT)
    monkeypatch.syspath_prepend(str(tmp_path))
    place = tmp_path / "here"
    place.mkdir()
    monkeypatch.chdir(place)
    return place


def demo(*arguments: str) -> int:
    return main(["demo", "--clock", "free", *arguments])


# What a demo must show.

SHOWN_TIMES = np.arange(0.0, 42.0, 0.01)


def shown(force: float = 141.7, **changes: Any) -> Result:
    """Return the outcome of a passing demo with some values replaced."""
    times = SHOWN_TIMES
    angles = np.interp(times, [0, 10, 14, 19, 21, 26, 29, 41], [0, 80, 80, 34, 56, 80, 80, 0])
    columns = {
        "time_s": times,
        "gate_angle_deg": angles,
        "gate_rate_degps": np.gradient(angles, times),
        "pinch_force_n": np.interp(times, [18.7, 19.0, 19.3], [0.0, force, 0.0]),
        "latched": np.where(angles > 0, 0.0, 1.0),
    }
    given: dict[str, Any] = {
        "verdict": "pass",
        "reason": "",
        "maxima": {},
        "minima": {},
        "summary": Summary(ticks=42_001, model_time_s=42.001),
        "events": [
            Event(0.5, STARTS_OPENING, "opening"),
            Event(18.8, TRAPPED_CLOSING, "trapped while closing (…): reversing"),
        ],
        "trace": columns,
    }
    return Result(**{**given, **changes})


def columns_with(**changed: Any) -> dict[str, Any]:
    return {**shown().trace, **changed}


RATES = shown().trace["gate_rate_degps"]


def faults(result: Result, is_ours: bool = True) -> list[str]:
    return failures(result, pinch_event(result.trace), is_ours)


def test_a_passing_demo_has_no_failures() -> None:
    assert faults(shown()) == []
    # An ECU that is not ours reports no events.
    assert faults(shown(events=[]), is_ours=False) == []


def timed_out(count: int, clock: str = "realtime") -> Summary:
    """Return the summary of a run in which commands timed out."""
    return Summary(clock=clock, ticks=42_001, command_timeouts=count)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"force": 0.0}, "the gate never met the obstacle"),
        ({"force": 512.34}, "pinch force 512.3 N; allowed: up to 400 N (EN 12453, building doors)"),
        (
            {"trace": columns_with(pinch_force_n=np.where(abs(SHOWN_TIMES - 19.0) < 0.495, 200, 0))},
            "pinch force over 150 N for 0.990 s; allowed: up to 0.75 s (EN 12453, building doors)",
        ),
        ({"events": [Event(0.5, STARTS_OPENING, "opening")]}, "the ECU did not detect the obstacle"),
        ({"trace": columns_with(gate_rate_degps=np.full(4200, -1.0))}, "the gate did not reverse"),
        (
            {"trace": columns_with(gate_rate_degps=np.where(SHOWN_TIMES < 19.4, RATES, 0.0))},
            "the gate reversed, but moved back by 4.4 deg only; allowed: more than 5 deg",
        ),
        (
            {"trace": columns_with(latched=np.zeros(4200))},
            "the gate did not close and latch at the end (it stands at 0.0 deg)",
        ),
        ({"summary": timed_out(3, "free")}, "3 command time-outs: the ECU was too late"),
        ({"summary": timed_out(1, "free")}, "1 command time-out: the ECU was too late"),
        (
            {"verdict": "fail", "reason": "closes and latches: false at the end"},
            "closes and latches: false at the end",
        ),
    ],
)
def test_each_deviation_from_a_passing_demo_is_reported(changes: dict[str, Any], expected: str) -> None:
    assert faults(shown(**changes)) == [expected]


LATE = "the bench was late: 212 ticks were missed at about 13.200 s"
DOUBTFUL = {"reverses": Verdict("reverses", "inconclusive", reason="not known")}
FAILED: dict[str, Any] = {"force": 0.0}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, ""),
        (FAILED, ""),  # the bench was in time: it counts
        ({"late": LATE}, ""),  # and nothing depends on it
        ({"late": LATE, **FAILED}, "212 ticks were missed at about 13.200 s"),
        ({"late": LATE, "expectations": DOUBTFUL}, "212 ticks were missed at about 13.200 s"),
        ({"expectations": DOUBTFUL}, "reverses: not known"),
        ({"summary": timed_out(4)}, ""),
        ({"late": LATE, "summary": Summary(clock="free"), **FAILED}, ""),
    ],
)
def test_an_inconclusive_expectation_or_a_failure_of_a_late_run_counts_as_a_busy_machine(
    changes: dict[str, Any], said: str
) -> None:
    assert busy_with(shown(**changes), is_ours=True) == said


def test_command_time_outs_in_real_time_count_only_for_a_foreign_ecu() -> None:
    late = shown(summary=timed_out(2))
    assert faults(late) == []
    assert faults(late, is_ours=False) == ["2 command time-outs: the ECU was too late"]


def test_a_foreign_ecu_on_a_late_machine_is_judged_where_its_verdicts_are_certain() -> None:
    assert busy_with(shown(summary=Summary(command_timeouts=4)), is_ours=False) == ""
    assert busy_with(shown(late=LATE, **FAILED), is_ours=False) == ""
    assert busy_with(shown(late=LATE, expectations=DOUBTFUL), is_ours=False) != ""


@pytest.mark.realtime
def test_on_a_machine_too_busy_for_real_time_the_demo_repeats_on_the_free_clock(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run ends where the loop is held up for 0.3 s, in a motion, or earlier if the machine held it up.

    What the ECU does after that is not shown; on a busy machine it may have stopped before, but not reversed.
    """
    from liftgate_hil.loop import realtime_run

    ours = realtime_run._Turns.give

    def give(turns: Any, now_ns: int) -> None:
        if 30_500_000_000 < now_ns < 30_800_000_000:  # the precondition takes 21 s of these
            time.sleep(0.3)
        ours(turns, now_ns)

    monkeypatch.setattr(realtime_run._Turns, "give", give)
    assert main(["demo", "--clock", "realtime"]) == 0
    told = capsys.readouterr()
    before, _, after = told.err.partition("liftgate-hil demo: this machine was too busy for real time: ")
    assert re.match(r"(the loop stalled for|\d+ ticks were missed) .*\bat about \d\.\d+ s", after), told.err
    events = [line.split(None, 3)[3] for line in before.splitlines() if line.startswith("ecu ")]
    assert events[:1] in ([], ["opening"])
    assert not any("reversing" in each for each in events)
    assert "ecu " not in after
    assert "failed" not in told.err
    assert told.out.count("closed and latched") == 1
    assert (folder / "demo.png").is_file()


def test_the_page_shows_the_recording_of_the_repeated_run_at_the_same_address(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    served: list[Any] = []
    monkeypatch.delenv("LIFTGATE_HIL_TOKEN", raising=False)

    def clocked(self: _Demo, request: RunRequest, page: object) -> Any:
        return shown(summary=Summary(clock=request.clock))

    monkeypatch.setattr(_Demo, "_shown", clocked)
    monkeypatch.setattr(_Demo, "_present", lambda *_: None)
    monkeypatch.setattr("liftgate_hil.testing.demo.busy_with", lambda *_: "it was late")
    monkeypatch.setattr("liftgate_hil.cli.dashboard.serve_page", served.append)
    given = ["--output", "here", "--dashboard", "--listen", "127.0.0.1:8899", "--read-only"]
    try:
        assert main(["demo", *given]) == 0
        token = new_token()
    finally:
        os.environ.pop("LIFTGATE_HIL_TOKEN", None)
    (page,) = served
    assert (page.recording, page.listen, page.read_only) == ("here/demo.csv", "127.0.0.1:8899", True)
    assert page.vehicle == "suv"
    assert len(token) > 16


def test_all_failures_are_reported_at_once() -> None:
    nothing = columns_with(gate_angle_deg=np.zeros(4200), latched=np.zeros(4200))
    nothing["pinch_force_n"] = np.zeros(4200)
    assert len(faults(shown(events=[], trace=nothing))) == 4


@pytest.mark.parametrize(
    ("received", "cause"),
    [
        ({}, "no command arrived: the ECU sent nothing"),
        ({"accepted": 5}, "5 commands accepted, and no drive moved"),
        ({"checksum": 4, "foreign": 3}, "no command was accepted, 4 were rejected"),
        ({"foreign": 3}, "no command was accepted, 3 frames have identifiers that the rig does not receive"),
    ],
)
def test_the_cause_of_a_gate_that_never_moved_is_reported_first(received: dict[str, int], cause: str) -> None:
    still = columns_with(gate_angle_deg=np.zeros(4200), pinch_force_n=np.zeros(4200))
    summary = Summary(ticks=42_001, received=NO_COUNTS._replace(**received))
    found = faults(shown(trace=still, summary=summary), is_ours=False)
    assert found == [cause, "the gate never met the obstacle"]


# The whole of it.


def test_with_the_reference_ecu_the_demo_passes_and_writes_recordings_and_a_picture(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert demo() == 0
    told = capsys.readouterr()
    assert "reversing" in told.out
    (force,) = re.findall(r"^pinch force at most ([\d.]+) N, at 1[78]\.", told.out, re.MULTILINE)
    assert 50.0 < float(force) < 100.0
    assert f"(borrowed from EN 12453, building doors): {400.0 - float(force):.1f} N left" in told.out
    assert re.search(r"reversed \d\d ms after the first touch", told.out)
    assert "closed and latched" in told.out
    assert told.out.splitlines()[-1].startswith("the demo has passed: ")
    assert "failed" not in told.err
    assert sorted(path.name for path in folder.iterdir()) == ["demo.csv", "demo.log", "demo.png"]
    assert (folder / "demo.png").read_bytes().startswith(b"\x89PNG")


def test_with_no_record_the_demo_writes_no_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert demo("--no-record") == 0
    assert list(folder.iterdir()) == []
    assert "written" not in capsys.readouterr().out


def test_a_missing_output_folder_is_created(folder: Path) -> None:
    assert demo("--duration", "0.1", "--output", "new/one") == 0
    found = sorted(path.name for path in (folder / "new/one").iterdir())
    assert found == ["demo.csv", "demo.log", "demo.png"]


def test_an_impossible_output_folder_is_reported(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "taken").write_text("a file")
    assert demo("--output", "taken/new") == 2
    assert "--output taken/new: cannot be created: Not a directory" in capsys.readouterr().err


def test_explicit_recordings_are_written_despite_no_record(folder: Path) -> None:
    assert demo("--no-record", "--duration", "0.1", "--record", "mine.csv") == 0
    assert [path.name for path in folder.iterdir()] == ["mine.csv"]


@pytest.mark.parametrize("clock", ["free", "realtime"])
def test_a_precondition_that_does_not_end_is_reported_and_inconclusive(
    folder: Path, capsys: pytest.CaptureFixture[str], clock: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("liftgate_hil.loop.precondition.LONGEST_MOTION", 0.5)
    assert main(["demo", "--no-record", "--clock", clock]) == 3
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("liftgate-hil: precondition: open: the gate still moves, or a drive is ")


def test_an_ecu_that_never_opens_the_gate_fails_the_demo(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert demo("--ecu", "demo_ecus:Silent", "--no-record") == 1
    lines = capsys.readouterr().err.splitlines()
    assert "liftgate-hil demo: failed: the gate never met the obstacle" in lines


def test_an_ecu_that_misses_the_obstacle_fails_the_demo(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # What the ECU sees of the current is nothing, and of the speed what counts tell.
    rig = folder / "deaf.toml"
    lines = find_config("rigs", "liftgate").read_text().splitlines()
    lines = [each for each in lines if not each.startswith(("left_period", "right_period"))]
    rig.write_text("\n".join(lines))
    assert demo("--no-record", "--rig", str(rig), "--set", "sensors.current_gain=0") == 1
    assert "liftgate-hil demo: failed: " in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--duration", "1"], ["--scenario", "other.toml"]])
def test_a_shortened_demo_and_another_scenario_are_not_judged(folder: Path, arguments: list[str]) -> None:
    (folder / "other.toml").write_text("duration = 1.0\n")
    assert demo("--ecu", "demo_ecus:Silent", "--no-record", *arguments) == 0


@pytest.mark.parametrize(
    ("expectation", "of_run", "of_demo"),
    [
        ('never = "gate_angle_deg > 1000"', 0, 0),
        ('eventually = "gate_angle_deg > 1000"', 0, 1),
        ('after = "gate_angle_deg > 1000"\nnever = "left_current_a > 1"', 0, 3),
    ],
)
def test_failed_expectations_change_the_exit_code_of_demo_but_not_of_run(
    folder: Path, expectation: str, of_run: int, of_demo: int
) -> None:
    (folder / "other.toml").write_text(f'duration = 0.1\n[[expect]]\nname = "one"\n{expectation}\n')
    bench = ("--scenario", "other.toml", "--quiet", "--clock", "free")
    assert main(["run", "--bus", "virtual:codes", *bench]) == of_run
    assert main(["demo", "--no-record", *bench]) == of_demo


def test_an_exception_of_the_ecu_is_reported(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert demo("--ecu", "demo_ecus:Raises", "--no-record") == 1
    (line,) = (each for each in capsys.readouterr().err.splitlines() if "ValueError" in each)
    assert line.startswith("liftgate-hil: the ECU at 0.000 s: ValueError: not today (demo_ecus.py")


def test_an_exception_in_a_python_library_is_reported_with_the_ecus_own_line(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("../beside.py").write_text(
        "import json\n\n\nclass Ecu:\n    def step(self, now_s, frames):\n        return json.loads('no')\n"
    )
    assert demo("--ecu", "beside:Ecu", "--no-record") == 1
    (line,) = (each for each in capsys.readouterr().err.splitlines() if "JSONDecodeError" in each)
    assert line.endswith("(beside.py, line 6)")


@c_ecu.needs_compiler
def test_a_c_library_passes_and_is_listed_among_the_sources(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    library = c_ecu.build_library(tmp_path)
    assert demo("--ecu", str(library), "--no-record", "--json") == 0
    source = json.loads(capsys.readouterr().out)["provenance"]["sources"]["ecu"]
    assert source["path"] == str(library)
    assert source["sha256"] == hashlib.sha256(library.read_bytes()).hexdigest()
    assert main(["--clock", "free", "--ecu", str(library), "--duration", "3"]) == 0
    assert "commands accepted 300," in capsys.readouterr().out


@needs_compiler
@pytest.mark.parametrize("clock", ["free", "lockstep", "realtime"])
def test_a_crash_of_a_c_library_ends_the_demo_and_not_its_caller(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], clock: str
) -> None:
    source = """
    #include "liftgate_ecu.h"
    #include <stdlib.h>
    void *liftgate_ecu_create(void) { static int it; return &it; }
    void liftgate_ecu_destroy(void *ecu) { (void)ecu; }
    int liftgate_ecu_step(void *ecu, int64_t now_ns, const struct liftgate_frame *in, int count,
                          struct liftgate_frame *out, int capacity)
    {
        (void)ecu, (void)in, (void)count, (void)out, (void)capacity;
        if (now_ns > 100000000) abort();
        return 0;
    }
    """
    library = str(build(tmp_path, source))
    assert demo("--ecu", library, "--no-record", "--clock", clock) == 1
    time = r"\d\.\d{3}" if clock == "realtime" else r"0\.101"
    told = capsys.readouterr().err
    assert re.search(rf"liftgate-hil: the ECU at {time} s: its process ended \(SIGABRT\)", told)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_demo_says_so_and_keeps_its_recordings_so_far(
    folder: Path, capsys: pytest.CaptureFixture[str], number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SIGNAL", str(number))
    monkeypatch.setenv("CALLER", str(os.getpid()))
    assert demo("--ecu", "demo_ecus:Stops") == 128 + number
    told = capsys.readouterr()
    (time,) = re.findall(r"liftgate-hil demo: stopped at ([\d.]+) s of 42 s", told.err)
    assert 1.0 < float(time) < 41.0
    assert "failed" not in told.err
    last = (folder / "demo.csv").read_text().splitlines()[-1]
    assert float(last.split(",")[0]) == pytest.approx(float(time), abs=0.002)
    assert (folder / "demo.png").is_file()


def test_a_demo_stopped_during_compilation_writes_no_picture(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def given_up(*_: object, **__: object) -> None:
        signal.raise_signal(signal.SIGTERM)
        raise GivenUpError

    monkeypatch.setattr("liftgate_hil.drive.run.adapter_for", given_up)
    assert demo() == 143
    assert "liftgate-hil demo: stopped at 0.000 s of 42 s" in capsys.readouterr().err
    assert not (folder / "demo.png").exists()


def test_the_json_of_a_stopped_demo_names_the_signal(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SIGNAL", str(int(signal.SIGTERM)))
    monkeypatch.setenv("CALLER", str(os.getpid()))
    assert demo("--ecu", "demo_ecus:Stops", "--json", "--no-record") == 143
    assert json.loads(capsys.readouterr().out)["stop_reason"] == "SIGTERM"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--ecu", "nonsense"], "--ecu nonsense: allowed: reference, the path of a shared library"),
        (["--ecu", "demo_ecus:Nobody"], "Nobody"),
        (["--ecu", "bus"], "--bus: missing; allowed: INTERFACE:CHANNEL of the bus with the ECU"),
    ],
)
def test_wrong_arguments_are_refused_and_write_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], told: str
) -> None:
    try:
        code = demo("--no-record", *arguments)
    except SystemExit as ended:  # argparse
        code = int(ended.code or 0)
    assert code == 2
    text = capsys.readouterr().err
    assert told in text
    assert "Traceback" not in text
    assert list(folder.iterdir()) == []


def test_notes_on_a_run_are_printed_and_in_the_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three runs, each of an ECU in a process of its own."""
    note = "requests without effect: open, close: the ECU has no request()"
    given = ["--ecu", "demo_ecus:Silent", "--no-record", "--duration", "30"]
    demo(*given)
    assert f"note: {note}\n" in capsys.readouterr().err
    demo(*given, "--json")
    told = capsys.readouterr()
    assert json.loads(told.out)["notes"] == [note]
    demo(*given, "--quiet")
    assert note not in capsys.readouterr().err


def test_the_json_has_the_summary_and_the_sources(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert demo("--json", "--no-record") == 0
    summary = json.loads(capsys.readouterr().out)
    # Three between cycles: it stops or turns back at once.
    assert 4200 <= summary["received"]["accepted"] <= 4204
    assert summary["command_timeouts"] == 0
    assert summary["stop_reason"] == "duration"
    assert summary["maxima"]["pinch_force_n"] == summary["pinch"]["peak_n"] > 50.0
    assert summary["minima"]["gate_angle_deg"] < 0.1
    origin = summary["provenance"]
    assert origin["command_line"] == "liftgate-hil demo --clock free --json --no-record"
    assert set(origin["sources"]) == {"vehicle", "rig", "dbc", "scenario", "included 1", "included 2"}


def test_the_json_is_reproducible_with_a_given_date(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    texts = set()
    for _ in range(2):
        demo("--json", "--no-record", "--duration", "1")
        texts.add(capsys.readouterr().out)
    (text,) = texts
    assert json.loads(text)["provenance"]["date"] == "2023-11-14T22:13:20+00:00"
    assert json.loads(text)["pinch"] is None


def test_the_seed_flag_determines_the_noise(folder: Path) -> None:
    texts = {}
    for seed in ("1", "2", "1"):
        noise = ["--set", "sensors.current_noise=0.1"]
        demo("--no-record", "--duration", "0.2", "--seed", seed, *noise, "--record", "run.csv")
        text = (folder / "run.csv").read_bytes()
        assert texts.setdefault(seed, text) == text
    assert texts["1"] != texts["2"]


def test_the_recording_is_the_same_on_the_free_and_lockstep_clocks(folder: Path) -> None:
    for clock in ("free", "lockstep"):
        arguments = ["--duration", "1", "--record", f"{clock}.csv", "--no-record", "--quiet"]
        assert main(["demo", "--clock", clock, *arguments]) == 0
    assert (folder / "free.csv").read_bytes() == (folder / "lockstep.csv").read_bytes()


def test_the_demo_scenario_lasts_42_seconds() -> None:
    assert scenario_from("demo").duration == 42.0


# The ECU as a process of its own, on a real bus.

ON_A_BUS = """
class Raises:
    def step(self, now_s, frames):
        if now_s > 0.3:
            raise ValueError("not today")
        return []
"""


@pytest.mark.parametrize(
    ("ecu", "code", "told"),
    [
        ("their_ecus:Nobody", 2, "the ECU's process: --ecu their_ecus:Nobody"),
        ("missing.so", 2, "liftgate-hil: --ecu missing.so: no such file"),
        ("their_ecus:Raises", 1, "ValueError: not today"),
    ],
)
def test_a_failing_ecu_process_ends_the_run_with_its_cause(
    folder: Path, capsys: pytest.CaptureFixture[str], ecu: str, code: int, told: str
) -> None:
    (folder / "their_ecus.py").write_text(ON_A_BUS)
    line = ["--bus", "udp_multicast:239.74.163.61", "--ecu", ecu, "--duration", "30", "--quiet"]
    assert main(line) == code
    said = capsys.readouterr().err
    assert told in said
    assert "requests, from the gate's first frame on" not in said  # what it printed before it failed


def test_the_summary_is_printed_although_the_ecu_process_fails(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "their_ecus.py").write_text(ON_A_BUS)
    line = ["--bus", "udp_multicast:239.74.163.61", "--ecu", "their_ecus:Raises", "--duration", "30", "--json"]
    assert main(line) == 1
    told = capsys.readouterr()
    assert 0 < json.loads(told.out)["ticks"] < 30_000
    failure = told.err.splitlines()[-1]
    assert failure.startswith("liftgate-hil: the ECU's process: the ECU at 0.")
    assert failure.endswith("ValueError: not today (their_ecus.py, line 5)")


def test_an_ecu_process_that_fails_while_it_is_stopped_counts_as_failed() -> None:
    code = (
        "import signal, sys, time\n"
        "def stop(*_):\n"
        "    print('liftgate-hil: the ECU at 1.000 s: no response (ecu.py, line 4)', file=sys.stderr)\n"
        "    sys.exit(143)\n"
        "signal.signal(signal.SIGTERM, stop)\n"
        "print('it hangs', file=sys.stderr, flush=True)\n"
        "time.sleep(600)\n"
    )
    said: list[str] = []
    listener: Any = SimpleNamespace(say=said.append)
    child = EcuProcess([sys.executable, "-c", code], listener, is_ours=False)
    until = time.monotonic() + 60.0
    while not said and time.monotonic() < until:
        time.sleep(0.01)
    with pytest.raises(
        EcuError, match=r"^the ECU's process: the ECU at 1\.000 s: no response \(ecu\.py, line 4\)$"
    ):
        child.end(was_stopped=True, has_taken_part=True)


def test_an_ecu_process_may_print_more_than_a_pipe_buffer_holds(capsys: pytest.CaptureFixture[str]) -> None:
    code = "import sys; sys.stderr.write('x' * 1_000_000 + '\\necu   1.250 s  opening\\n')"
    child = EcuProcess([sys.executable, "-c", code], Teller(is_quiet=False), is_ours=True)
    until = time.monotonic() + 60.0
    while not child.has_ended() and time.monotonic() < until:
        time.sleep(0.01)
    child.end(was_stopped=True, has_taken_part=True)
    assert [(event.time, event.text) for event in child.events] == [(1.25, "opening")]
    assert capsys.readouterr().err == "x" * 1_000_000 + "\necu   1.250 s  opening\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--record-limit", "5MB"], "--record-limit 5000000: allowed: together with --record"),
        (["--set", "gate.hinge=3"], "3 is not a point; allowed: [x, y], each of -10 to 10 m"),
        (["--ecu", f"{__name__}:NoStep"], f"--ecu {__name__}:NoStep: no step(); allowed: an object with step("),
    ],
)
def test_issues_name_flags_as_typed_on_the_command_line(
    arguments: list[str],
    said: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert demo("--no-record", *arguments) == 2
    assert said in capsys.readouterr().err


class NoStep:
    """A class that is no ECU as it has no method `step`."""


def test_machine_code_is_ready_before_the_ecu_process_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    order = []

    @contextlib.contextmanager
    def process(*_: object) -> Iterator[None]:
        order.append("process")
        raise EcuError("no further")
        yield

    monkeypatch.setattr(
        "liftgate_hil.drive.ecu_process.machine_code", lambda adapter: order.append("machine code")
    )
    monkeypatch.setattr("liftgate_hil.drive.ecu_process._ecu_process", process)
    assert main(["demo", "--bus", "udp_multicast:239.74.163.9", "--no-record", "--duration", "1"]) == 1
    assert order == ["machine code", "process"]


def test_a_scenario_without_expectations_is_reported_as_not_judged(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "mine.toml").write_text("duration = 0.1\n")
    assert main(["demo", "--clock", "free", "--no-record", "--scenario", "mine.toml"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "not judged: mine.toml states no expectations"


def test_a_folder_in_the_place_of_the_picture_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "demo.png").mkdir()
    assert demo("--output", str(tmp_path)) == 2
    assert "demo.png: is a folder" in capsys.readouterr().err
