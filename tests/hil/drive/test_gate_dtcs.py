"""Trouble codes read and cleared by a gate's methods, in the caller's own loop with an ECU."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from hil_support import Wire, shipped_rig

import liftgate_hil as lh
from liftgate_hil.ecu.find import adapter_for
from liftgate_hil.ecu.peer import Peer
from liftgate_hil.errors import ConfigError, DiagnosticsError, LiftgateError
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import Request, by_the_clock

REQUEST, RESPONSE = 0x7A0, 0x7A8
CLEAR, READ = "14ffffff", "190209"
TWO_CODES = ["100b59027f9a0162", "2109da018709"]


class Answering:
    """An ECU that answers each diagnostic request with frames, and sends nothing else."""

    def __init__(self, **answers: str | list[str]) -> None:
        self.answers = {CLEAR: answers.get("clear", []), READ: answers.get("read", [])}
        self.heard: list[tuple[float, str]] = []
        self._next: list[str] = []

    def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
        found = []
        for frame in frames:
            if frame.arbitration_id == REQUEST:
                data = bytes(frame.data)
                self.heard.append((now_s, data.hex()))
                if data[0] >> 4 == 3:  # flow control: all the rest
                    found, self._next = self._next, []
                    continue
                answer = self.answers[data[1 : 1 + data[0]].hex()]
                found, self._next = answer[:1], answer[1:]
        return [
            can.Message(arbitration_id=RESPONSE, data=bytes.fromhex(each), is_extended_id=False) for each in found
        ]


def loop(gate: lh.Gate, ecu: Any, period: float = 0.010) -> Callable[[], None]:
    """Return a function for one cycle of the loop that exchanges frames of a gate and an ECU."""

    def cycle() -> None:
        for message in ecu.step(gate.time, gate.step(period)):
            gate.send(message)

    return cycle


class Reference:
    """The reference ECU, stepped in the caller's loop."""

    def __init__(self, gate: lh.Gate, *requests: Request) -> None:
        self._wire = Wire()
        adapter = adapter_for("reference", gate.rig, 2)
        self._peer = Peer(adapter, self._wire, by_the_clock(requests))

    def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
        self._wire.inbox = [(each.arbitration_id, bytes(each.data)) for each in frames]
        self._peer.poll(round(now_s * 1e9))
        sent, self._wire.sent = self._wire.sent, []
        return [
            can.Message(arbitration_id=identifier, data=data, is_extended_id=False) for identifier, data in sent
        ]


def test_trouble_codes_of_the_reference_ecu_are_read_until_they_are_cleared() -> None:
    with lh.Gate(initial=40.0) as gate:
        cycle = loop(gate, Reference(gate, Request(Instant(0.2), "open")), 0.005)
        while gate.time < 0.8:
            cycle()
        assert gate.truth["gate_rate_degps"] > 1.0
        gate.clear_dtcs(cycle)
        assert gate.read_dtcs(cycle) == {}
        lost = gate.fault("frame_lost", where="RightDrive", direction="sent", probability=1.0)
        while gate.time < 1.5:
            cycle()
        codes = gate.read_dtcs(cycle)
        assert list(codes) == ["U1A01-87"]
        assert codes["U1A01-87"] & 0x09 == 0x09
        lost.clear()
        gate.clear_dtcs(cycle)
        assert gate.read_dtcs(cycle) == {}


def test_trouble_codes_in_several_frames_are_read_with_their_status() -> None:
    ecu = Answering(read=TWO_CODES)
    with lh.Gate() as gate:
        assert gate.read_dtcs(loop(gate, ecu)) == {"B1A01-62": 9, "U1A01-87": 9}
        assert [data for _, data in ecu.heard] == ["03190209cccccccc", "300000cccccccccc"]
        assert gate.time == pytest.approx(0.030)


def test_a_code_without_a_status_bit_of_the_mask_is_not_returned() -> None:
    with lh.Gate() as gate:
        assert gate.read_dtcs(loop(gate, Answering(read=["0759027f9a016250"]))) == {}


@pytest.mark.parametrize("period", [0.001, 0.010, 0.4])
def test_a_request_works_at_any_period_of_the_loop(period: float) -> None:
    ecu = Answering(clear=["0154"], read=["0359027f"])
    with lh.Gate() as gate:
        cycle = loop(gate, ecu, period)
        gate.clear_dtcs(cycle)
        assert gate.read_dtcs(cycle) == {}
        assert [data[:10] for _, data in ecu.heard] == ["0414ffffff", "03190209cc"]


def test_the_tester_sends_nothing_before_and_after_a_request() -> None:
    ecu = Answering(read=["0359027f"])
    with lh.Gate() as gate:
        cycle = loop(gate, ecu)
        for _ in range(30):
            cycle()
        assert ecu.heard == []
        gate.read_dtcs(cycle)
        for _ in range(30):
            cycle()
        assert len(ecu.heard) == 1


def test_faults_made_in_a_cycle_do_not_disturb_the_request() -> None:
    """Faults change the stimulus plan that also holds the tester."""
    ecu = Answering(read=TWO_CODES)
    with lh.Gate() as gate:
        step = loop(gate, ecu)

        def cycle() -> None:
            step()
            gate.fault("hall_a_stuck", where="left", value=0).clear()

        assert len(gate.read_dtcs(cycle)) == 2


