"""Restbus: frames of other control units from scenarios and from Python; they do not affect the gate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cantools
import pytest
from hil_support import frames_of, issues_of, j1850, shipped_rig, text_file

import liftgate_hil as lh
from liftgate_hil.codec.bus_config import build_bus_config, mapping_named
from liftgate_hil.codec.receive import NO_COUNTS, nothing_received, receive
from liftgate_hil.config.rig import load_rig
from liftgate_hil.errors import ConfigIssues
from liftgate_plant.signals import Signal

RIG = shipped_rig()
BODY, BUTTON = 0x140, 0x130
CONFIGS = Path(RIG.source).parents[1]


def recorded(folder: Path, text: str, **more: Any) -> tuple[Any, list[tuple[float, int, bytes]]]:
    """A run, and the frames sent by the bench: (time, identifier, payload)."""
    (folder / "s.toml").write_text("duration = 1.0\n" + text, encoding="utf-8")
    log = folder / "s.log"
    result = lh.run(folder / "s.toml", record=log, **more)
    frames = []
    for line in log.read_text().splitlines():
        stamp, _, frame, *_ = line.split()
        identifier, _, payload = frame.partition("#")
        frames.append((float(stamp.strip("()")), int(identifier, 16), bytes.fromhex(payload)))
    return result, frames


def of(frames: list[tuple[float, int, bytes]], identifier: int) -> list[tuple[float, bytes]]:
    """Return time [s] and payload of the frames with this identifier."""
    return [(time, payload) for time, own, payload in frames if own == identifier]


SPEED = '[[signal]]\nsignal = "Body.VehicleSpeed"\n'


def test_a_restbus_message_has_its_cycle_counter_checksum_and_start_values(tmp_path: Path) -> None:
    _, frames = recorded(tmp_path, SPEED + "time = 0.45\nvalue = 12.5\n")
    own = of(frames, BODY)
    assert [time for time, _ in own] == pytest.approx([0.1 * n for n in range(1, 11)])
    database = cantools.database.load_file(RIG.database)
    for n, (time, payload) in enumerate(own):
        said = database.decode_message(BODY, payload, decode_choices=False)
        assert said["AliveCounter"] == n
        assert said["Checksum"] == j1850(BODY, payload, 5)
        assert said["VehicleSpeed"] == (12.5 if time > 0.45 else 0.0)
        assert (said["Ignition"], said["KeyInRange"], said["Gear"]) == (1, 1, 0)


def test_a_signal_change_is_in_the_first_frame_at_or_after_its_time(tmp_path: Path) -> None:
    text = "".join(f"{SPEED}time = {time}\nvalue = {time}\n" for time in (0.3, 0.7, 0.7))
    _, frames = recorded(tmp_path, text)
    speeds = [int.from_bytes(payload[1:3], "little") / 100 for _, payload in of(frames, BODY)]
    assert speeds == [0, 0, 0.3, 0.3, 0.3, 0.3, 0.7, 0.7, 0.7, 0.7]


def test_a_signal_change_waits_for_its_condition(tmp_path: Path) -> None:
    ask = '[[request]]\ntime = 0.1\naction = "open"\n'
    text = ask + SPEED + 'time = "left_current_a > 1"\ndelay_s = 0.2\nvalue = 7\n'
    result, frames = recorded(tmp_path, text, trace=True)
    current, times = result.trace["left_current_a"], result.trace["time_s"]
    came = float(times[current > 1.0][0]) + 0.2
    for time, payload in of(frames, BODY):
        assert (payload[1:3] != b"\0\0") == (time >= came)


def test_a_restbus_does_not_affect_the_gate_and_its_frames(tmp_path: Path) -> None:
    ask = '[[request]]\ntime = 0.1\naction = "open"\n'
    alone, said = recorded(tmp_path, ask)
    beside, heard = recorded(tmp_path, ask + SPEED + "value = 30\n")
    assert beside.maxima == alone.maxima
    assert [each for each in heard if each[1] not in (BODY, BUTTON)] == said


def test_labels_of_the_database_can_be_signal_values(tmp_path: Path) -> None:
    text = '[[signal]]\nsignal = "Body.Ignition"\nvalue = "crank"\n'
    _, frames = recorded(tmp_path, text)
    assert {payload[0] & 3 for _, payload in of(frames, BODY)} == {2}


OWN = 'counter = "AliveCounter"\nchecksum = "Checksum"\n'


def rig_with(folder: Path, protection: str) -> Path:
    """Write the shipped rig with another protection of Body; return its path."""
    text = Path(RIG.source).read_text(encoding="utf-8").replace('"liftgate.dbc"', f'"{RIG.database}"')
    assert f"[messages.Body]\n{OWN}" in text
    text = text.replace(f"[messages.Body]\n{OWN}", f"[messages.Body]\n{protection}")
    return text_file(folder / "their.toml", text)


def test_wrong_protection_of_a_restbus_message_is_reported_with_the_file(tmp_path: Path) -> None:
    """The message has no mapped signal, so that only a scenario that sets its signal uses it."""
    rig = rig_with(tmp_path, 'checksum = "Checksum"\nprotection = "e2e-p01"\ndata_id = 0x1234\n')
    assert issues_of(recorded, tmp_path, SPEED + "value = 30\n", rig=rig) == [
        f"{rig}: messages.Body.counter: missing; allowed: the signal of e2e-p01"
    ]


def test_restbus_messages_have_the_protection_of_the_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Judged by an ECU's receiver; in plain Python, as a rig with profiles has machine code of its own."""
    monkeypatch.setenv("LIFTGATE_COMPILE", "0")
    rig = load_rig(rig_with(tmp_path, f'{OWN}protection = "e2e-p01"\ndata_id = 0x1234\n'))
    _, frames = recorded(tmp_path, SPEED + "value = 30\n", rig=rig)
    issues = ConfigIssues("")
    bus = build_bus_config(
        rig.messages,
        [mapping_named("Body.VehicleSpeed")],
        rig.options,
        {"Body.VehicleSpeed": Signal("", -1e9, 1e9, "")},
        issues,
        False,
    )
    reception, counts = nothing_received(bus, 1), NO_COUNTS
    own = of(frames, BODY)
    for time, payload in own:
        counts = receive(bus, reception, counts, frames_of([(BODY, payload)]), round(time * 1e9))
    # The first one only begins the sequence.
    assert (counts.accepted, counts.unqualified, len(own)) == (9, 1, 10)
    assert reception.values[0] == 30.0
    bent = bytes([own[-1][1][0] ^ 1, *own[-1][1][1:]])
    assert receive(bus, reception, NO_COUNTS, frames_of([(BODY, bent)]), 10**9).accepted == 0


