"""C libraries that violate the ECU interface: the run ends with the cause, and its caller continues.

What is refused by a check of what it returned, and ends no process, runs in the test's own process, but for one
case each that shows that the answer of a run's process says the same.
"""

from __future__ import annotations

import dataclasses
import math
import pickle
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from c_library import build, needs_compiler, source_of

import liftgate_hil as lh
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.drive.run import run_plan
from liftgate_hil.ecu.find import is_library
from liftgate_hil.errors import ConfigError, EcuError
from liftgate_hil.isolate.isolation import run_isolated
from liftgate_hil.plan.plan import plan_of
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.plan.setup import rig_from, vehicle_from
from liftgate_hil.signals import COLUMNS
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI

pytestmark = needs_compiler

SCENARIO = Scenario(NO_STIMULI, (Request(Instant(0.02), "open"),), 0.1)
AT = "now_ns == 50000000"


def library(folder: Path, **bodies: str) -> Path:
    """Build an ECU library whose functions run these C bodies (see `source_of`); return its path."""
    return build(folder, source_of(**bodies))


def run_here(scenario: Scenario, path: Path, clock: str = "free") -> lh.Result:
    """Run a scenario in this process as a library's process does. Raises its errors, such as EcuError."""
    return run_plan(plan_of(Job(RunRequest(scenario, str(path), clock))), (), lambda: False)


def check_that_the_caller_lives_on() -> None:
    assert lh.run("demo", duration=0.1).verdict == "pass"


def frame(length: int, flags: int = 0, identifier: int = 0x400) -> str:
    """C code of a step that at AT sends a frame of this length, these flags and this identifier."""
    return (
        f"if ({AT}) {{ memset(out, 0, sizeof *out); out->id = {identifier}u; out->length = {length}; "
        f"out->flags = {flags}; return 1; }}"
    )


RETURNED = r"its step returned {}; allowed: 0 to 1024 frames"
NO_FRAME = (
    r"it wrote an invalid frame; allowed: a length of up to 8 bytes, with CAN FD 64; an identifier of 11 "
    r"bits, with LIFTGATE_ID_EXTENDED 29"
)


@pytest.mark.parametrize(
    ("bodies", "time_s", "reason"),
    [
        ({"step": f"if ({AT}) *nowhere = 1;"}, 0.05, r"its process ended \(SIGSEGV\)"),
        ({"step": f"if ({AT}) abort();"}, 0.05, r"its process ended \(SIGABRT\)"),
        ({"step": f"if ({AT}) exit(3);"}, 0.05, r"its process ended \(exit code 3\)"),
        ({"step": f"if ({AT}) raise(SIGRTMIN + 1);"}, 0.05, r"its process ended \(signal \d+\)"),
        ({"request": "*nowhere = 1;"}, 0.02, r"its process ended \(SIGSEGV\)"),
        ({"destroy": "*nowhere = 1;"}, 0.101, r"its process ended \(SIGSEGV\)"),
        ({"step": f"if ({AT}) return 5000;"}, 0.05, RETURNED.format("5000")),
    ],
)
def test_a_crash_or_a_wrong_answer_of_a_library_is_reported_with_its_time(
    tmp_path: Path, bodies: dict[str, str], time_s: float, reason: str
) -> None:
    result = lh.run(SCENARIO, library(tmp_path, **bodies))
    assert result.verdict == "error"
    assert re.fullmatch(rf"the ECU at {time_s:.3f} s: {reason}", result.reason), result.reason
    assert set(result.maxima) == set(result.minima) == set(COLUMNS)
    assert not math.isinf(result.maxima["pinch_force_n"])
    check_that_the_caller_lives_on()


@pytest.mark.parametrize(
    ("step", "reason"),
    [
        (f"if ({AT}) return -1;", RETURNED.format("-1")),
        (frame(200), NO_FRAME),
        (frame(9), NO_FRAME),
        (frame(65, flags=1), NO_FRAME),
        (frame(8, identifier=0x800), NO_FRAME),
    ],
)
def test_an_invalid_return_value_or_frame_is_reported(tmp_path: Path, step: str, reason: str) -> None:
    result = run_here(SCENARIO, library(tmp_path, step=step))
    assert result.verdict == "error"
    assert re.fullmatch(rf"the ECU at 0\.050 s: {reason}", result.reason), result.reason


@pytest.mark.parametrize(
    "step",
    [
        "memset(out, 0, capacity * sizeof *out); return capacity;",
        frame(64, flags=1),
        frame(8, identifier=0x80000800),
        # More bits than FD mean nothing, and what lies behind the payload does neither.
        frame(8, flags=0xFE),
    ],
)
def test_unusual_but_valid_frames_are_no_error(tmp_path: Path, step: str) -> None:
    result = run_here(SCENARIO, library(tmp_path, step=step))
    assert result.verdict == "pass", result.reason


def test_a_library_without_a_request_function_gets_no_requests(tmp_path: Path) -> None:
    source = re.sub(r"void liftgate_ecu_request.*", "", source_of())
    path = build(tmp_path, source)
    assert run_here(SCENARIO, path).verdict == "pass"


def test_a_library_that_creates_no_ecu_is_an_error_of_the_run(tmp_path: Path) -> None:
    path = library(tmp_path, create="if (state == 0) return NULL;")
    result = lh.run(SCENARIO, path)
    assert result.verdict == "error"
    assert "liftgate_ecu_create gave no ECU" in result.reason
    with pytest.raises(EcuError, match="liftgate_ecu_create gave no ECU"):
        run_here(SCENARIO, path, "lockstep")


