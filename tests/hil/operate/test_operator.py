"""Commands of an operator during a lockstep run, through a socket, act like those of a scenario."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hil_support import OPEN, both, command_frame, shipped_rig

from liftgate_hil.drive.run import run_plan
from liftgate_hil.errors import ConfigError
from liftgate_hil.operate import operator
from liftgate_hil.operate.attachment.client import Client
from liftgate_hil.plan.plan import plan_of
from liftgate_hil.plan.request import Job, RunRequest

RIG = shipped_rig()
BODY, BUTTON = 0x140, 0x130


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


class Attached:
    """An ECU that opens the gate, and a client attached to the run that sends commands at its times."""

    period_s = 0.01

    def __init__(self, commands: Mapping[float, Sequence[object]]) -> None:
        self._commands = {round(time * 100): each for time, each in commands.items()}
        self._turn = 0
        self.client: Client | None = None
        self._posted: list[int] = []
        self.answers: list[dict[str, Any] | list[str]] = []
        self.news: dict[str, Any] = {}

    def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
        if self._turn:  # the run has begun
            self._observe(round(now_s * 100))
        identifier, payload = command_frame(RIG, self._turn, **both(60.0, OPEN, 1))
        self._turn += 1
        return [can.Message(arbitration_id=identifier, data=payload, is_extended_id=False)]

    def _observe(self, turn: int) -> None:
        if self.client is None:
            self.client = Client(os.getpid())
        for number in self._posted:
            try:
                self.answers.append(self.client.done(number))
            except ConfigError as error:
                self.answers.append(error.issues)
        self._posted = [self.client.post(each) for each in self._commands.pop(turn, ())]
        self.news = self.client.news(0)  # answered after the commands have come


def ran(
    folder: Path,
    commands: Mapping[float, Sequence[object]],
    text: str = "",
    duration: float = 0.6,
    ecu: Attached | None = None,
) -> tuple[Any, Attached, list[list[str]]]:
    """Run a scenario in lockstep; return the result, the ECU and the bus log (time, frame)."""
    path, log = folder / "s.toml", folder / "s.log"
    path.write_text(f"duration = {duration}\ninitial = 30\nseed = 5\n{text}", encoding="utf-8")
    ecu = ecu or Attached(commands)
    job = Job(RunRequest(path, ecu, "lockstep", record=log), trace=1, attachable_as=os.getpid())
    result = run_plan(plan_of(job))
    assert not result.reason
    lines = [line.split()[:3:2] for line in log.read_text(encoding="utf-8").splitlines()]
    if ecu.client is not None:
        ecu.client.close()
    return result, ecu, lines


def assert_same(theirs: Any, ours: Any) -> None:
    """Assert that two results have equal traces, but for the faults in force."""
    for name, column in ours.trace.items():
        if name == "faults_in_force":  # tells them apart
            continue
        np.testing.assert_array_equal(theirs.trace[name], column, err_msg=name)


FAULT = {"kind": "spring_weak", "where": "left", "factor": 0.5}
ROD = {"angle_deg": 32.0, "stiffness": 20_000, "meets": "opening"}


@pytest.mark.parametrize(
    ("command", "clear", "text"),
    [
        ({"fault": FAULT}, {"clear": "faults"},
         '[[fault]]\nkind = "spring_weak"\nwhere = "left"\nfactor = 0.5\nstart = 0.201\nend = 0.401\n'),
        ({"fault": FAULT}, {"clear": {"fault": {"kind": "spring_weak", "where": "left"}}},
         '[[fault]]\nkind = "spring_weak"\nwhere = "left"\nfactor = 0.5\nstart = 0.201\nend = 0.401\n'),
        ({"fault": {"kind": "angle_offset", "value": 3}}, {"clear": "all"},
         '[[fault]]\nkind = "angle_offset"\nvalue = 3\nstart = 0.201\nend = 0.401\n'),
        ({"fault": {"kind": "frame_lost", "where": "Gate", "direction": "sent"}}, {"clear": "all"},
         '[[fault]]\nkind = "frame_lost"\nwhere = "Gate"\ndirection = "sent"\nstart = 0.201\nend = 0.401\n'),
        ({"fault": {**FAULT, "period_s": 0.05, "share": 0.5}}, {"clear": "faults"},
         '[[fault]]\nkind = "spring_weak"\nwhere = "left"\nfactor = 0.5\nstart = 0.201\nend = 0.401\n'
         'period_s = 0.05\nshare = 0.5\n'),
        ({"set": {"supply_voltage_v": 10.5}}, {"clear": {"set": "supply_voltage_v"}},
         '[[profile]]\nquantity = "supply_voltage_v"\ninterpolation = "hold"\n'
         'points = [[0.0, 12.0], [0.201, 10.5], [0.401, 12.0]]\n'),
        ({"obstacle": ROD}, {"clear": "obstacle"},
         '[[obstacle]]\nangle_deg = 32\nstiffness = 20000\nmeets = "opening"\nstart = 0.201\nend = 0.401\n'),
        ({"signal": {"Body.VehicleSpeed": 12.5, "Body.Gear": "reverse"}},
         {"clear": {"signal": "Body.VehicleSpeed"}},
         '[[signal]]\nsignal = "Body.VehicleSpeed"\nvalue = 12.5\ntime = 0.201\n'
         '[[signal]]\nsignal = "Body.Gear"\nvalue = "reverse"\ntime = 0.201\n'
         '[[signal]]\nsignal = "Body.VehicleSpeed"\nvalue = 3\ntime = 0.401\n'),
    ],
)  # fmt: skip
def test_an_operators_command_acts_like_a_scenarios_from_the_next_tick_until_cleared(
    tmp_path: Path, command: Any, clear: Any, text: str
) -> None:
    base = '[[profile]]\nquantity = "supply_voltage_v"\npoints = [[0.0, 12.0]]\n'
    base = base if "set" in command else ""
    if "signal" in command:  # which the scenario says something of, too
        base = '[[signal]]\nsignal = "Body.VehicleSpeed"\nvalue = 3\n'
        text = base + text
    theirs, ecu, said = ran(tmp_path, {0.2: [command], 0.4: [clear]}, base)
    ours, _, wanted = ran(tmp_path, {}, text)
    plain, _, untouched = ran(tmp_path, {}, base)
    assert_same(theirs, ours)
    assert said == wanted
    assert said != untouched
    is_seen = any(not np.array_equal(plain.trace[name], each) for name, each in ours.trace.items())
    assert is_seen or "signal" in command or command["fault"]["kind"] == "frame_lost"
    assert [each["time_s"] for each in ecu.answers] == pytest.approx([0.201, 0.401], abs=1e-9)
    assert theirs.summary.commands == 2


def bodies(said: list[list[str]]) -> list[tuple[float, float]]:
    """(time [s], vehicle speed) of the restbus frames."""
    message = RIG.messages["Body"]
    return [
        (float(line[0][1:-1]), float(message.decode(bytes.fromhex(line[1].split("#")[1]))["VehicleSpeed"]))
        for line in said
        if line[1].startswith(f"{BODY:X}#")
    ]  # fmt: skip


def injecting(what: str, **signals: Any) -> can.Message:
    data = RIG.messages["BenchInject"].encode({"Order": what, **signals})
    return can.Message(arbitration_id=0x6E4, data=data, is_extended_id=False)


class WithBench(Attached):
    """A test bench on the same bus."""

    def __init__(self, commands: Mapping[float, Sequence[object]], orders: Mapping[float, can.Message]) -> None:
        super().__init__(commands)
        self._orders = {round(time * 100): each for time, each in orders.items()}

    def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
        sent = super().step(now_s, frames)
        order = self._orders.pop(round(now_s * 100), None)
        return sent if order is None else [*sent, order]


def test_operator_signals_override_the_benchs_and_these_the_scenarios(tmp_path: Path) -> None:
    def speed(value: float) -> can.Message:
        return injecting("signal", SignalName="Body.VehicleSpeed", SignalValue=value)

    name = "Body.VehicleSpeed"
    commands = {0.3: [{"signal": {name: 20}}], 0.8: [{"clear": {"signal": name}}]}
    ecu = WithBench(commands, {0.1: speed(10), 0.65: speed(11)})
    text = f'[[signal]]\nsignal = "{name}"\nvalue = 5\n[[signal]]\nsignal = "{name}"\nvalue = 6\ntime = 0.55\n'
    _, _, said = ran(tmp_path, {}, text, 1.0, ecu)
    values = bodies(said)

    def at(time: float) -> float:
        return [value for when, value in values if when <= time][-1]

    assert [at(time) for time in (0.15, 0.25, 0.45, 0.75, 0.95)] == [5, 10, 20, 20, 11]


def test_operator_faults_override_those_that_the_bench_injects_later(tmp_path: Path) -> None:
    weak = {"kind": "current_gain", "where": "left", "factor": 3.0}
    frozen = injecting("fault", FaultOn=1, FaultKind="current_frozen", FaultPlace="left",
                       FaultValue=0, FaultFrames=0)  # fmt: skip
    stuck = {"kind": "latch_stuck", "value": "open"}
    latched = injecting("fault", FaultOn=1, FaultKind="latch_stuck", FaultPlace="none",
                        FaultValue=1, FaultFrames=0)  # fmt: skip
    ecu = WithBench({0.1: [{"fault": stuck}, {"fault": weak}]}, {0.3: latched, 0.35: frozen})
    result, _, _ = ran(tmp_path, {}, "", 0.6, ecu)
    assert result.summary.injections == 2
    assert not result.trace["sensed_latched"][150:].any()


def test_an_operators_value_overrides_a_profile_until_cleared(tmp_path: Path) -> None:
    profile = '[[profile]]\nquantity = "road_slope_deg"\npoints = [[0.0, 4.0]]\n'
    commands = {0.2: [{"set": {"road_slope_deg": -8}}], 0.4: [{"set": {"road_slope_deg": None}}]}
    result, _, _ = ran(tmp_path, commands, profile)
    steps = (
        '[[profile]]\nquantity = "road_slope_deg"\ninterpolation = "hold"\n'
        "points = [[0.0, 4.0], [0.201, -8.0], [0.401, 4.0]]\n"
    )
    ours, _, _ = ran(tmp_path, {}, steps)
    assert_same(result, ours)


def test_operator_commands_are_listed_as_in_force_until_cleared(tmp_path: Path) -> None:
    commands = {
        0.1: [{"fault": FAULT}, {"set": {"road_slope_deg": 5}}, {"obstacle": ROD}],
        0.2: [{"fault": {**FAULT, "factor": 0.25}}, {"signal": {"Body.Ignition": "on"}}],
    }
    _, ecu, _ = ran(tmp_path, commands)
    assert ecu.news["in_force"] == {
        "obstacle": ROD,
        "set": {"road_slope_deg": 5.0},
        "faults": [{**FAULT, "factor": 0.25}],
        "signals": {"Body.Ignition": "on"},
        "record": None,
    }
    told = [text for _, _, text in ecu.news["lines"]]
    assert "0.101 s: operator: fault kind spring_weak, where left, factor 0.5" in told
    assert ecu.news["status"]["time_s"] > 0.0
    _, ecu, _ = ran(tmp_path, {**commands, 0.3: [{"clear": "all"}]})
    assert ecu.news["in_force"] == {"obstacle": None, "set": {}, "faults": [], "signals": {}, "record": None}


def test_a_message_fault_can_name_the_message_or_a_quantity_in_it(tmp_path: Path) -> None:
    lost = {"kind": "frame_lost", "direction": "sent"}
    by_quantity, by_name = {**lost, "where": "left_current"}, {**lost, "where": "LeftDrive", "probability": 0.1}
    _, ecu, _ = ran(tmp_path, {0.1: [{"fault": by_quantity}], 0.2: [{"fault": by_name}]})
    assert ecu.news["in_force"]["faults"] == [by_name]


def test_an_operators_request_presses_the_rigs_button_for_the_rigs_duration(tmp_path: Path) -> None:
    _, ecu, said = ran(tmp_path, {0.1: [{"request": "close"}]})
    message, name = RIG.driver.buttons["close"].signal.split(".")
    signal = RIG.messages[message]
    values = [
        signal.decode(bytes.fromhex(line[1].split("#")[1]), decode_choices=False)[name]
        for line in said
        if line[1].startswith(f"{BUTTON:X}#")
    ]
    pressed = [value for value in values if value != values[-1]]
    hold = RIG.driver.buttons["close"].hold
    cycle = RIG.cycle_ms(message) * 1e-3
    assert values[0] == RIG.driver.buttons["close"].value
    assert len(pressed) == pytest.approx(hold / cycle, abs=1.0)
    assert values[-1] == RIG.driver.buttons["close"].rest
    assert ecu.answers[0]["done"] == "request close"


def test_an_operators_request_reaches_an_ecu_in_this_process_like_a_scenarios(tmp_path: Path) -> None:
    class Asked(Attached):
        def __init__(self) -> None:
            super().__init__({0.1: [{"request": "close"}], 0.3: [{"request": "reset"}]})
            self.asked: list[tuple[str, int]] = []

        def request(self, action: str) -> None:
            self.asked.append((action, self._turn))

        def reset(self) -> None:
            self.asked.append(("reset", self._turn))

    ecu = Asked()
    _, _, said = ran(tmp_path, {}, "", 0.6, ecu)
    assert ecu.asked == [("close", 11), ("reset", 31)]
    assert not [line for line in said if line[1].startswith(f"{BUTTON:X}#")]


WRONG = [
    ([1], "not a table of one key; allowed: one of obstacle, set, fault, signal, request, clear"),
    ({}, "not a table of one key"),
    ({"set": {}, "fault": {}}, "not a table of one key"),
    ({"explode": 1}, "'explode': no such command"),
    ({"set": 7}, "set 7; allowed: a table with its keys"),
    ({"set": {"road_slope_deg": 80}}, "`road_slope_deg` 80: allowed: -"),
    ({"set": {"road_slope_deg": "8"}}, "`road_slope_deg` '8': allowed: -"),
    ({"set": {"slope": 1}}, "`set` slope: no such quantity; allowed: "),
    ({"obstacle": {"stiffness": 1e4}}, "`angle_deg`: missing"),
    ({"obstacle": {"angle_deg": 35, "\x1b[31mred": None}}, "allowed: angle_deg, distance"),
    ({"set": {"handle_pulled": 0.5}}, "`handle_pulled` 0.5: allowed: 0 (off) or 1 (on)"),
    ({"obstacle": {"angle_deg": 35, "colour": 1}}, "`obstacle` 'colour': allowed: angle_deg, distance"),
    ({"obstacle": {"angle_deg": 35, "stiffness": 0}}, "`stiffness` 0: allowed: 1 to 1e+07 N/m"),
    ({"obstacle": {"angle_deg": 35, "meets": 3}}, "`meets` 3: allowed: closing, opening"),
    ({"fault": {"kind": "hall_a_stuck"}}, "value: missing; allowed: 0 (low) or 1 (high)"),
    ({"fault": {"where": "left"}}, "kind: ''"),
    ({"fault": {"kind": "hall_a_stuck", "where": "Gate", "value": 0}}, "'Gate'; allowed: one of left, "),
    ({"fault": {"kind": "motor_open", "start": 3}}, "start"),
    ({"signal": {"Gate.Angle": 3}}, "the gate or the ECU sends it"),
    ({"signal": {"Body.Gear": 9}}, "signal Body.Gear: 9; allowed: 0 to 4, or one of "),
    ({"signal": {"abc": 1}}, "signal: 'abc': no such message; allowed: MESSAGE.SIGNAL of "),
    ({"request": "fly"}, "request 'fly'; allowed: one of open, close, stop, reset"),
    ({"request": "reset"}, "request reset; allowed with [reset] in the rig"),
    ({"request": ["open"]}, "request ['open']"),
    ({"clear": "me"}, "clear 'me'; allowed: one of obstacle, set, faults, signals, all"),
    ({"clear": {"signal": "Body.Gear"}}, "allowed: one of obstacle"),
    ({"clear": {"fault": {}}}, "allowed: one of obstacle"),
    ({"clear": {"signal": ["Body.Gear"]}}, "allowed: one of obstacle"),
    ({"clear": {"signal": {}}}, "allowed: one of obstacle"),
    ({"clear": {"set": ["road_slope_deg"]}}, "no such quantity"),
    ({"clear": {"fault": {"kind": ["motor_open"]}}}, "not set by a command"),
    ({"fault": {"kind": ["motor_open"]}}, "kind: "),
    ({"fault": {"kind": "motor_open", "where": ["left"]}}, "allowed: one of left, "),
    ({"request": {}}, "request {}"),
    ({"signal": {"Body.Gear": [1]}}, "[1]; allowed: 0 to 4"),
    ({"signal": {"Body.Gear": None}}, "None; allowed: 0 to 4"),
    ({"clear": {"fault": {"kind": "motor_open"}}},
     "not set by a command (those of the scenario stay); allowed: none"),
    ({"clear": {"set": "slope"}}, "`set` slope: no such quantity"),
    ({"clear": ["all"]}, "clear ['all']; allowed: one of"),
]  # fmt: skip


def test_an_invalid_command_is_refused_with_the_allowed_values_and_without_effect(tmp_path: Path) -> None:
    wrong = [each for each, _ in WRONG]
    commands = {0.1: wrong[:13], 0.2: wrong[13:26], 0.3: wrong[26:]}
    theirs, ecu, said = ran(tmp_path, commands, duration=0.4)
    ours, _, wanted = ran(tmp_path, {}, duration=0.4)
    assert_same(theirs, ours)
    assert said == wanted
    for answer, (command, words) in zip(ecu.answers, WRONG, strict=True):
        assert isinstance(answer, list), command
        assert words in " | ".join(answer), command
        assert not any("signal: abc" in each for each in answer)  # it is named once
    assert theirs.summary.commands == 0


def test_the_number_of_set_signals_is_limited_to_what_one_command_can_clear(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(operator, "MOST_SIGNALS", 1)
    speed, gear = {"Body.VehicleSpeed": 1}, {"Body.Gear": 1}
    commands = [{"signal": {**speed, **gear}}, {"signal": speed}, {"signal": gear}, {"clear": "all"}]
    _, ecu, _ = ran(tmp_path, {0.1: commands}, duration=0.2)
    assert [isinstance(each, list) for each in ecu.answers] == [True, False, True, False]
    assert "2 signals; allowed: up to 1 at a time" in " | ".join(ecu.answers[0])


def test_faults_of_test_bench_and_operator_are_active_side_by_side(tmp_path: Path) -> None:
    inject = RIG.messages["BenchInject"]
    data = inject.encode(
        {"Order": "fault", "FaultOn": 1, "FaultKind": "spring_weak", "FaultPlace": "left",
         "FaultValue": 0.5, "FaultFrames": 0}
    )  # fmt: skip

    class Both(Attached):
        def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
            sent = super().step(now_s, frames)
            if self._turn == 11:
                sent.append(can.Message(arbitration_id=0x6E4, data=data, is_extended_id=False))
            return sent

    path = tmp_path / "s.toml"
    text = "duration = 0.6\ninitial = 30\nseed = 5\n"
    path.write_text(text, encoding="utf-8")
    offset = {"kind": "current_offset", "where": "right", "value": 2}
    ecu = Both({0.2: [{"fault": offset}], 0.4: [{"clear": "faults"}]})
    job = Job(RunRequest(path, ecu, "lockstep"), trace=1, attachable_as=os.getpid())
    theirs = run_plan(plan_of(job))
    both = (
        '[[fault]]\nkind = "spring_weak"\nwhere = "left"\nfactor = 0.5\nstart = 0.101\n'
        '[[fault]]\nkind = "current_offset"\nwhere = "right"\nvalue = 2\nstart = 0.201\nend = 0.401\n'
    )
    ours, _, _ = ran(tmp_path, {}, both)
    assert_same(theirs, ours)


def test_of_a_quick_series_of_settings_first_and_last_are_logged_and_the_last_is_listed(tmp_path: Path) -> None:
    """A slider sends ten a second; another quantity, or a pause, begins another series."""
    commands: dict[float, list[object]] = {0.1 + 0.05 * k: [{"set": {"hand_force_n": 10 * k}}] for k in range(6)}
    commands[0.45] = [{"set": {"road_slope_deg": 2}}]
    commands[1.8] = [{"set": {"road_slope_deg": 3}}]
    result, ecu, _ = ran(tmp_path, commands, duration=2.2)
    said = [each.partition(": ")[2] for each in result.summary.commanded]
    assert said == ["set hand_force_n 50", "set road_slope_deg 2", "set road_slope_deg 3"]
    assert result.summary.commands == 8
    logged = [text.partition("operator: ")[2] for _, _, text in ecu.news["lines"] if "operator: " in text]
    assert logged == ["set hand_force_n 0", "set hand_force_n 50", "set road_slope_deg 2", "set road_slope_deg 3"]


class Notes:
    """A recording that only keeps its marks."""

    def __init__(self) -> None:
        self.marks: list[tuple[float, str]] = []

    def note(self, now: float, text: str) -> None:
        self.marks.append((now, text))

    mark = note


def test_marks_are_in_order_of_time_and_the_end_of_a_run_ends_a_series_of_settings() -> None:
    class Nobody:
        def hold(self, held: object) -> None:
            pass

    own, reported = Notes(), list[tuple[float, str]]()
    found = operator.Operator(RIG, Nobody(), 1.0)  # type: ignore[arg-type]
    found.recording = own  # type: ignore[assignment]
    found.report = lambda now, done: reported.append((now, done))
    for now, command in (
        (1.0, {"set": {"hand_force_n": 10}}), (1.1, {"set": {"hand_force_n": 20}}),
        (1.2, {"set": {"hand_force_n": 30}}), (1.5, {"mark": "seen"}),
        (1.6, {"set": {"hand_force_n": 40}}), (1.7, {"set": {"hand_force_n": 50}}),
    ):  # fmt: skip
        found.obey(command, now)
    found.end_series()
    found.done[:] = [""] * operator._MOST_LISTED
    for force in (60, 70):
        found.obey({"set": {"hand_force_n": force}}, 5.0)
    assert found.done == [""] * operator._MOST_LISTED
    del own.marks[-1:], reported[-1:]
    assert own.marks == [
        (1.0, "command: set hand_force_n 10"), (1.2, "command: set hand_force_n 30"), (1.5, "seen"),
        (1.6, "command: set hand_force_n 40"), (1.7, "command: set hand_force_n 50"),
    ]  # fmt: skip
    assert [time for time, _ in reported] == [time for time, _ in own.marks]
