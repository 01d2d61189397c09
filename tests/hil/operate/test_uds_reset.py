"""ECUReset over UDS: requested by a rig's [reset] of an ECU on a bus, before and during a scenario."""

from __future__ import annotations

import itertools
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hil_support import GATE, both, command_frame, shipped_rig

import liftgate_hil as lh
from liftgate_hil.codec.frames import no_logged
from liftgate_hil.config.rig import Rig, load_rig
from liftgate_hil.config.rig_table import asked_by
from liftgate_hil.drive.precondition import phases_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.setup import setup_of
from liftgate_hil.signals import ROW_WIDTH
from liftgate_hil.transport.find import Way

BODY, REQUEST, RESPONSE = 0x140, 0x7A0, 0x7A8
HARD, YES = "1101", "5101"
UDS = '[reset]\nuds = "hardReset"\n'
SIGNAL = '[reset]\nsignal = "Body.Ignition"\nvalue = "off"\nhold_s = 0.3\n'
EXPECT = '[[expect]]\nname = "stands"\nalways = "gate_angle_deg > 0"\n'
AT_100_MS = '[[request]]\ntime = 0.1\naction = "reset"\n'
_numbers = itertools.count()


class Ecu(threading.Thread):
    """Answers every Gate message with a command, and the n-th UDS request with the n-th of `answers`: (cycles of
    10 ms until then, bytes) each; then with nothing.
    """

    def __init__(self, channel: str, rig: Rig, answers: Sequence[Sequence[tuple[int, str]]]):
        super().__init__(daemon=True)
        self._bus = can.Bus(interface="virtual", channel=channel)
        self._rig, self._answers = rig, list(answers)
        self._ended = threading.Event()
        self.requests: list[str] = []
        self.cycles: list[int] = []  # in which they came
        self.offs: list[int] = []  # cycles with the ignition off

    def run(self) -> None:
        cycle, owed = 0, []
        while not self._ended.is_set():
            message = self._bus.recv(0.05)
            if message is None:
                if cycle == 0:
                    self._command(0)  # in lockstep somebody has to begin
                continue
            if message.arbitration_id == REQUEST:
                self.requests.append(message.data[1 : 1 + message.data[0]].hex())
                self.cycles.append(cycle)
                for wait, answer in self._answers.pop(0) if self._answers else ():
                    owed.append((cycle + wait, bytes.fromhex(answer)))
            elif message.arbitration_id == BODY and message.data[0] & 3 == 0:
                self.offs.append(cycle)
            elif message.arbitration_id == GATE:
                for _, answer in [each for each in owed if each[0] <= cycle]:
                    self._send(RESPONSE, bytes([len(answer)]) + answer)
                owed = [each for each in owed if each[0] > cycle]
                cycle += 1
                self._command(cycle)

    def _command(self, turn: int) -> None:
        self._send(*command_frame(self._rig, turn, **both(0.0, 0, 0)))

    def _send(self, identifier: int, data: bytes) -> None:
        self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def close(self) -> None:
        self._ended.set()
        self.join()
        self._bus.shutdown()


Run = Callable[..., tuple[Ecu, Any]]


@pytest.fixture
def on_bus(tmp_path: Path) -> Iterator[Run]:
    """Return a function that runs a scenario with an `Ecu` of these answers; it returns ECU and result."""
    ecus = []

    def run(
        text: str, reset: str, *answers: Sequence[tuple[int, str]], record: Sequence[Path] = ()
    ) -> tuple[Ecu, Any]:
        channel, rig = f"uds-reset-{next(_numbers)}", rig_with(tmp_path, reset)
        ecus.append(Ecu(channel, rig, answers))
        ecus[-1].start()
        path = scenario(tmp_path, text)
        wire = f"virtual:{channel}"
        more = {"wall_timeout": 60.0, "trace": True, "record": record}
        result = lh.run(path, "bus", "lockstep", bus=wire, rig=rig, **more)
        return ecus[-1], result

    yield run
    for ecu in ecus:
        ecu.close()


def scenario(folder: Path, text: str, duration: float = 0.5) -> Path:
    path = folder / "s.toml"
    path.write_text(f"duration = {duration}\ninitial = 30\n{text}", encoding="utf-8")
    return path


def rig_with(folder: Path, text: str, without: str = "") -> Rig:
    """The shipped rig with text added, and without the table that begins with `without`."""
    ours = shipped_rig()
    whole = Path(ours.source).read_text(encoding="utf-8")
    whole = whole.replace('"liftgate.dbc"', f'"{ours.database}"')
    if without:
        head, _, tail = whole.partition(without)
        whole = head + tail[tail.index("\n[") :]
    path = folder / "their.toml"
    path.write_text(f"{whole}\n{text}", encoding="utf-8")
    return load_rig(path)


def reason_of(result: Any) -> str:
    """Return the reason of the only expectation, which must be inconclusive."""
    (told,) = result.expectations.values()
    assert told.verdict == "inconclusive", told
    return str(told.reason)


