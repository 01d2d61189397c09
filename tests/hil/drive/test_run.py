"""`liftgate_hil.run`: a scenario against an ECU, its arguments and its result."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import liftgate_hil as lh
from liftgate_hil.drive import run
from liftgate_hil.drive.run import execute
from liftgate_hil.errors import ConfigError
from liftgate_hil.loop.listener import Listener
from liftgate_hil.loop.python_loop import Loop
from liftgate_hil.plan.plan import plan_of
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS

TEXT = """
description = "closing onto a rod"
duration = 2.5
vehicle = "suv"
initial = 45.0
[parameters]
rod = 10_000
start = 0.2
[set]
"environment.ambient_temperature_degc" = 10
supply.voltage = 13
[[obstacle]]
angle_deg = 42
stiffness = "$rod"
[[request]]
time = "$start"
action = "close"
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "scenario.toml"
    path.write_text(TEXT)
    return path


def test_a_result_has_extremes_of_every_column_and_the_ecus_events(scenario: Path) -> None:
    result = lh.run(scenario, ecu="reference")
    assert (result.verdict, result.reason) == ("pass", "")
    assert set(result.maxima) == set(result.minima) == set(COLUMNS)
    assert result.maxima["gate_angle_deg"] >= 45.0 > result.minima["gate_angle_deg"]
    assert result.maxima["supply_voltage_v"] == result.minima["supply_voltage_v"] == 13.0
    assert result.maxima["ambient_temperature_degc"] == 10.0
    assert result.maxima["pinch_force_n"] > 5.0
    assert 0.2 < result.pinch_time_s < 2.5
    assert result.events[0].text == "closing"
    assert result.summary.ticks == 2501


def test_the_json_of_a_result_says_why_it_ended_and_where_it_comes_from(scenario: Path) -> None:
    told = lh.run(scenario).to_dict()
    assert told["stop_reason"] == "duration"
    assert told["provenance"]["command_line"].startswith("RunRequest(scenario=")
    assert told["provenance"]["sources"]["scenario"]["path"] == str(scenario)


