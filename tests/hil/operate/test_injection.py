"""Faults, requests and signals by BenchInject frames of a test bench, in every loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hil_support import CALM, OPEN, both, command_frame, j1850, shipped_rig
from hypothesis import given, settings
from hypothesis import strategies as st

import liftgate_hil as lh
from liftgate_hil.codec.frames import LOGGED
from liftgate_hil.config.fault_kinds import DRIVE, FAULT_KINDS, MESSAGE
from liftgate_hil.config.rig import read_rig
from liftgate_hil.config.rig_fit import check_fit
from liftgate_hil.errors import ConfigError
from liftgate_hil.operate.loop_target import LoopTarget
from liftgate_hil.operate.orders import Orders
from liftgate_hil.plan.setup import setup_of, vehicle_from
from liftgate_hil.plan.stimulation import injections_of, opening_of, planned_stimuli
from liftgate_hil.signals import DIRECTIONS
from liftgate_hil.stimuli.restbus import BENCH
from liftgate_hil.stimuli.stimulus_plan import stimulus_plan_of, turns
from liftgate_plant.constants import constants_of

RIG = shipped_rig()
INJECT, BUTTON, BODY = 0x6E4, 0x130, 0x140
MESSAGE_OF_IT = RIG.messages["BenchInject"]

# Of each kind what it takes, as a scenario says it.
VALUES: Mapping[str, Mapping[str, Any]] = {
    "bridge_stuck": {"state": "close"}, "contact_resistance": {"ohm": 0.1}, "hall_a_stuck": {"value": 1},
    "hall_b_stuck": {"value": 0}, "hall_missing": {"probability": 0.3}, "hall_extra": {"rate": 200},
    "current_offset": {"value": 1.5}, "current_gain": {"factor": 0.5}, "angle_offset": {"value": 3},
    "latch_stuck": {"value": 1}, "spring_weak": {"factor": 0.5}, "friction": {"factor": 4},
    "parameter": {"key": "gate.mass", "value": 48}, "frame_lost": {"probability": 0.5},
    "frame_delayed": {"delay_s": 0.05},
}  # fmt: skip


def frame(what: str, **signals: Any) -> can.Message:
    """Return a BenchInject frame with this order and signals."""
    data = MESSAGE_OF_IT.encode({"Order": what, **signals})
    return can.Message(arbitration_id=INJECT, data=data, is_extended_id=False)


def fault(kind: str, place: str = "none", value: float = 0.0, on: int = 1, way: int = 0) -> can.Message:
    """Return a BenchInject frame that begins (`on` 1) or ends a fault; `way` is its signal FaultFrames."""
    said = {"FaultKind": kind, "FaultPlace": place, "FaultValue": value}
    return frame("fault", FaultOn=on, FaultFrames=way, **said)


def ordered(kind: str) -> tuple[can.Message, dict[str, Any]]:
    """A kind of fault as a BenchInject order, as a scenario's table and as a call."""
    own, values = FAULT_KINDS[kind], dict(VALUES.get(kind, {}))
    number = next((each for key, each in values.items() if key not in ("key", "state")), 0.0)
    if kind == "bridge_stuck":
        number = DIRECTIONS.index(values["state"])
    if kind == "babbling":
        said = {"BabblingId": 0x55, "BabblingRate": 400, "BabblingFrames": "sent"}
        return frame("babbling", BabblingOn=1, **said), {"id": 0x55, "rate": 400, "direction": "sent"}
    place = values.get("key") or {DRIVE: "left", MESSAGE: "LeftDrive"}.get(own.of, "none")
    if own.has_place:
        values["where"] = place
    if own.of == MESSAGE:
        values["direction"] = "sent"
    return fault(kind, place, number), values


class Bench:
    """An ECU that opens, on a bus with a test bench that sends orders at its times."""

    period_s = 0.01

    def __init__(self, orders: Mapping[float, Sequence[can.Message]]) -> None:
        self._orders = {round(time * 100): list(each) for time, each in orders.items()}
        self._turn = 0

    def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
        identifier, payload = command_frame(RIG, self._turn, **both(60.0, OPEN, 1))
        self._turn += 1
        command = can.Message(arbitration_id=identifier, data=payload, is_extended_id=False)
        return [command, *self._orders.pop(round(now_s * 100), [])]


