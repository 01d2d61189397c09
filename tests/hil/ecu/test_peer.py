"""An ECU as a bus peer, in this process and in a process of its own."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import c_ecu
import can
import pytest
from echo_ecu import ECHO_REQUEST, Echo
from hil_support import GATE, LEFT_DRIVE, OPEN, Wire, both, command_frame, with_checksum
from run_support import ScriptedEcu

import liftgate_hil as lh
from liftgate_hil.codec.frames import EXTENDED
from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.find import adapter_for
from liftgate_hil.ecu.peer import Peer
from liftgate_hil.errors import EcuError
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import Request, by_the_clock
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI

MS = 1_000_000
Rows = list[tuple[int, bytes]]


def polled(adapter: Adapter, requests: Sequence[Request], heard: dict[int, Rows]) -> list[int]:
    """Return the times [ms] at which an Echo reports a request; `heard` are frames by their arrival [ms]."""
    wire = Wire()
    peer = Peer(adapter, wire, by_the_clock(requests))
    times = []
    for now in range(100):
        wire.inbox = heard.get(now, [])
        peer.poll(now * MS)
        times += [now for row, _ in wire.sent if ECHO_REQUEST <= row < ECHO_REQUEST + 3]
        wire.sent.clear()
    return times


REQUESTS = [Request(Instant(0.0), "open"), Request(Instant(0.02), "stop")]


def test_with_a_shared_clock_requests_count_from_the_start(rig: Rig) -> None:
    with adapter_for(Echo(), rig, 2) as adapter:
        assert polled(adapter, REQUESTS, {40: [(GATE, bytes(5))]}) == [0, 20]


def test_with_its_own_clock_requests_count_from_the_gates_first_frame(rig: Rig) -> None:
    heard = {
        5: [(0x55, b"x"), (GATE | EXTENDED, bytes(5)), command_frame(rig, 0, **both(0.0, OPEN))],
        40: [(0x56, b""), (GATE, bytes(5))],
        50: [(LEFT_DRIVE, bytes(8))],
    }
    with adapter_for(Echo(), rig, 2, shares_clock=False) as adapter:
        assert polled(adapter, REQUESTS, heard) == [40, 60]


@pytest.mark.parametrize("kind", ["reference", "object"])
def test_a_peer_reports_whether_it_has_heard_the_gate(rig: Rig, kind: str) -> None:
    wire = Wire()
    ecu = "reference" if kind == "reference" else ScriptedEcu(lambda turn: [])
    with adapter_for(ecu, rig, 2, shares_clock=False) as adapter:
        peer = Peer(adapter, wire)
        peer.poll(10 * MS)
        assert not peer.has_heard_the_gate
        gate = rig.messages["Gate"].encode({"Angle": 3.0, "LatchState": 0, "TerminalVoltage": 12})
        drives = [
            (identifier, drive_payload(rig, name, identifier))
            for identifier, name in ((LEFT_DRIVE, "LeftDrive"), (LEFT_DRIVE + 1, "RightDrive"))
        ]
        wire.inbox = [(GATE, gate), *drives]
        peer.poll(30 * MS)
        assert peer.has_heard_the_gate


def drive_payload(rig: Rig, name: str, identifier: int) -> bytes:
    values = {"MotorCurrent": 0, "HallCount": 0, "HallSpeed": 0, "AliveCounter": 0, "Checksum": 0}
    return with_checksum(identifier, rig.messages[name].encode(values))


def test_the_last_command_of_the_reference_ecu_switches_the_motors_off(rig: Rig) -> None:
    wire = Wire()
    with adapter_for("reference", rig, 2) as adapter:
        Peer(adapter, wire).finish()
    (last,) = wire.sent
    values = rig.messages["DriveCommand"].decode(last[1], decode_choices=False)
    assert values["LeftDirection"] == values["RightDirection"] == 0
    assert values["LeftDuty"] == values["RightDuty"] == values["LatchRelease"] == 0


def test_an_ecu_without_final_frames_sends_nothing_at_the_end(rig: Rig) -> None:
    wire = Wire()
    with adapter_for(ScriptedEcu(lambda turn: []), rig, 2) as adapter:
        Peer(adapter, wire).finish()
    assert wire.sent == []


def test_a_request_after_a_reset_in_the_same_step_reaches_the_new_ecu(rig: Rig) -> None:
    with adapter_for("echo_ecu:Echo", rig, 2) as adapter:
        peer = Peer(adapter, wire := Wire())
        peer.poll(0)
        assert peer.request("reset")
        assert peer.request("open")
        for turn in range(1, 5):
            peer.poll(turn * 10 * MS)
        assert any(identifier >= ECHO_REQUEST for identifier, _ in wire.sent)


def test_a_wrong_answer_of_a_peer_is_reported_with_its_time(rig: Rig) -> None:
    with adapter_for(ScriptedEcu(lambda turn: 5 if turn == 2 else []), rig, 2) as adapter:
        peer = Peer(adapter, Wire())
        peer.poll(0)
        peer.poll(10 * MS)
        with pytest.raises(EcuError, match=r"the ECU at 0\.020 s: its step gave 5"):
            peer.poll(20 * MS)


# A process of its own.

_groups = itertools.count(os.getpid() % 200)


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> str:
    """The address of a multicast group that no other test or process of this machine uses."""
    monkeypatch.setenv("CAN_CONFIG", json.dumps({"port": 44000 + os.getpid() % 4000}))
    return f"udp_multicast:239.75.{next(_groups) % 250}.{os.getpid() % 250 + 1}"


@pytest.fixture
def ecu_on(bus: str) -> Iterator[Any]:
    """Return a function that starts `liftgate-hil ecu` on `bus` with these arguments, ended with the test."""
    children = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        folders = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
        path = os.pathsep.join([*folders, os.environ.get("PYTHONPATH", "")])
        command = [sys.executable, "-m", "liftgate_hil", "ecu", "--bus", bus, *arguments]
        children.append(
            subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": path})
        )
        return children[-1]

    yield start
    for child in children:
        child.kill()
        child.communicate()


@pytest.mark.parametrize(
    "kind", ["reference", "echo_ecu:Opener", pytest.param("library", marks=c_ecu.needs_compiler)]
)
def test_an_ecu_in_a_process_of_its_own_opens_the_gate_in_lockstep(
    bus: str, ecu_on: Any, kind: str, request: pytest.FixtureRequest
) -> None:
    ecu = str(request.getfixturevalue("example_library")) if kind == "library" else kind
    ecu_on("--ecu", ecu, "--request", "0.2:open")
    scenario = Scenario(NO_STIMULI, (), 2.0)
    result = lh.run(scenario, "bus", "lockstep", bus=bus, wall_timeout=120.0, trace=True)
    assert result.verdict == "pass", result.reason
    # Each command once, none of them refused: a period of model time each. A busy machine may lose some.
    received = result.summary.received
    assert received == NO_COUNTS._replace(accepted=200, lost=received.lost)
    assert result.summary.command_timeouts == 0
    # Asked by the ECU's own clock, at the latest after 20 commands.
    assert result.trace["gate_angle_deg"][-1] > 1.0


def test_lockstep_without_an_ecu_on_the_bus_ends_after_a_time_limit(bus: str) -> None:
    scenario = Scenario(NO_STIMULI, (), 2.0)
    result = lh.run(scenario, "bus", "lockstep", bus=bus, wall_timeout=0.3)
    assert result.verdict == "error"
    assert result.reason.startswith("no command for 0.3 s at 0.000 s of model time")


def test_an_ecu_in_a_process_of_its_own_prints_its_bus_and_the_frames_it_receives(bus: str, ecu_on: Any) -> None:
    ecu = ecu_on("--request", "0.2:open")
    group = bus.removeprefix("udp_multicast:")
    assert ecu.stderr.readline() == (
        f"ECU reference on {group}; requests, from the gate's first frame on: open at 0.2 s\n"
    )
    waits = f"waits for frames of the gate on {group}: "
    assert ecu.stderr.readline().startswith(f"{waits}nothing received; the rig's: LeftDrive (0x210), ")
    with can.Bus(
        interface="udp_multicast", channel=group, port=json.loads(os.environ["CAN_CONFIG"])["port"]
    ) as other:
        other.send(can.Message(arbitration_id=0x7A1, is_extended_id=False))
        assert ecu.stderr.readline().startswith(
            f"{waits}0x7A1 received, which is not the gate's: check that --rig is that of the gate; the rig's: "
        )
    lh.run(Scenario(NO_STIMULI, (), 0.5), "bus", "lockstep", bus=bus, wall_timeout=120.0)
    assert ecu.stderr.readline() == "frames of the gate received\n"