def test_bus_faults_apply_to_restbus_messages_too(tmp_path: Path) -> None:
    fault = '[[fault]]\nkind = "frame_lost"\nwhere = "Body"\ndirection = "sent"\nstart = 0.55\n'
    _, frames = recorded(tmp_path, SPEED + "value = 30\n" + fault)
    assert [time for time, _ in of(frames, BODY)] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])
    assert len(of(frames, 0x210)) == 201  # the last one when the run ends


def test_a_signal_set_from_python_is_sent_until_changed() -> None:
    with lh.Gate() as gate:
        assert not [each for each in gate.step(0.2) if each.arbitration_id == BODY]
        gate.signal("Body.VehicleSpeed", 30)
        first = [each for each in gate.step(0.2) if each.arbitration_id == BODY]
        gate.signal("DriverRequest.Button", "open")
        gate.signal("Body.VehicleSpeed", 60)
        fault = gate.fault("frame_lost", where="DriverRequest", direction="sent")
        second = gate.step(0.2)
        fault.clear()
        gate.signal("Body.VehicleSpeed", None)
        third = gate.step(0.2)
    speeds = [int.from_bytes(each.data[1:3], "little") / 100 for each in first]
    assert speeds == [30.0] * len(speeds)
    assert len(speeds) >= 2
    then = [each for each in second if each.arbitration_id == BODY]
    assert {int.from_bytes(each.data[1:3], "little") for each in then} == {6000}
    assert not [each for each in second if each.arbitration_id == BUTTON]
    last = [each for each in third if each.arbitration_id == BODY]
    assert {int.from_bytes(each.data[1:3], "little") for each in last} == {0}
    # Through all of it the counter goes on.
    counters = [each.data[4] & 15 for each in (*first, *then, *last)]
    assert counters == list(range(len(counters)))
    assert [each for each in third if each.arbitration_id == BUTTON]


def issue_of(folder: Path, text: str) -> str:
    """The single issue of a scenario, without the name of its file."""
    path = text_file(folder / "s.toml", f"duration = 1.0\n{text}")
    (issue,) = issues_of(lh.run, path)
    assert issue.startswith(f"{path}: ")
    return issue.removeprefix(f"{path}: ")


WRONG = [
    ('signal = "Nope.X"', "no such message; allowed: MESSAGE.SIGNAL of BenchInject, Body, DriverRequest"),
    ('signal = "Body.Nope"', "no such signal; allowed: Body.{Ignition, KeyInRange, Gear, VehicleSpeed}"),
    ('signal = "Body.AliveCounter"', "its protection or multiplexer sets it"),
    ('signal = "Gate.Angle"', "the gate or the ECU sends it"),
    ('signal = "DriveCommand.LeftDuty"', "the gate or the ECU sends it"),
]


@pytest.mark.parametrize(("line", "said"), WRONG)
def test_a_signal_that_the_bench_cannot_send_is_reported(tmp_path: Path, line: str, said: str) -> None:
    issue = issue_of(tmp_path, f"[[signal]]\n{line}\nvalue = 1\n")
    assert issue.startswith("signal[0].signal: ")
    assert said in issue


@pytest.mark.parametrize("value", ["999", "-1", "nan", "1" + 400 * "0", "true", '"fast"', '""', "[]"])
def test_a_value_that_the_signal_cannot_have_is_reported(tmp_path: Path, value: str) -> None:
    issue = issue_of(tmp_path, f"{SPEED}value = {value}\n")
    assert issue.startswith("signal[0].value: ")
    assert "allowed: " in issue


def test_an_offline_simulation_ignores_the_restbus(tmp_path: Path) -> None:
    from liftgate_hil.plan.setup import setup_of
    from liftgate_hil.plan.stimulation import offline_of

    path = text_file(tmp_path / "s.toml", f"duration = 1.0\n{SPEED}value = 30\n")
    assert len(offline_of(setup_of(path), 0.001).stimuli.restbus.bus.messages) == 0