def ran(
    folder: Path, orders: Mapping[float, Sequence[can.Message]], text: str = "", duration: float = 1.0
) -> tuple[Any, Any]:
    """Result and bus log (time, frame), without orders, of a run with orders by time [s] and this scenario."""
    path, log = folder / "s.toml", folder / "s.log"
    path.write_text(f"duration = {duration}\ninitial = 30\nseed = 5\n{text}", encoding="utf-8")
    result = lh.run(path, Bench(orders), "lockstep", record=log, trace=True)
    lines = [line.split()[:3:2] for line in log.read_text(encoding="utf-8").splitlines()]
    return result, [line for line in lines if not line[1].startswith(f"{INJECT:X}#")]


_PLAIN: list[Any] = []


def plainly(folder: Path) -> Any:
    """A run without orders and faults, shared by all tests."""
    if not _PLAIN:
        _PLAIN.append(ran(folder, {}, duration=0.5))
    return _PLAIN[0]


def toml(values: Mapping[str, Any]) -> str:
    return "".join(f"{key} = {each!r}\n" for key, each in values.items())


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_an_injected_fault_acts_like_that_of_a_scenario_from_the_next_tick_until_cleared(
    tmp_path: Path, kind: str
) -> None:
    order, values = ordered(kind)
    off = can.Message(arbitration_id=INJECT, data=bytes(order.data), is_extended_id=False)
    off.data[0] &= ~0x10
    text = f'[[fault]]\nkind = "{kind}"\nstart = 0.201\nend = 0.401\n{toml(values)}'
    theirs, said = ran(tmp_path, {0.2: [order], 0.4: [off]}, duration=0.5)
    ours, wanted = ran(tmp_path, {}, text, duration=0.5)
    plain, untouched = plainly(tmp_path)
    assert len(theirs.summary.injected) == 2
    for name, column in ours.trace.items():
        if name != "faults_in_force":  # tells them apart
            np.testing.assert_array_equal(theirs.trace[name], column, err_msg=name)
    assert said == wanted
    is_seen = any(not np.array_equal(plain.trace[name], each) for name, each in ours.trace.items())
    assert is_seen or wanted != untouched or kind == "latch_not_releasing"


def test_injecting_another_value_replaces_the_first_and_keeps_other_faults(tmp_path: Path) -> None:
    orders = {
        0.2: [fault("spring_weak", "left", 0.5), fault("current_offset", "right", 2.0)],
        0.4: [fault("spring_weak", "left", 0.25)],
        0.6: [fault("none", on=0)],
    }
    text = (
        '[[fault]]\nkind = "spring_weak"\nwhere = "left"\nfactor = 0.5\nstart = 0.201\nend = 0.401\n'
        '[[fault]]\nkind = "current_offset"\nwhere = "right"\nvalue = 2.0\nstart = 0.201\nend = 0.601\n'
        '[[fault]]\nkind = "spring_weak"\nwhere = "left"\nfactor = 0.25\nstart = 0.401\nend = 0.601\n'
    )
    theirs, _ = ran(tmp_path, orders)
    ours, _ = ran(tmp_path, {}, text)
    for name, column in ours.trace.items():
        if name != "faults_in_force":  # tells them apart
            np.testing.assert_array_equal(theirs.trace[name], column, err_msg=name)
    assert [each.partition(": ")[2] for each in theirs.summary.injected] == [
        "spring_weak left begins, factor 0.5",
        "current_offset right begins, value 2",
        "spring_weak left begins, factor 0.25",
        "all faults end",
    ]


def test_injected_faults_leave_those_of_the_scenario_unchanged(tmp_path: Path) -> None:
    text = (
        '[[fault]]\nkind = "friction"\nwhere = "both"\nfactor = 2.0\nstart = "gate_angle_deg > 30.5"\n'
        '[[fault]]\nkind = "hall_missing"\nwhere = "left"\nprobability = 0.5\nstart = 0.3\n'
    )
    own = '[[fault]]\nkind = "parameter"\nkey = "gate.mass"\nvalue = 48\nstart = 0.501\nend = 0.701\n'
    theirs, _ = ran(tmp_path, {0.5: [fault("parameter", "gate.mass", 48)], 0.7: [fault("none", on=0)]}, text)
    ours, _ = ran(tmp_path, {}, text + own)
    for name, column in ours.trace.items():
        if name != "faults_in_force":  # tells them apart
            np.testing.assert_array_equal(theirs.trace[name], column, err_msg=name)