def test_an_ecu_reset_is_requested_before_a_scenario(on_bus: Run) -> None:
    ecu, result = on_bus(EXPECT, UDS, [(0, YES)])
    assert result.verdict == "pass", result
    assert ecu.requests == [HARD]
    times = result.trace["time_s"]  # the scenario's time begins after it
    assert (times[0], times[-1]) == pytest.approx((0.001, 0.501))


@pytest.mark.parametrize(("kind", "asked"), [("keyOffOnReset", "1102"), ("softReset", "1103")])
def test_each_kind_of_ecu_reset_is_requested_by_its_name(on_bus: Run, kind: str, asked: str) -> None:
    ecu, result = on_bus(EXPECT, f'[reset]\nuds = "{kind}"\n', [(0, f"51{asked[2:]}")])
    assert result.verdict == "pass", result
    assert ecu.requests == [asked]


def test_response_pending_is_waited_for(on_bus: Run) -> None:
    """The ECU's answer comes 3 s later, after more time than any other response is given."""
    ecu, result = on_bus(EXPECT, UDS, [(0, "7f1178"), (300, YES)])
    assert result.verdict == "pass", result
    assert ecu.requests == [HARD]


def test_a_busy_ecu_gets_the_request_again_after_a_cycle(on_bus: Run) -> None:
    ecu, result = on_bus(EXPECT, UDS, [(0, "7f1121")], [(0, YES)])
    assert result.verdict == "pass", result
    assert ecu.requests == [HARD, HARD]
    assert ecu.cycles[1] - ecu.cycles[0] == pytest.approx(10, abs=1)  # cycle_ms = 100


def test_a_refused_ecu_reset_makes_the_scenario_inconclusive(on_bus: Run) -> None:
    ecu, result = on_bus(EXPECT, UDS, [(0, "7f1122")])
    said = "reset.uds: ECUReset hardReset refused: ConditionsNotCorrect (0x22)"
    assert said in reason_of(result)
    assert ecu.requests == [HARD]


@pytest.mark.parametrize(
    ("answers", "requests"),
    [
        ([], 3),  # one each `timeout_ms`
        ([[(0, "7f1178")]], 1),
        ([[(0, "5103")], [(0, "51")], [(0, "5001")]], 3),  # of something else
    ],
    ids=["silent", "pending", "other answers"],
)
def test_an_ecu_that_does_not_answer_makes_the_scenario_inconclusive(
    on_bus: Run, answers: list[list[tuple[int, str]]], requests: int
) -> None:
    ecu, result = on_bus(EXPECT, f"{UDS}timeout_s = 2.5\n", *answers)
    said = "reset.uds: no positive response to ECUReset hardReset within 2.5 s"
    assert said in reason_of(result)
    assert ecu.requests == [HARD] * requests


def test_signal_ecureset_command_and_condition_of_a_reset_follow_in_this_order(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, f'{SIGNAL}uds = "hardReset"\ncommand = ["x"]\nready = "time_s > 1"\n')
    setup = setup_of(scenario(tmp_path, EXPECT))
    names = [each.end.what for each in phases_of(setup, rig, 0.001)]
    assert names == ["reset", "reset.uds", "reset.command", "reset.ready"]


def test_an_ecu_gets_time_to_shut_down_after_its_response(tmp_path: Path) -> None:
    """Also where the response comes at the last moment."""
    setup = setup_of(scenario(tmp_path, EXPECT))
    phase = next(iter(phases_of(setup, rig_with(tmp_path, UDS), 0.001)))
    row, head = np.zeros((1, ROW_WIDTH)), phase.stimuli.tester.head
    phase.end.take(np.repeat(row, 29_900, axis=0), no_logged())
    assert not phase.end.is_over()
    head.due = 0
    phase.end.take(np.repeat(row, 50, axis=0), no_logged())
    assert not phase.end.is_over()
    phase.end.take(np.repeat(row, 99, axis=0), no_logged())
    assert not phase.end.is_over()
    phase.end.take(row, no_logged())
    assert phase.end.is_over()


def test_a_reset_during_a_scenario_uses_uds_where_the_rig_has_no_signal(on_bus: Run) -> None:
    later = '[[request]]\ntime = "time_s > 0.3"\naction = "reset"\n'
    ecu, result = on_bus(EXPECT + AT_100_MS + later, UDS, *[[(0, YES)]] * 3)
    assert result.verdict == "pass", result
    assert ecu.requests == [HARD] * 3
    assert ecu.cycles[2] - ecu.cycles[1] == pytest.approx(20, abs=1)


def test_a_reset_during_a_scenario_uses_the_signal_and_not_uds_where_the_rig_has_both(on_bus: Run) -> None:
    ecu, result = on_bus(EXPECT + AT_100_MS, f'{SIGNAL}uds = "hardReset"\n', [(0, YES)])
    assert result.verdict == "pass", result
    assert ecu.requests == [HARD]
    assert min(ecu.offs) < ecu.cycles[0] < max(ecu.offs)