@pytest.mark.parametrize(
    ("bodies", "time_s"),
    [
        ({"create": "for (;;) pause();"}, 0.0),
        ({"step": "for (;;) pause();"}, 0.0),
        ({"request": "for (;;) pause();"}, 0.02),
        ({"step": f"if ({AT}) for (;;) {{ }}"}, 0.05),
        ({"destroy": "for (;;) pause();"}, 0.101),
    ],
)
def test_a_hanging_library_is_killed(tmp_path: Path, bodies: dict[str, str], time_s: float) -> None:
    job = Job(RunRequest(SCENARIO, str(library(tmp_path, **bodies))))
    with pytest.raises(EcuError) as caught:
        run_isolated("liftgate_hil.drive.worker", pickle.dumps(plan_of(job)), 0.001, hang_s=1.0)
    assert str(caught.value) == f"the ECU at {time_s:.3f} s: no response for 1 s"


@pytest.mark.parametrize("clock", ["free", "lockstep", "realtime"])
def test_a_hanging_library_is_an_error_of_the_run_on_every_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, clock: str
) -> None:
    monkeypatch.setattr("liftgate_hil.isolate.isolation.HANG_S", 1.0)
    path = library(tmp_path, step="if (now_ns >= 50000000) for (;;) pause();")
    result = lh.run(SCENARIO, path, clock=clock)
    time = r"\d\.\d{3}" if clock == "realtime" else r"0\.050"
    assert result.verdict == "error"
    assert re.fullmatch(rf"the ECU at {time} s: no response for 1 s", result.reason)


def test_the_time_of_a_crash_is_right_at_another_rate_than_the_default(tmp_path: Path) -> None:
    path = library(tmp_path, step=f"if ({AT}) abort();")
    result = lh.run(SCENARIO, path, rate=500.0)
    assert result.reason.startswith("the ECU at 0.050 s")


@pytest.mark.parametrize(("missing", "run"), [("create", run_here), ("destroy", run_here), ("step", lh.run)])
def test_a_library_without_a_required_function_is_refused(
    tmp_path: Path, missing: str, run: Callable[..., lh.Result]
) -> None:
    path = build(tmp_path, source_of().replace(f"liftgate_ecu_{missing}(", f"another_{missing}("))
    with pytest.raises(ConfigError, match=f"ecu.*{missing}.*functions of liftgate_ecu.h"):
        run(SCENARIO, path)


@pytest.mark.parametrize("content", [b"", b"no library", b"\x7fELF and no more"])
def test_a_file_that_is_no_library_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "ecu.so"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"ecu.*ecu\.so.*functions of liftgate_ecu\.h"):
        run_here(SCENARIO, path)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("ecu.so", True), ("./ecu.so.1.2", True), ("/a b/ecu.dylib", True), ("C:\\ecu.dll", True),
        ("reference", False), ("module:Class", False), ("bus", False), (".so", False),
        (object(), False),
    ],
)  # fmt: skip
def test_libraries_are_recognized_by_their_file_names(name: object, expected: bool) -> None:
    assert is_library(name) is expected
    if isinstance(name, str):
        assert is_library(Path(name)) is expected


def test_a_loaded_rig_and_vehicle_reach_the_process_of_a_library(tmp_path: Path) -> None:
    """All arguments of a run can be pickled."""
    rig = rig_from("liftgate")
    vehicle = vehicle_from("compact")
    scenario = dataclasses.replace(SCENARIO, duration=0.05)
    result = lh.run(scenario, library(tmp_path), rig=rig, vehicle=vehicle, trace=True)
    assert result.verdict == "pass", result.reason
    assert len(result.trace["time_s"]) == 51
    assert result.summary.ticks == 51


def test_a_child_process_of_a_crashed_library_does_not_delay_the_result(tmp_path: Path) -> None:
    path = library(tmp_path, step=f"if ({AT}) {{ if (!fork()) {{ sleep(60); _exit(0); }} abort(); }}")
    assert lh.run(SCENARIO, path).reason == "the ECU at 0.050 s: its process ended (SIGABRT)"


def test_after_a_crash_the_summary_is_complete_and_at_most_half_a_second_of_rows_is_lost(tmp_path: Path) -> None:
    path = library(tmp_path, step="if (now_ns >= 1500000000) abort();")
    scenario = dataclasses.replace(SCENARIO, duration=3.0)
    record = tmp_path / "run.csv"
    result = lh.run(scenario, path, record=record)
    assert (result.summary.ticks, result.summary.model_time_s) == (1500, 1.5)
    last = record.read_text().splitlines()[-1]
    assert float(last.split(",")[0]) > 1.5 - 0.52


def test_a_stop_request_ends_the_run_of_a_slow_library_before_its_ring_is_full(tmp_path: Path) -> None:
    scenario = dataclasses.replace(SCENARIO, duration=1000.0)
    touch = f'close(creat("{tmp_path / "flag"}", 0600));'
    path = library(tmp_path, step=f"usleep(20000); if (now_ns == 20000000) {touch}")
    job = Job(RunRequest(scenario, str(path)))
    stopped = (tmp_path / "flag").exists
    answer = run_isolated("liftgate_hil.drive.worker", pickle.dumps(plan_of(job)), 0.001, stopped)
    result = pickle.loads(answer.payload)
    assert result.verdict == "pass"
    assert 20 <= result.summary.ticks < 400  # the rings would hold 512