def test_an_invalid_order_is_reported_and_counted_without_effect(tmp_path: Path) -> None:
    wrong = {
        fault("hall_a_stuck", "gate.mass"): "'gate.mass'; allowed: one of left, right, both",
        fault("hall_missing", "left", 7.0): "probability: 7.0 is out of range; allowed: 0 to 1",
        fault("hall_a_stuck", "left", 0.5): "value: 0.5; allowed: 0 (low) or 1 (high)",
        fault("bridge_stuck", "left", 9.0): "state: 9.0; allowed: one of coast, open, close, brake",
        fault("frame_lost", "none"): "direction none; allowed: sent or received",
        fault("frame_lost", "Gate", 0.5, way=2): "'Gate': not a message that the gate receives",
        fault("wrong_counter", "Gate"): "'Gate': not a message with a counter that the gate or its restbus sends",
        fault("parameter", "left", 1.0): "'left': no such parameter",
        fault("parameter", "gate.mass", -1.0): "-1 is out of range",
        fault("motor_open", "left", on=0): "motor_open left is not active; allowed: to end an injected fault",
        frame("request", Request="reset"): "request reset; allowed with [reset] in the rig",
        frame("signal", SignalName="none", SignalValue=1.0): "signal none; allowed: Body.Ignition, ",
        frame("signal", SignalName="Body.Gear", SignalValue=9.0): "value: 9.0; allowed: 0 to 4",
        frame("signal", SignalName="Body.Gear", SignalValue=float("nan")): "SignalValue is nan; allowed: ",
    }  # fmt: skip
    raw = {
        b"\x0f" * 8: "expected multiplexer id 0, 1, 2 or 3, but got 15",
        b"\x00" * 3: "3 bytes; allowed: 8",
        bytes([0x10, 250, 1, 0, 0, 0, 0, 0]): "kind 250; allowed: a label that is a kind",
        bytes([0x10, 1, 1, 0, 0, 0, 0, 0]): "where: supply_open affects the gate as a whole",
        bytes([0x10, 2, 250, 0, 0, 0, 0, 0]): "'250'; allowed: one of left, right, both",
    }
    said: list[str] = []
    with lh.Gate(initial=30) as gate:
        gate._orders._say = said.append  # what an emulator tells
        gate.command(left_duty=60, right_duty=60, direction="open")
        gate.step(0.1)
        for message, words in wrong.items():
            gate.send(message)
            gate.step(0.001)
            assert words in said[-1], (words, said[-1])
            assert " refused: " in said[-1]
        for data, words in raw.items():
            gate.send(can.Message(arbitration_id=INJECT, data=data, is_extended_id=False))
            gate.step(0.001)
            assert words in said[-1]
        count = len(said)
        assert gate.summary.injections_refused == count
        assert gate.summary.injected == []
    theirs, _ = ran(tmp_path, {0.01 * n: [each] for n, each in enumerate(wrong, start=1)})
    ours, _ = ran(tmp_path, {})
    assert theirs.summary.injections_refused == len(wrong)
    assert any(f"{len(wrong)} refused" in line for line in theirs.summary.lines())
    for name, column in ours.trace.items():
        if name != "faults_in_force":  # tells them apart
            np.testing.assert_array_equal(theirs.trace[name], column, err_msg=name)


@settings(CALM, max_examples=30)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["hall_a_stuck", "friction", "parameter", "current_gain"]),
            st.sampled_from(["left", "both", "right"]),
            st.sampled_from([0.0, 1.0]),
            st.booleans(),
        ),
        max_size=12,
    )
)
def test_injected_faults_act_like_planned_ones_in_order_of_injection(orders: list[Any]) -> None:
    """The slots of a running plan have the same constants in force as a plan made with these faults."""
    setup = setup_of(None)
    stimuli = planned_stimuli(setup, RIG, opening=opening_of(RIG, has_operator=False))
    target = LoopTarget(stimuli, setup, RIG, RIG.settable)
    running, rows = Orders(RIG, target.layer(BENCH)), np.zeros(1, dtype=LOGGED)
    for number, (kind, side, value, is_on) in enumerate(orders):
        place = "gate.mass" if kind == "parameter" else side
        data = fault(kind, place, 30.0 + value if kind == "parameter" else value, int(is_on)).data
        rows["identifier"], rows["length"] = INJECT, 8
        rows["payload"][0, :8] = list(data)
        running.look(rows, 0.001 * number)
        turns(stimuli, 0.001 * number)
        faults = list(running._faults.values())
        planned = stimulus_plan_of(
            constants_of(setup.vehicle), injections=injections_of(faults, setup.vehicle, RIG)
        )
        turns(planned, 0.001 * number)
        np.testing.assert_array_equal(stimuli.faults.row, planned.faults.row)