@pytest.mark.parametrize(
    ("answers", "said"),
    [
        ([[(0, "7f1122")]], "ECUReset hardReset refused: ConditionsNotCorrect (0x22)"),
        ([[(0, "7f1100")]], "ECUReset hardReset refused: PositiveResponse (0x00)"),
        ([], "no response to ECUReset hardReset"),
    ],
    ids=["refused", "refused without a code", "silent"],
)
def test_a_failed_reset_during_a_scenario_makes_it_inconclusive(
    on_bus: Run, tmp_path: Path, answers: list[list[tuple[int, str]]], said: str
) -> None:
    files = [tmp_path / name for name in ("run.mf4", "run.csv", "run.log", "run.mcap")]
    ecu, result = on_bus(EXPECT + AT_100_MS, UDS, [(0, YES)], *answers, record=files)
    assert reason_of(result) == f"request: reset: {said}"
    assert ecu.requests == [HARD, HARD]
    for recorded in (files[:1], files[1:3], files[3:]):
        again = lh.judge(recorded, tmp_path / "s.toml", rig=tmp_path / "their.toml").verdicts
        assert again == result.expectations


def test_a_successful_reset_is_judged_the_same_from_recordings(on_bus: Run, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    answers = [[(0, YES)], [(0, "7f1121")], [(0, "7f1178"), (3, YES)]]
    ecu, result = on_bus(EXPECT + AT_100_MS, UDS, *answers, record=[file])
    assert result.verdict == "pass", result
    assert ecu.requests == [HARD] * 3
    assert lh.judge([file], tmp_path / "s.toml", rig=tmp_path / "their.toml").verdicts == result.expectations


def test_a_reset_is_requested_even_while_another_awaits_its_response(on_bus: Run) -> None:
    times = "".join(f'[[request]]\ntime = {time}\naction = "reset"\n' for time in (0.1, 0.11, 0.12))
    ecu, result = on_bus(EXPECT + times, UDS, *[[(4, YES)]] * 4)
    assert result.verdict == "pass", result
    assert ecu.requests == [HARD] * 4


def test_trouble_codes_are_read_before_and_after_a_reset(on_bus: Run) -> None:
    codes = '[[expect]]\nname = "none"\ndtc = "U1A01"\nstate = "absent"\n'
    none = [(0, "59027f")]
    reads = [none] * 2
    answers = ([(0, YES)], [(0, "54")], *reads, [(0, YES)], *[none] * 9)
    ecu, result = on_bus(codes + '[[request]]\ntime = 0.15\naction = "reset"\n', UDS, *answers)
    assert result.verdict == "pass", result
    assert ecu.requests[:5] == [HARD, "14ffffff", "190209", "190209", HARD]
    assert set(ecu.requests[5:]) == {"190209"}
    assert len(ecu.requests) >= 8


def test_checking_a_rig_describes_its_uds_reset(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, UDS)
    said = "sends ECUReset hardReset (11 01), then waits for its first command"
    assert asked_by(rig)["reset"] == said


def test_a_uds_reset_needs_a_diagnostics_section(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        rig_with(tmp_path, UDS, without="[diagnostics]")
    said = "hardReset: the rig has no [diagnostics]; allowed: a rig with [diagnostics] request and response"
    assert caught.value.issues == [f"{tmp_path / 'their.toml'}: reset.uds: {said}"]


@pytest.mark.parametrize("value", ["true", '"hardreset"', "1"])
def test_an_unknown_kind_of_ecu_reset_is_refused(tmp_path: Path, value: str) -> None:
    with pytest.raises(ConfigError, match=r"reset\.uds: ") as caught:
        rig_with(tmp_path, f"[reset]\nuds = {value}\n")
    assert "one of hardReset, keyOffOnReset, softReset" in caught.value.issues[0]


def test_a_missing_uds_library_is_reported_before_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "udsoncan", None)
    rig, path = rig_with(tmp_path, UDS), scenario(tmp_path, EXPECT)
    with pytest.raises(ConfigError, match=r"reset\.uds: resets over UDS need udsoncan; .*'liftgate-hil\[uds\]'"):
        lh.run(path, "bus", "lockstep", bus="virtual:nobody", rig=rig, wall_timeout=0.1)
    assert lh.run(path, rig=rig).verdict == "pass"  # of an ECU in this process it is made anew


def test_a_fault_impossible_on_a_real_bus_is_judged_the_same_from_recordings(
    on_bus: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Way, "is_interface", lambda way, name: False)
    monkeypatch.setattr(Way, "interface", "socketcan")
    files = [tmp_path / name for name in ("run.mf4", "run.parquet", "run.mcap", "run.csv")]
    off = '[[fault]]\nkind = "bus_off"\nstart = 0.495\n'
    _, result = on_bus(EXPECT + off, "", record=files)
    said = "fault[0]: bus_off: a real controller cannot be taken off its bus from here"
    assert reason_of(result).endswith(said)
    for file in files:
        again = lh.judge([file], tmp_path / "s.toml", rig=tmp_path / "their.toml").verdicts
        assert {each.verdict for each in again.values()} == {"inconclusive"}
        assert "did not apply 1 of the requested stimuli" in next(iter(again.values())).reason
