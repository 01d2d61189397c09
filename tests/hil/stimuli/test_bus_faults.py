"""Each kind of fault on the bus: exactly the frames that are asked for, and nothing else touched.

Two gates get the same commands with the same seed; one of them has the fault. The gate's own truth does not hang
on what others hear of it.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hil_support import j1850, shipped_rig, text_file

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.errors import ConfigError

LEFT, RIGHT = 0x210, 0x211


def opening(**more: Any) -> lh.Gate:
    """A gate that has been opening for half a second."""
    gate = lh.Gate(initial=30, seed=3, **more)
    gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
    gate.step(0.5)
    return gate


def of(frames: list[Any], identifier: int) -> list[tuple[float, bytes]]:
    """Return time [s] and payload of the frames with this identifier."""
    return [
        (round(float(each.timestamp), 6), bytes(each.data)) for each in frames if each.arbitration_id == identifier
    ]


@cache
def sound(seconds: float) -> tuple[list[Any], Any, Any]:
    """Frames of a gate without faults in these seconds, and its truth and sensor readings at the end."""
    gate = opening()
    return gate.step(seconds), gate.truth, gate.sensed


def pair(kind: str, seconds: float = 0.5, **values: Any) -> tuple[list[Any], list[Any]]:
    """Frames sent by a gate without and by one with a fault; asserts that their truths are bit-identical."""
    said, truth, sensed = sound(seconds)
    broken = opening()
    broken.fault(kind, **values)
    heard = broken.step(seconds)
    if values.get("direction") == "sent":
        assert broken.truth == truth
        assert broken.sensed == sensed
    return said, heard


def others(frames: list[Any], identifier: int) -> list[tuple[float, int, bytes]]:
    """Return time [s], identifier and payload of the frames with another identifier."""
    return [
        (float(each.timestamp), each.arbitration_id, bytes(each.data))
        for each in frames
        if each.arbitration_id != identifier
    ]


def test_frames_are_lost_with_the_given_probability_and_those_of_other_messages_are_not() -> None:
    said, heard = pair("frame_lost", 5.0, where="LeftDrive", direction="sent", probability=0.3, seed=7)
    left, all_left = of(heard, LEFT), of(said, LEFT)
    assert set(left) < set(all_left)
    assert len(all_left) == 1000
    assert abs(len(left) - 700) < 4 * (1000 * 0.3 * 0.7) ** 0.5
    assert others(heard, LEFT) == others(said, LEFT)
    begin = [each for each in left if each[0] <= 1.0]
    for seed, is_same in ((7, True), (8, False)):
        gate = opening()
        gate.fault("frame_lost", where="LeftDrive", direction="sent", probability=0.3, seed=seed)
        assert (of(gate.step(0.5), LEFT) == begin) == is_same


def test_delayed_frames_are_sent_later_by_the_delay() -> None:
    said, heard = pair("frame_delayed", 0.5, where="LeftDrive", direction="sent", delay_s=0.023)
    late = [(round(time + 0.023, 6), data) for time, data in of(said, LEFT)]
    assert of(heard, LEFT) == [each for each in late if each[0] <= 1.0]
    assert others(heard, LEFT) == others(said, LEFT)


def test_repeated_frames_are_sent_twice() -> None:
    said, heard = pair("frame_repeated", where="LeftDrive", direction="sent")
    assert of(heard, LEFT) == [each for each in of(said, LEFT) for _ in range(2)]
    assert others(heard, LEFT) == others(said, LEFT)


def test_a_corrupted_frame_has_exactly_one_random_bit_flipped() -> None:
    said, heard = pair("frame_corrupted", 2.0, where="LeftDrive", direction="sent")
    places = Counter()
    for (then, good), (when, bad) in zip(of(said, LEFT), of(heard, LEFT), strict=True):
        difference = int.from_bytes(good, "little") ^ int.from_bytes(bad, "little")
        assert difference.bit_count() == 1
        assert then == when
        places[difference] += 1
    assert len(places) > 55  # of 64, in 400 frames
    assert max(places.values()) <= 20  # of 6.25 on average: no bit is preferred
    assert others(heard, LEFT) == others(said, LEFT)


def decoded(data: bytes) -> dict[str, Any]:
    values: Any = shipped_rig().messages["LeftDrive"].decode(data, decode_choices=False)
    return values


def test_a_frame_with_a_frozen_counter_has_a_correct_checksum() -> None:
    said, heard = pair("wrong_counter", where="LeftDrive", direction="sent")
    good, bad = ([decoded(data) for _, data in of(each, LEFT)] for each in (said, heard))
    before = (int(good[0]["AliveCounter"]) - 1) % 16
    assert {each["AliveCounter"] for each in bad} == {before}
    assert [each["MotorCurrent"] for each in bad] == [each["MotorCurrent"] for each in good]
    for _, data in of(heard, LEFT):
        assert data[7] == j1850(LEFT, data, 7)


def test_a_checksum_fault_changes_only_the_checksum() -> None:
    said, heard = pair("wrong_checksum", where="LeftDrive", direction="sent")
    for (_, good), (_, bad) in zip(of(said, LEFT), of(heard, LEFT), strict=True):
        assert bad[:7] == good[:7]
        assert bad[7] == good[7] ^ 0xFF
    assert others(heard, LEFT) == others(said, LEFT)


def test_a_truncated_frame_is_too_short() -> None:
    said, heard = pair("wrong_length", where="LeftDrive", direction="sent")
    assert [data for _, data in of(heard, LEFT)] == [data[:7] for _, data in of(said, LEFT)]


def test_a_frozen_frame_keeps_its_data() -> None:
    said, heard = pair("frame_frozen", where="LeftDrive", direction="sent")
    assert {data for _, data in of(heard, LEFT)} == {payload_before_faults(LEFT)}
    assert len(of(heard, LEFT)) == len(of(said, LEFT))


@cache
def payload_before_faults(identifier: int) -> bytes:
    """Payload of the last frame of a message in `opening`, so before the faults of `pair` begin."""
    gate = lh.Gate(initial=30, seed=3)
    gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
    return of(gate.step(0.5), identifier)[-1][1]


def test_an_intermittent_freeze_holds_the_last_frame_before_each_onset() -> None:
    broken = opening()
    times = {"period_s": 0.1, "share": 0.35}
    broken.fault("frame_frozen", where="LeftDrive", direction="sent", **times)
    said, heard = of(sound(0.5)[0], LEFT), of(broken.step(0.5), LEFT)
    frozen = [place for place in range(100) if round(5 * (place + 1)) % 100 in range(5, 36)]
    for place in range(100):
        if place not in frozen:
            assert heard[place] == said[place]
        else:
            begin = place - (place % 20)
            last = payload_before_faults(LEFT) if begin == 0 else said[begin - 1][1]
            assert heard[place][1] == last


def test_several_faults_of_a_message_act_in_the_order_in_which_they_were_set() -> None:
    """A counter fault computes the checksum anew: it corrects a checksum fault set before it only."""
    for kinds, is_right in (
        (("wrong_checksum", "frame_frozen"), False),
        (("frame_frozen", "wrong_checksum"), False),
        (("wrong_checksum", "wrong_counter"), True),
        (("wrong_counter", "wrong_checksum"), False),
    ):
        gate = opening()
        for kind in kinds:
            gate.fault(kind, where="LeftDrive", direction="sent")
            gate.step(0.02)
        for _, data in of(gate.step(0.05), LEFT):
            assert (data[7] == j1850(LEFT, data, 7)) == is_right, kinds


def test_a_freeze_before_the_first_frame_holds_the_first_frame() -> None:
    gate = lh.Gate(initial=30, seed=3)
    gate.fault("frame_frozen", where="LeftDrive", direction="sent")
    sent = of(gate.step(0.05), LEFT)
    assert len(sent) > 5
    assert {data for _, data in sent} == {sent[0][1]}


def test_a_freeze_without_a_message_freezes_each_message_separately() -> None:
    said, heard = pair("frame_frozen", direction="sent")
    for identifier in {each.arbitration_id for each in said}:
        assert {data for _, data in of(heard, identifier)} == {payload_before_faults(identifier)}


@pytest.mark.parametrize(("identifier", "rate"), [(0x5, 300.0), (0x18FF0001, 2500.0)])
def test_a_babbling_node_sends_frames_at_its_rate(identifier: int, rate: float) -> None:
    said, heard = pair("babbling", 1.0, direction="sent", id=identifier, rate=rate)
    added = of(heard, identifier)
    assert abs(len(added) - rate) <= 1 + rate * 0.001  # the first tick sends one
    assert {data for _, data in added} == {bytes(8)}
    assert {each.is_extended_id for each in heard if each.arbitration_id == identifier} == {identifier > 0x7FF}
    assert others(heard, identifier) == others(said, identifier)


def test_a_gate_in_bus_off_neither_sends_nor_receives() -> None:
    gate = opening()
    before = gate.summary.received
    off = gate.fault("bus_off")
    assert gate.step(0.2) == []
    assert gate.summary.received == before
    assert gate.summary.command_timeouts == 1
    off.clear()
    assert gate.step(0.1)
    assert gate.summary.received.accepted > before.accepted


def test_frames_of_a_babbling_node_during_bus_off_are_not_made_up_for_afterwards() -> None:
    gate = lh.Gate(initial=30, seed=3)
    gate.fault("babbling", direction="sent", id=5, rate=500.0)
    assert gate.step(0.1)
    off = gate.fault("bus_off")
    assert gate.step(1.0) == []
    off.clear()
    assert len(of(gate.step(0.1), 5)) == pytest.approx(50, abs=2)


# What the gate receives: the message, the fault, which count of those refused grows, whether the drives go on.
COMMANDS = [
    ("frame_lost", {}, None, False),
    ("wrong_checksum", {}, "checksum", False),
    ("wrong_counter", {}, "counter", False),
    ("wrong_length", {}, "wrong_length", False),
    ("frame_frozen", {}, "counter", False),
    ("frame_corrupted", {}, "checksum", False),
    ("frame_repeated", {}, "counter", True),
    ("frame_delayed", {"delay_s": 0.02}, None, True),
]


@pytest.mark.parametrize(("kind", "values", "count", "goes_on"), COMMANDS, ids=[each[0] for each in COMMANDS])
def test_a_fault_of_received_commands_acts_on_the_gate(
    kind: str, values: dict[str, Any], count: str | None, goes_on: bool
) -> None:
    gate = opening()
    before = gate.summary.received
    gate.fault(kind, where="DriveCommand", direction="received", **values)
    gate.step(0.02)  # two commands, before the time-out
    assert goes_on or gate.summary.received.accepted == before.accepted  # not one more gets through
    gate.step(0.18)
    after = gate.summary.received
    refused = {name for name in after._fields if getattr(after, name) != getattr(before, name)} - {"accepted"}
    if kind == "frame_corrupted":  # a bit of the identifier's or length's is not among them
        assert count in refused
    else:
        assert refused == ({count} if count else set())
    # One whose counter stands still is believed again, once, after each time-out.
    assert (gate.summary.command_timeouts == 0) == goes_on
    if goes_on:
        assert gate.truth["left_current_a"] > 0.3


def test_a_delayed_command_acts_later_by_exactly_the_delay() -> None:
    prompt, late = lh.Gate(initial=30, seed=3), lh.Gate(initial=30, seed=3)
    late.fault("frame_delayed", where="DriveCommand", direction="received", delay_s=0.05)
    for gate in (prompt, late):
        gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
    began: list[list[bool]] = [[], []]
    for _ in range(100):
        for gate, seen in zip((prompt, late), began, strict=True):
            gate.step(0.001)
            seen.append(gate.truth["left_current_a"] != 0.0)
    assert began[1].index(True) - began[0].index(True) == 50


def test_delayed_frames_still_arrive_after_the_fault_is_cleared() -> None:
    said, broken = opening().step(0.2), opening()
    fault = broken.fault("frame_delayed", where="LeftDrive", direction="sent", delay_s=0.05)
    heard = broken.step(0.1)
    fault.clear()
    heard += broken.step(0.1)
    assert {data for _, data in of(heard, LEFT)} == {data for _, data in of(said, LEFT)}
    assert len(of(heard, LEFT)) == len(of(said, LEFT))


def test_a_fault_continues_unchanged_when_another_one_begins() -> None:
    def heard(with_another: bool) -> list[tuple[float, bytes]]:
        gate = opening()
        gate.fault("frame_lost", where="LeftDrive", direction="sent", probability=0.5)
        frames = gate.step(0.2)
        if with_another:
            gate.fault("frame_repeated", where="RightDrive", direction="sent")
        return of(frames + gate.step(0.2), LEFT)

    assert heard(True) == heard(False)


SCENARIO = """
duration = 3.0
initial = 40
seed = 4
[[request]]
time = 0.1
action = "open"
[[fault]]
kind = "frame_lost"
where = "DriveCommand"
direction = "received"
probability = 0.2
seed = 2
[[fault]]
kind = "frame_corrupted"
where = "LeftDrive"
direction = "sent"
start = "gate_rate_degps > 3"
period_s = 0.1
share = 0.3
[[fault]]
kind = "frame_delayed"
where = "Gate"
direction = "sent"
delay_s = 0.015
[[fault]]
kind = "babbling"
direction = "received"
id = 0x333
rate = 400
start = 1.0
end = 2.0
[[expect]]
name = "moves"
eventually = "gate_angle_deg > 42"
"""


def test_runs_with_bus_faults_repeat_bit_for_bit_and_have_equal_frames_in_lockstep(tmp_path: Path) -> None:
    path = text_file(tmp_path / "s.toml", SCENARIO)
    logs = []
    for name, clock in (("a", "free"), ("b", "free"), ("c", "lockstep")):
        result = lh.run(path, clock=clock, record=tmp_path / f"{name}.log", trace=True)
        assert result.verdict == "pass"
        lines = (tmp_path / f"{name}.log").read_text().splitlines()
        logs.append([line.split()[0] + line.split()[2] for line in lines])
        received = result.summary.received
        assert received.foreign == pytest.approx(400, abs=1)
        assert received.lost > 0
    assert logs[0] == logs[1]
    assert Counter(logs[0]) == Counter(logs[2])


def test_faults_of_sent_frames_reach_the_reference_ecu(tmp_path: Path) -> None:
    def travel(fault: str) -> float:
        path = text_file(tmp_path / "s.toml", SCENARIO.split("[[fault]]", maxsplit=1)[0] + fault)
        return lh.run(path).maxima["gate_angle_deg"]

    silent = '[[fault]]\nkind = "frame_lost"\nwhere = "LeftDrive"\ndirection = "sent"\n'
    assert travel("") > 45.0
    assert travel(silent) < 40.5  # it has never heard of one drive: it does not move


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"kind": "frame_lost"}, "direction: missing; allowed: one of sent, received"),
        ({"kind": "frame_lost", "direction": "up"}, "direction: 'up'; allowed: one of sent, received"),
        (
            {"kind": "frame_lost", "direction": "sent", "where": "DriveCommand"},
            "where: 'DriveCommand': not a message that the gate or its restbus sends; allowed: LeftDrive, ",
        ),
        (
            {"kind": "wrong_counter", "direction": "sent", "where": "Gate"},
            "where: 'Gate': not a message with a counter that the gate or its restbus sends; allowed: LeftDrive, ",
        ),
        ({"kind": "bus_off", "where": "left"}, "where: bus_off affects the bus as a whole"),
        ({"kind": "babbling", "direction": "sent", "id": -1, "rate": 1.0}, "id: -1; allowed: a whole"),
        ({"kind": "babbling", "direction": "sent", "id": 1}, "rate: missing"),
        ({"kind": "frame_delayed", "direction": "sent"}, "delay_s: missing"),
    ],
)  # fmt: skip
def test_wrong_arguments_of_a_bus_fault_are_reported(arguments: dict[str, Any], said: str) -> None:
    with lh.Gate() as gate, pytest.raises(ConfigError) as caught:
        gate.fault(**arguments)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("fault", "arguments", "said"),
    [
        ('kind = "frame_lost"\ndirection = "sent"\nwhere = "Nope"', ("test",),
         "fault[0].where: 'Nope': not a message that the gate sends; allowed: LeftDrive, "),
        ('kind = "bus_off"', ("simulate", "--voltage", "5", "--scenario"),
         "fault[0].kind: bus_off: there is no bus"),
    ],
)  # fmt: skip
def test_a_bus_fault_whose_message_or_bus_is_missing_is_reported_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str, arguments: tuple[str, ...], said: str
) -> None:
    expect = '[[expect]]\nname = "still"\nalways = "gate_angle_deg < 1"\n'
    path = text_file(tmp_path / "s.toml", f"duration = 1\n[[fault]]\n{fault}\n{expect}")
    assert main([*arguments, str(path)]) == 2
    assert said in capsys.readouterr().err


def test_a_bus_fault_can_name_a_quantity_in_place_of_its_message() -> None:
    _, heard = pair("frame_lost", 0.1, where="left_current", direction="sent")
    assert of(heard, LEFT) == []
    assert len(of(heard, RIGHT)) == 20


def test_a_quantity_both_received_and_sent_means_the_message_of_the_faults_direction() -> None:
    """`road_slope` comes from the test bench, and is sent by a sensor."""
    with lh.Gate() as gate:
        gate.fault("frame_lost", where="road_slope", direction="sent")
        assert {each.arbitration_id for each in gate.step(0.2)} >= {LEFT, RIGHT}
        gate.fault("frame_lost", where="road_slope", direction="received")
        with pytest.raises(ConfigError, match=r"`fault`: where: 'road_slope' \(Sensors\): not a message with a"):
            gate.fault("wrong_counter", where="road_slope", direction="sent")