def test_several_faults_of_one_message_act_in_order_of_injection(tmp_path: Path) -> None:
    """A freeze holds the frame last sent; faults ordered later act on that frame, in any slot."""
    checksum, frozen = fault("wrong_checksum", "LeftDrive"), fault("frame_frozen", "LeftDrive")
    orders = {0.2: [checksum], 0.3: [frozen], 0.4: [fault("wrong_checksum", "LeftDrive", on=0)], 0.5: [checksum]}
    _, lines = ran(tmp_path, orders, duration=0.6)
    frames = [
        (float(time.strip("()")), bytes.fromhex(data.partition("#")[2]))
        for time, data in lines
        if data.startswith("210#")
    ]

    def right(begin: float, end: float) -> set[bool]:
        """Whether the checksums between two times [s] are correct, as the set of their answers."""
        own = [data for time, data in frames if begin + 0.011 < time < end]
        assert len(own) > 15
        return {data[7] == j1850(0x210, data, 7) for data in own}

    assert right(0.0, 0.2) == {True}
    assert right(0.2, 0.3) == {False}
    assert right(0.3, 0.4) == {False}  # as the last one before
    assert right(0.4, 0.5) == {False}
    assert right(0.5, 0.6) == {True}  # inverted again
    last = next(data for time, data in reversed(frames) if time < 0.301)
    assert {data[:7] for time, data in frames if 0.312 < time < 0.6} == {last[:7]}


def test_repeating_an_order_has_no_effect_and_any_value_clears_a_fault(tmp_path: Path) -> None:
    order = fault("frame_frozen", "Gate")
    once, said = ran(tmp_path, {0.2: [order], 0.7: [fault("frame_frozen", "Gate", 5.0, on=0)]})
    again, heard = ran(
        tmp_path, {0.2: [order], 0.3: [order], 0.5: [order], 0.7: [fault("frame_frozen", "Gate", 5.0, on=0)]}
    )
    assert said == heard
    assert once.summary.injected == again.summary.injected
    assert len(again.summary.injected) == 2


def test_several_babbling_faults_are_active_at_once_and_cleared_separately(tmp_path: Path) -> None:
    def babble(identifier: int, on: int) -> can.Message:
        said = {"BabblingId": identifier, "BabblingRate": 100, "BabblingFrames": "sent"}
        return frame("babbling", BabblingOn=on, **said)

    _, lines = ran(tmp_path, {0.2: [babble(0x55, 1), babble(0x66, 1)], 0.5: [babble(0x55, 0)]})
    ends = {
        name: max(float(time.strip("()")) for time, data in lines if data.startswith(name))
        for name in ("055#", "066#")
    }
    assert ends["055#"] == pytest.approx(0.5, abs=0.011)
    assert ends["066#"] > 0.98


def test_faults_on_the_restbus_do_not_keep_injected_orders_from_acting(tmp_path: Path) -> None:
    rig = tmp_path / "their.toml"
    text = Path(RIG.source).read_text(encoding="utf-8").replace('"liftgate.dbc"', f'"{RIG.database}"')
    head, _, rest = text.partition("[inject.babbling]")
    rig.write_text(head + rest[rest.index("[diagnostics]") - 1 :].lstrip("# "), encoding="utf-8")
    scenario = (
        '[[signal]]\nsignal = "Body.Gear"\nvalue = 3\n'
        '[[fault]]\nkind = "frame_lost"\nwhere = "Body"\ndirection = "sent"\nprobability = 0.5\n'
    )
    path = tmp_path / "s.toml"
    path.write_text(f"duration = 0.5\ninitial = 30\n{scenario}", encoding="utf-8")
    result = lh.run(path, Bench({0.2: [fault("motor_open", "left")]}), "lockstep", rig=rig)
    assert [each.partition(": ")[2] for each in result.summary.injected] == ["motor_open left begins"]