def test_a_note_on_rig_and_vehicle_is_in_the_result_and_printed_once(
    scenario: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from liftgate_hil.cli.main import main
    from liftgate_hil.config import rig_fit

    note = "rig: inputs.right_duty is missing"
    for module in (run, rig_fit):
        monkeypatch.setattr(module, "notes_on_fit", lambda *_: [note])
    assert lh.run(scenario, ecu="reference").notes[0] == note
    capsys.readouterr()
    expecting = scenario.read_text() + '[[expect]]\nname = "shut"\nalways = "gate_angle_deg < 60"\n'
    scenario.write_text(expecting)
    for command in (
        ["test", str(scenario), str(scenario)],
        ["run", "--scenario", str(scenario), "--clock", "free"],
    ):
        ecu = ["--ecu", "reference", "--bus", "virtual:x"] if command[0] == "run" else []
        main([*command, *ecu])
        said = capsys.readouterr()
        assert (said.out + said.err).count(note) == 1, command


def test_parameters_of_the_call_override_those_of_the_file(scenario: Path) -> None:
    soft = lh.run(scenario, parameters={"rod": 1000})
    hard = lh.run(scenario, parameters={"rod": 60_000})
    assert hard.maxima["pinch_force_n"] > 1.2 * soft.maxima["pinch_force_n"]


def test_arguments_of_the_call_override_the_file(scenario: Path) -> None:
    result = lh.run(scenario, vehicle="compact", initial="closed", duration=0.5, settings=["supply.voltage=11"])
    assert result.summary.model_time_s == pytest.approx(0.501)
    assert result.maxima["supply_voltage_v"] == 11.0
    assert result.minima["latched"] == 1.0


def test_a_scenario_that_sets_vehicle_keys_is_refused_with_a_loaded_vehicle(scenario: Path) -> None:
    with pytest.raises(ConfigError, match=r"\.toml: set\.supply\.voltage: allowed with"):
        lh.run(scenario, vehicle=lh.load_vehicle("suv"))


def test_a_trace_has_every_row(scenario: Path) -> None:
    result = lh.run(scenario, trace=True)
    assert set(result.trace) == set(COLUMNS)
    assert len(result.trace["time_s"]) == result.summary.ticks
    assert result.trace["pinch_force_n"].max() == result.maxima["pinch_force_n"]


def test_requested_recordings_are_written(scenario: Path, tmp_path: Path) -> None:
    files = [tmp_path / "run.csv", tmp_path / "run.log"]
    result = lh.run(scenario, record=files)
    assert result.recording == tuple(files)
    assert len(files[0].read_text().splitlines()) == 2502
    assert len(files[1].read_text().splitlines()) > 1000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"parameters": {"nix": 1}},
            r"`parameters` nix: no such parameter in .*scenario\.toml; allowed: rod, start",
        ),
        ({"ecu": "bus"}, "`bus`: missing; allowed: INTERFACE:CHANNEL of the bus with the ECU"),
        ({"record": 3}, "`record` 3: allowed: a path, or a list of them"),
        ({"parameters": [1]}, "`parameters` 1: allowed: NAME=VALUE"),
        ({"bus": 3, "clock": "lockstep"}, r"`bus` 3: allowed: INTERFACE:CHANNEL"),
        ({"rate": 1e6}, "`rate` 1000000.0: allowed"),
        ({"duration": -1.0}, "`duration` -1.0: allowed: 0.001 to"),
        ({"settings": ["nix"]}, "`settings` nix: allowed: KEY=VALUE"),
    ],
)
def test_invalid_arguments_are_refused(scenario: Path, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        lh.run(scenario, **arguments)


def test_loaded_objects_are_accepted_in_place_of_names(scenario: Path) -> None:
    scenario.write_text(TEXT.partition("[set]")[0] + "[[obstacle]]" + TEXT.partition("[[obstacle]]")[2])
    loaded = lh.load_scenario(scenario, {"rod": 20_000})
    assert loaded.parameters["rod"] == 20_000
    result = lh.run(
        loaded, vehicle=lh.load_vehicle("compact"), rig=lh.load_rig("liftgate"), initial=45.0, duration=0.1
    )
    assert result.verdict == "pass"


def test_a_run_without_a_scenario_and_a_duration_is_refused() -> None:
    with pytest.raises(ConfigError, match="`duration`: missing"):
        lh.run()


def test_all_issues_of_a_scenario_are_reported_at_once(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(
        'seed = -1\ninitial = "ajar"\nnix = 1\n[[obstacle]]\nangle_deg = "$angle"\n'
        '[[request]]\ntime = "$when"\naction = "open"\n'
    )
    with pytest.raises(ConfigError) as caught:
        lh.run(path)
    told = "\n".join(caught.value.issues)
    for key in ("seed", "initial", "nix", "obstacle[0].angle_deg", "request[0].time"):
        assert f"{path}: {key}: " in told


@pytest.mark.parametrize("clock", ["free", "lockstep"])
def test_a_failed_run_keeps_its_summary_and_extremes_so_far(scenario: Path, clock: str) -> None:
    class Raises:
        def step(self, now_s: float, frames: object) -> list[object]:
            if now_s > 0.0495:
                raise ValueError("not today")
            return []

    result = lh.run(scenario, ecu=Raises(), clock=clock)
    told = result.to_dict()
    assert (result.verdict, told["verdict"], told["stop_reason"]) == ("error", "error", "error")
    assert result.reason == told["reason"]
    assert result.reason.startswith("the ECU at 0.05")
    assert 50 <= result.summary.ticks <= 61
    assert result.maxima["gate_angle_deg"] > 44.0


def test_frames_dropped_by_a_full_ecu_buffer_are_reported(scenario: Path) -> None:
    class Rarely:
        period_s = 2.0

        def step(self, now_s: float, frames: object) -> list[object]:
            return []

    dropped = lh.run(scenario, ecu=Rarely()).summary
    assert dropped.ecu_dropped_frames > 0
    assert f"the ECU had no room for {dropped.ecu_dropped_frames} frames" in dropped.lines()
    assert lh.run(scenario).summary.ecu_dropped_frames == 0


def test_a_note_on_rig_and_rate_is_reported_to_the_listener(scenario: Path) -> None:
    class Heard(Listener):
        def __init__(self) -> None:
            self.lines: list[str] = []

        def say(self, text: str) -> None:
            self.lines.append(text)

    heard = Heard()
    execute(plan_of(Job(RunRequest(scenario, rate=700.0, duration=0.1), listener=heard)))
    assert any(
        line.startswith("note: ") and "LeftDrive.cycle_ms: 5 is not a whole number of ticks" in line
        for line in heard.lines
    )


def test_a_diverging_run_in_plain_python_keeps_its_recorded_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tick = Loop._call

    def diverging(self: Loop, state: Any, stimuli: Any, row: Any, *more: Any) -> Any:
        *others, is_sound = tick(self, state, stimuli, row, *more)
        return (*others, is_sound and row[0, COLUMN_PLACE["time_s"]] < 0.0305)

    monkeypatch.setattr(Loop, "_call", diverging)
    path = tmp_path / "run.csv"
    result = lh.run("demo", clock="lockstep", duration=0.1, record=path)
    assert result.verdict == "error"
    assert "the plant diverged at 0.031 s" in result.reason
    assert result.summary.ticks >= 31
    times = [line.partition(",")[0] for line in path.read_text().splitlines()[1:]]
    assert times[30] == "0.031"
