"""Trouble codes expected of a run: read from any ECU, in every loop, and from its recording."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from hil_support import issues_of, text_file

import liftgate_hil as lh
from liftgate_hil.config.shipped import find_config
from liftgate_hil.errors import ConfigError

REQUEST, RESPONSE = 0x7A0, 0x7A8
CLEAR, READ = "14ffffff", "190209"
SHIPPED = ("dtc_feedback_lost", "dtc_drives_apart")
SHORT = """
duration = {duration}
initial = 50
[[expect]]
name = "present"
dtc = "U1A01-87"
state = "present"
[[expect]]
name = "absent"
dtc = "U1A01"
state = "absent"
"""


@pytest.fixture
def short(tmp_path: Path) -> Callable[..., Path]:
    """Function that writes a scenario in which nothing happens, with text added, and returns its path."""

    def made(more: str = "", duration: float = 1.0) -> Path:
        path = text_file(tmp_path / "short.toml", SHORT.format(duration=duration) + more)
        return path

    return made


def rig_with(folder: Path, diagnostics: str) -> Path:
    """The shipped rig with other diagnostics."""
    source = find_config("rigs", "liftgate")
    text, count = re.subn(r"\[diagnostics\][^\[]*", diagnostics + "\n", source.read_text())
    assert count == 1
    (folder / "rig.toml").write_text(text)
    return folder / "rig.toml"


class Answering:
    """An ECU that sends only its given response to each request."""

    period_s = 0.001

    def __init__(self, answers: dict[str, str], response: int = RESPONSE) -> None:
        self.answers, self.response = answers, response
        self.requests: list[tuple[float, str]] = []

    def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
        found = []
        for each in frames:
            if each.arbitration_id == REQUEST:
                request = bytes(each.data[1 : 1 + each.data[0]]).hex()
                self.requests.append((now_s, request))
                answer = bytes.fromhex(self.answers.get(request, ""))
                if answer:
                    data = bytes([len(answer)]) + answer
                    is_long = self.response > 0x7FF
                    found.append(can.Message(arbitration_id=self.response, data=data, is_extended_id=is_long))
        return found


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_trouble_code_scenarios_pass_free_lockstep_and_from_recordings(tmp_path: Path, name: str) -> None:
    files = [tmp_path / "run.csv", tmp_path / "run.log"]
    free = lh.run(name, record=files)
    assert free.verdict == "pass", free.expectations
    assert all(each.margin is None for each in free.expectations.values())
    lockstep = lh.run(name, clock="lockstep")
    assert lockstep.expectations == free.expectations
    assert lh.judge(files, name).verdicts == free.expectations


def test_a_trouble_code_is_judged_by_the_responses_in_its_window(short: Callable[..., Path]) -> None:
    """The code is present for 0.2 s, as reported by the ECU itself."""
    none, one = "59027f", "59027fda018709"

    class Changing(Answering):
        def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
            self.answers[READ] = one if 0.35 < now_s < 0.55 else none
            return super().step(now_s, frames)

    windows = "".join(
        f'[[expect]]\nname = "{state} {after}"\ndtc = "U1A01-87"\nstate = "{state}"\nafter = {after}\n'
        "within_s = 0.15\n"
        for state in ("present", "absent")
        for after in (0.05, 0.35, 0.7)
    )
    ecu = Changing({CLEAR: "54"})
    found = lh.run(short(windows), ecu=ecu).expectations
    assert {name: each.verdict for name, each in found.items()} == {
        "present": "pass", "absent": "fail",
        "present 0.05": "fail", "present 0.35": "pass", "present 0.7": "fail",
        "absent 0.05": "pass", "absent 0.35": "fail", "absent 0.7": "pass",
    }  # fmt: skip
    assert [request for _, request in ecu.requests[:3]] == [CLEAR, READ, READ]
    times = [time for time, request in ecu.requests if request == READ]
    assert len(times) == 10
    assert times[1:] == pytest.approx([0.1 * k + times[1] for k in range(9)], abs=1e-9)
    # What the first answer that counts says, and when it came.
    assert found["present"].time_s == found["absent"].time_s == pytest.approx(0.403, abs=2e-3)
    assert found["absent"].reason == f"U1A01: reported at {found['absent'].time_s:g} s"
    assert found["present 0.7"].reason == "U1A01-87: not reported from 0.7 s within 0.15 s, in 2 answers"
    # What comes behind the window is told, too.
    assert re.fullmatch(
        r"U1A01-87: not reported from 0\.05 s within 0\.15 s, in \d answers; "
        r"reported at 0\.40\d s, allowed until 0\.2 s",
        found["present 0.05"].reason,
    )


@pytest.mark.parametrize(
    ("answers", "said", "requests"),
    [
        ({}, "", [CLEAR] * 2),  # asked again after a second of silence,
        ({CLEAR: "54"}, "", [CLEAR, READ, READ]),
        ({CLEAR: "7f1478"}, "", [CLEAR]),  # or after five where it asks for time
        ({CLEAR: "54", READ: "7f1911"},
         "; the ECU refused ReadDTCInformation: ServiceNotSupported (0x11)", [CLEAR, *[READ] * 15]),
        ({CLEAR: "7f1422"},
         "; the ECU refused ClearDiagnosticInformation: ConditionsNotCorrect (0x22)", [CLEAR] * 15),
    ],
    ids=["silent", "silent when read", "pending", "reading refused", "clearing refused"],
)  # fmt: skip
def test_without_a_response_trouble_codes_are_inconclusive(
    short: Callable[..., Path], answers: dict[str, str], said: str, requests: list[str]
) -> None:
    ecu = Answering(answers)
    result = lh.run(short(duration=1.45), ecu=ecu)
    assert {each.verdict for each in result.expectations.values()} == {"inconclusive"}
    reason = f"no response to reading the trouble codes in its window, 0 s to 1.45 s{said}"
    assert {each.reason for each in result.expectations.values()} == {reason}
    assert [request for _, request in ecu.requests] == requests


def test_an_ecu_that_falls_silent_does_not_pass_as_free_of_codes(short: Callable[..., Path]) -> None:
    class Dying(Answering):
        def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
            return super().step(now_s, frames) if now_s < 0.35 else []

    window = '[[expect]]\nname = "early"\ndtc = "U1A01"\nstate = "absent"\nwithin_s = 1.3\n'
    ecu = Dying({CLEAR: "54", READ: "59027f"})
    found = lh.run(short(window, duration=2.0), ecu=ecu).expectations
    assert found["early"].verdict == "pass"  # a second without an answer is borne
    assert found["absent"].verdict == "inconclusive"
    assert found["absent"].reason == (
        "the last answer to reading the trouble codes came at 0.302 s, its window ends at 2 s"
    )
    assert found["present"].verdict == "fail"


def test_requests_follow_the_rigs_diagnostics_section(short: Callable[..., Path], tmp_path: Path) -> None:
    """29-bit identifiers, no padding, no clearing, another status mask and another period."""
    rig = rig_with(
        tmp_path,
        '[diagnostics]\nrequest = 0x18DA40F1\nresponse = 0x18DAF140\npadding = "none"\nclear = false\n'
        "status_mask = 0x50\ncycle_ms = 50",
    )
    path = short().read_text().replace("U1A01-87", "B1A09-98")
    scenario = text_file(tmp_path / "other.toml", path)
    log = tmp_path / "run.log"
    result = lh.run(scenario, rig=rig, record=[log])
    # Not tested yet, as a code's status says; the answer takes more than one frame.
    assert result.expectations["present"].verdict == "pass"
    lines = [line.split()[2] for line in log.read_text().splitlines()]
    spoken = [line for line in lines if line.startswith("18DA")]
    assert spoken[:4] == [
        "18DA40F1#03190250", "18DAF140#102B59027F9A0162", "18DA40F1#300000", "18DAF140#21509A022A509A03",
    ]  # fmt: skip
    assert spoken.count("18DA40F1#03190250") == 20


def test_the_diagnostic_tester_starts_at_the_scenarios_time_0(short: Callable[..., Path], tmp_path: Path) -> None:
    path = short()
    text = 'precondition = ["open"]\n' + path.read_text()
    path.write_text(text)
    log = tmp_path / "run.log"
    result = lh.run(path, record=[log, tmp_path / "run.csv"])
    assert result.expectations["absent"].verdict == "pass"
    first = next(line for line in log.read_text().splitlines() if " 7A0#" in line)
    assert first == "(0000000000.001000) virtual 7A0#0414FFFFFFCCCCCC T"


def test_without_an_expected_trouble_code_no_request_is_sent(short: Callable[..., Path], tmp_path: Path) -> None:
    path = text_file(tmp_path / "none.toml", 'duration = 0.3\n[[expect]]\nname = "x"\nalways = "time_s < 1"\n')
    ecu = Answering({})
    assert lh.run(path, ecu=ecu).verdict == "pass"
    assert ecu.requests == []


@pytest.mark.parametrize(
    "fault",
    [
        'kind = "babbling"\ndirection = "received"\nid = 0x7A8\nrate = 3000\n',
        'kind = "bus_off"\nstart = 0.2\nend = 0.5\n',
    ],
)
def test_a_bus_fault_prevents_reading_codes_only_while_active(short: Callable[..., Path], fault: str) -> None:
    result = lh.run(short(f"[[fault]]\n{fault}"))
    assert result.expectations["absent"].verdict == "pass"
    assert "in " in result.expectations["present"].reason


def test_missing_diagnostics_and_libraries_are_reported(
    short: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bare = rig_with(tmp_path, "")
    assert issues_of(lh.run, short(), rig=bare) == [
        f"{short()}: expect[0].dtc: U1A01-87: the rig has no [diagnostics]; allowed: a rig with "
        "[diagnostics] request and response"
    ]
    monkeypatch.setitem(sys.modules, "udsoncan", None)
    with pytest.raises(ConfigError, match=r"trouble codes need udsoncan; .*'liftgate-hil\[uds\]'"):
        lh.run(short())


def test_reports_show_trouble_code_verdicts_without_a_margin(short: Callable[..., Path], tmp_path: Path) -> None:
    files = {kind: tmp_path / f"report.{kind}" for kind in ("json", "junit", "html")}
    command = [sys.executable, "-m", "liftgate_hil", "test", str(short())]
    for kind, file in files.items():
        command += [f"--{kind}", str(file)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    said = "U1A01-87: not reported from 0 s, in 10 answers"
    assert f"present: fail: {said}" in done.stdout
    found = json.loads(files["json"].read_text())["scenarios"][0]["expectations"]
    assert [(each["verdict"], each["margin"], each["time_s"]) for each in found] == [
        ("fail", None, None), ("pass", None, None),
    ]  # fmt: skip
    assert f'message="fail: {said}"' in files["junit"].read_text()
    html = files["html"].read_text()
    assert "dtc U1A01-87 present" in html
    assert said in html


@pytest.mark.realtime
def test_trouble_codes_are_read_in_real_time(short: Callable[..., Path]) -> None:
    result = lh.run(short(), clock="realtime")
    assert result.expectations["present"].verdict in ("fail", "inconclusive")
    if result.expectations["present"].verdict == "fail":
        assert "answers" in result.expectations["present"].reason