def test_releasing_a_button_does_not_undo_a_signal_ordered_meanwhile() -> None:
    with lh.Gate(initial=30) as gate:
        gate.send(frame("request", Request="close"))
        gate.step(0.1)
        gate.send(frame("signal", SignalName="DriverRequest.Button", SignalValue=1))
        sent = [each for each in gate.step(0.5) if each.arbitration_id == BUTTON]
    assert {each.data[0] & 3 for each in sent[1:]} == {1}


def test_up_to_32_faults_can_be_injected_at_a_time(tmp_path: Path) -> None:
    places = [each for each in RIG.messages if each in {wire.message for wire in RIG.outputs}]
    kinds = ("frame_lost", "frame_repeated", "frame_corrupted", "wrong_length", "frame_frozen")
    labels = {str(each) for each in MESSAGE_OF_IT.get_signal_by_name("FaultPlace").choices.values()}
    all_of_them = [fault(kind, place, 0.0) for kind in kinds for place in places if place in labels]
    result, _ = ran(tmp_path, {0.01 * n: [each] for n, each in enumerate(all_of_them[:40], 1)})
    assert len(result.summary.injected) == result.summary.injections == 32
    assert result.summary.injections_refused == 8


def test_an_injected_request_presses_and_releases_the_rigs_button() -> None:
    with lh.Gate(initial=30) as gate:
        gate.send(frame("request", Request="close"))  # read in the first tick
        sent = [each for each in gate.step(0.5) if each.arbitration_id == BUTTON]
    assert gate.summary.injected == ["0.001 s: request close"]
    pressed = [round(each.timestamp, 3) for each in sent if each.data[0] & 3 == 2]
    assert pressed == pytest.approx([0.02 * n for n in range(1, 11)])
    assert all(each.data[0] & 3 == 0 for each in sent if round(each.timestamp, 3) > 0.2)
    assert [each.data[1] & 15 for each in sent] == [n % 16 for n in range(len(sent))]


def test_an_injected_signal_is_sent_from_its_first_value_on(tmp_path: Path) -> None:
    order = frame("signal", SignalName="Body.VehicleSpeed", SignalValue=12.5)
    _, lines = ran(tmp_path, {0.25: [order], 0.55: [frame("signal", SignalName="Body.Gear", SignalValue=3)]})
    own = [bytes.fromhex(data.partition("#")[2]) for _, data in lines if data.startswith("140#")]
    said = [RIG.messages["Body"].decode(each, decode_choices=False) for each in own]
    assert [each["VehicleSpeed"] for each in said] == [12.5] * 8  # at 0.3 s, 0.4 s, …
    assert [each["Gear"] for each in said] == [0, 0, 0, 3, 3, 3, 3, 3]
    assert [each["AliveCounter"] for each in said] == list(range(8))


def test_clearing_an_injected_bus_off_restores_the_gates_frames(tmp_path: Path) -> None:
    _, lines = ran(tmp_path, {0.2: [fault("bus_off")], 0.4: [fault("bus_off", on=0)]})
    times = np.array([float(time.strip("()")) for time, data in lines if data.startswith("210#")])
    assert not np.any((times > 0.202) & (times < 0.4))
    assert np.sum(times > 0.4) == 121  # with the last one, of the motors off


def test_the_labels_in_the_database_cover_all_kinds_and_places_of_faults() -> None:
    kinds = {str(each) for each in MESSAGE_OF_IT.get_signal_by_name("FaultKind").choices.values()}
    assert kinds == {"none", *FAULT_KINDS} - {"babbling"}
    places = {str(each) for each in MESSAGE_OF_IT.get_signal_by_name("FaultPlace").choices.values()}
    assert {"none", "left", "right", "both"} < places
    assert {each.message for each in (*RIG.inputs, *RIG.outputs)} - places == {
        "BenchControl", "BenchTiming", "BenchDelay",
    }  # fmt: skip
    with lh.Gate() as gate:
        for place in [each for each in places if "." in each]:
            gate.fault("parameter", key=place, value=raised_value(gate, place))