def test_a_negative_response_raises_an_error_with_its_code() -> None:
    with lh.Gate() as gate:
        cycle = loop(gate, Answering(read=["037f1911"], clear=["037f1422"]))
        with pytest.raises(DiagnosticsError) as caught:
            gate.read_dtcs(cycle)
        assert str(caught.value) == "ReadDTCInformation refused: ServiceNotSupported (0x11)"
        assert caught.value.nrc == 0x11
        with pytest.raises(DiagnosticsError) as caught:
            gate.clear_dtcs(cycle)
        said = "ClearDiagnosticInformation refused: ConditionsNotCorrect (0x22)"
        assert str(caught.value) == said
        assert caught.value.nrc == 0x22
        assert isinstance(caught.value, LiftgateError)


def test_a_negative_response_with_an_unknown_code_raises_an_error() -> None:
    with lh.Gate() as gate:
        cycle = loop(gate, Answering(read=["037f1900"], clear=["037f1400"]))
        for asked in (gate.clear_dtcs, gate.read_dtcs):
            with pytest.raises(DiagnosticsError, match=r"refused: .*\(0x00\)") as caught:
                asked(cycle)
            assert caught.value.nrc == 0


def test_a_missing_response_raises_an_error_after_the_rigs_timeout() -> None:
    ecu = Answering()
    with lh.Gate() as gate:
        cycle = loop(gate, ecu)
        with pytest.raises(DiagnosticsError, match=r"^ReadDTCInformation: no response within 1\.01 s$") as caught:
            gate.read_dtcs(cycle)
        assert caught.value.nrc is None
        ecu.answers[READ] = ["0359027f"]
        assert gate.read_dtcs(cycle) == {}  # the next request is a new one


def test_response_pending_prolongs_the_wait() -> None:
    class Slow(Answering):
        def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
            found = super().step(now_s, frames)
            is_now = self.heard and round(now_s - self.heard[0][0], 3) == 4.0
            data = bytes.fromhex("0359027f")
            late = can.Message(arbitration_id=RESPONSE, data=data, is_extended_id=False)
            return [*found, late] if is_now else found

    with lh.Gate() as gate:
        assert gate.read_dtcs(loop(gate, Slow(read=["037f1978"]))) == {}
        assert 4.0 < gate.time < 4.1


def test_endless_response_pending_raises_an_error() -> None:
    class Pending(Answering):
        def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
            assert now_s < 65.0
            data = bytes.fromhex("037f1978")
            return [can.Message(arbitration_id=RESPONSE, data=data, is_extended_id=False)]

    with (
        lh.Gate() as gate,
        pytest.raises(DiagnosticsError, match=r"ReadDTCInformation: no response within 60 s but pending"),
    ):
        gate.read_dtcs(loop(gate, Pending(), 0.5))


def test_a_malformed_response_is_reported() -> None:
    with (
        lh.Gate() as gate,
        pytest.raises(DiagnosticsError, match="ReadDTCInformation: malformed response: 59 02 7f 9a 01 62"),
    ):
        gate.read_dtcs(loop(gate, Answering(read=["0659027f9a0162"])))


def test_an_exception_in_a_cycle_propagates_and_ends_the_request() -> None:
    ecu = Answering(read=["0359027f"])
    with lh.Gate() as gate:

        def cycle() -> None:
            raise KeyError("mine")

        with pytest.raises(KeyError, match="mine"):
            gate.read_dtcs(cycle)
        loop(gate, ecu)()
        assert ecu.heard == []
        assert gate.read_dtcs(loop(gate, ecu)) == {}


def test_a_cycle_that_does_not_step_the_gate_is_refused() -> None:
    said = "`cycle`: the gate's time stood still; allowed: a function that calls its `step`"
    few = iter(range(3))
    with lh.Gate() as gate, pytest.raises(ConfigError) as caught:
        gate.read_dtcs(lambda: next(few))
    assert caught.value.issues == [said]


def test_a_cycle_that_is_no_function_is_refused() -> None:
    with lh.Gate() as gate, pytest.raises(ConfigError) as caught:
        gate.read_dtcs(0.01)  # type: ignore[arg-type]
    assert caught.value.issues == ["`cycle` 0.01: allowed: a function without arguments"]


def test_a_second_request_during_the_first_one_is_refused() -> None:
    with lh.Gate() as gate, pytest.raises(ConfigError, match="`clear_dtcs`: the tester waits for a response"):
        gate.read_dtcs(lambda: gate.clear_dtcs(lambda: gate.step(0.01)))


def test_a_request_of_a_closed_gate_is_refused() -> None:
    with lh.Gate() as gate:
        pass
    with pytest.raises(ConfigError, match="this gate is closed"):
        gate.read_dtcs(lambda: None)


def test_a_request_with_a_rig_without_diagnostics_is_refused(tmp_path: Path) -> None:
    ours = shipped_rig()
    text = Path(ours.source).read_text(encoding="utf-8").partition("[diagnostics]")
    rest = text[2][text[2].index("\n[") :]
    path = tmp_path / "bare.toml"
    path.write_text((text[0] + rest).replace('"liftgate.dbc"', f'"{ours.database}"'), encoding="utf-8")
    with lh.Gate(rig=path) as gate, pytest.raises(ConfigError) as caught:
        gate.read_dtcs(lambda: gate.step(0.01))
    said = "has no [diagnostics]; allowed: a rig with [diagnostics] request and response"
    assert caught.value.issues == [f"`read_dtcs`: the rig {path} {said}"]


def test_a_missing_udsoncan_package_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "udsoncan", None)
    with (
        lh.Gate() as gate,
        pytest.raises(ConfigError, match=r"`clear_dtcs`: trouble codes need udsoncan; .*'liftgate-hil\[uds\]'"),
    ):
        gate.clear_dtcs(lambda: gate.step(0.01))