def raised_value(gate: lh.Gate, key: str) -> float:
    """Return 1.01 times the vehicle's value of this parameter."""
    from liftgate_hil.config.parameters import find_parameter, value_of

    return value_of(gate._vehicle, find_parameter(gate._vehicle, key)) * 1.01


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"BenchInject.FaultKind"', '"BenchInject.Nothing"', "kind: 'BenchInject.Nothing': no such signal"),
        ('"BenchInject.FaultKind"', "3", "inject.fault.kind: 3; allowed: MESSAGE.SIGNAL"),
        ('kind = "BenchInject.FaultKind"\n', "", "inject.fault.kind: missing; allowed: MESSAGE.SIGNAL"),
        ('"BenchInject.FaultKind"', '"BenchInject.FaultValue"', "inject.fault.kind: FaultValue: no value table"),
        ('"BenchInject.FaultOn"', '"BenchControl.RoadSlope"', "signals of BenchInject, BenchControl"),
        ("[inject.request]", "[inject.wish]", "unknown key; allowed: fault, babbling, request, signal"),
        ('"BenchInject.Request"', '"BenchInject.FaultKind"', "inject.request.action: FaultKind: 'supply_open'"),
        ('"BenchInject.SignalName"', '"BenchInject.FaultPlace"', "'left': no such message"),
        ('"BenchInject.Request"', '"Gate.LatchState"', "inject.request: Gate: the gate sends it"),
        ('"BenchInject.Request"', '"DriverRequest.Button"', "DriverRequest is protected"),
        ('"BenchInject.FaultKind"', '"BenchInject.FaultPlace"', "kind: FaultPlace: left, right, both"),
    ],
)  # fmt: skip
def test_mistakes_in_the_injection_section_are_reported(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = Path(RIG.source).read_text(encoding="utf-8").replace('"liftgate.dbc"', f'"{RIG.database}"')
    assert old in text
    path = tmp_path / "their.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    rig, issues = read_rig(path)
    try:
        check_fit(rig, vehicle_from("suv"), 1000.0)
    except ConfigError as error:
        issues.take(error.issues)
    assert said in "\n".join(issues.lines)


def test_a_rig_without_an_injection_section_ignores_orders(tmp_path: Path) -> None:
    text = Path(RIG.source).read_text(encoding="utf-8").replace('"liftgate.dbc"', f'"{RIG.database}"')
    head, _, rest = text.partition("[inject.fault]")
    path = tmp_path / "their.toml"
    path.write_text(head + rest[rest.index("[diagnostics]") :], encoding="utf-8")
    with lh.Gate(rig=path, initial=30) as gate:
        gate.command(left_duty=60, right_duty=60, direction="open")
        gate.send(fault("motor_open", "left"))
        gate.step(0.2)
        assert gate.truth["left_current_a"] != 0.0
        assert gate.summary.received.foreign == 1


@pytest.mark.realtime
def test_in_real_time_orders_take_effect_in_order_of_arrival(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text("duration = 1.5\ninitial = 30\n", encoding="utf-8")
    orders = {
        0.2: [fault("motor_open", "left"), fault("current_offset", "right", 2.0)],
        0.8: [fault("motor_open", "left", on=0), fault("bus_off", on=0)],
        1.0: [frame("signal", SignalName="Body.Gear", SignalValue=3)],
    }
    bench = Bench({})
    step = bench.step

    def late(now_s: float, frames: list[can.Message]) -> list[can.Message]:
        due = [orders.pop(time) for time in sorted(orders) if time <= now_s]
        return [*step(now_s, frames), *(each for own in due for each in own)]

    bench.step = late  # type: ignore[method-assign]
    result = lh.run(path, bench, "realtime", trace=True)
    assert [each.partition(": ")[2] for each in result.summary.injected] == [
        "motor_open left begins",
        "current_offset right begins, value 2",
        "motor_open left ends",
        "Body.Gear = 3",
    ]
    assert result.summary.injections_refused == 1
    is_open = result.trace["left_current_a"] == 0.0
    begun = np.flatnonzero(is_open & (result.trace["time_s"] > 0.2))
    assert len(begun) > 100
    assert not is_open[-200:].all()
    offset = result.trace["sensed_right_current_a"] - result.trace["right_current_a"]
    assert np.median(offset[-200:]) == pytest.approx(2.0, abs=0.1)
