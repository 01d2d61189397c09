"""Notes on a run, such as requests that the ECU ignores."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest
from hil_support import both, command_frame
from run_support import ScriptedEcu, message

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.config.choices import WireChoice
from liftgate_hil.config.rig import Rig
from liftgate_hil.drive.notes import on_the_bus
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.plan.setup import rig_from
from liftgate_hil.transport.base import LinkCounts
from liftgate_hil.transport.find import Way, find_way


class Asked(ScriptedEcu):
    """An ECU that accepts requests and does not react to them."""

    def request(self, action: str) -> None:
        """Accept a request."""


def notes_of(tmp_path: Path, text: str, ecu: object, clock: str = "free") -> tuple[str, ...]:
    path = tmp_path / "scenario.toml"
    path.write_text("duration = 0.5\n" + text, encoding="utf-8")
    return lh.run(path, ecu, clock).notes


REQUESTS = '[[request]]\ntime = 0.1\naction = "open"\n[[request]]\ntime = 0.2\naction = "close"\n'


@pytest.mark.parametrize("clock", ["free", "lockstep"])
def test_ignored_requests_are_noted_once(tmp_path: Path, clock: str) -> None:
    (note,) = notes_of(tmp_path, REQUESTS, ScriptedEcu(lambda turn: []), clock)
    assert note == "requests without effect: open, close: the ECU has no request()"


@pytest.mark.parametrize(("stiffness", "notes"), [(99.0, 1), (100.0, 0), (2000.0, 0)])
def test_an_obstacle_whose_stiffness_looks_like_newton_per_millimetre_is_noted(
    tmp_path: Path, stiffness: float, notes: int
) -> None:
    obstacle = f"[[obstacle]]\nangle_deg = 40.0\nstiffness = {stiffness}\n"
    found = notes_of(tmp_path, obstacle, ScriptedEcu(lambda turn: []))
    assert [note for note in found if "are N/mm meant? 99 N/mm is 99000 N/m" in note] == list(found)[:notes]


def test_an_ecu_in_a_process_of_its_own_reports_ignored_requests(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "deaf_ecu.py").write_text("class Deaf:\n    def step(self, now_s, frames):\n        return []\n")
    assert main(["ecu", "--ecu", "deaf_ecu:Deaf", "--bus", "virtual:deaf", "--duration", "0.01"]) == 0
    assert "note: requests without effect: open, close: the ECU has no request()\n" in capsys.readouterr().err


def commanding(duty: float, direction: int) -> Asked:
    """Return an ECU that sends one command to the left motor in every cycle."""
    rig = rig_from("liftgate")
    values = {**both(0.0, direction), "LeftDuty": duty}
    return Asked(lambda turn: [message(*command_frame(rig, turn % 16, **values))])


OPENS = REQUESTS + '[[expect]]\nname = "opens"\neventually = "gate_angle_deg > 1"\n'


@pytest.mark.parametrize(
    ("duty", "direction", "said"),
    [(0.7, 1, "left duty 0 to 0.7 %"), (70.0, 2, "left duty -70 to 0 %"), (0.0, 1, "left duty 0 %")],
)
def test_a_gate_that_does_not_move_is_noted_with_its_commands(
    tmp_path: Path, duty: float, direction: int, said: str
) -> None:
    (note,) = notes_of(tmp_path, OPENS, commanding(duty, direction))
    assert note == (
        f"the gate moved by less than 0.5°: the commands were {said}, right duty 0 %, and the latch stayed "
        "engaged; positive opens"
    )


def test_the_note_on_a_gate_that_does_not_move_names_commands_to_coast(tmp_path: Path) -> None:
    """The duties of a coasting drive are 0 whatever the ECU sends."""
    (note,) = notes_of(tmp_path, OPENS, commanding(70.0, 0))
    assert "the commands were left coasts, right coasts, and" in note


@pytest.mark.parametrize(("angle", "is_met"), [(35.0, True), (100.0, False)])
def test_an_obstacle_that_the_gate_never_touches_is_noted(tmp_path: Path, angle: float, is_met: bool) -> None:
    text = f'initial = 40.0\n[[request]]\ntime = 0.0\naction = "close"\n[[obstacle]]\nangle_deg = {angle}\n'
    path = tmp_path / "s.toml"
    path.write_text(f"duration = 3.0\n{text}", encoding="utf-8")
    never = f"the gate never met the obstacle ({angle:g}°): the pinch force was 0 all the time"
    assert (never in lh.run(path).notes) == (not is_met)


def test_an_ecu_period_longer_than_the_commands_time_out_is_noted(tmp_path: Path) -> None:
    slow = Asked(lambda turn: [])
    slow.period_s = 20
    (note,) = notes_of(tmp_path, REQUESTS, slow)
    assert note.startswith(
        "the ECU is called every 20 s (its period_s), and DriveCommand times out after 0.03 s: "
    )


def test_a_time_window_longer_than_the_run_is_noted(tmp_path: Path) -> None:
    text = '[[expect]]\nname = "x"\neventually = "time_s > 0.1"\nwithin_s = 500\n'
    assert notes_of(tmp_path, text, "reference") == ("x: within_s = 500 is longer than the run of 0.5 s",)


def test_no_note_is_given_where_requests_are_accepted_or_absent(tmp_path: Path) -> None:
    assert notes_of(tmp_path, REQUESTS, Asked(lambda turn: [])) == ()
    assert notes_of(tmp_path, "", ScriptedEcu(lambda turn: [])) == ()
    assert notes_of(tmp_path, REQUESTS, "reference") == ()


@pytest.mark.parametrize(("action", "end"), [("open", "80.0"), ("close", "0.0")])
def test_a_precondition_that_ends_between_open_and_closed_is_noted(tmp_path: Path, action: str, end: str) -> None:
    text = f'initial = 40.0\nprecondition = ["{action}"]\n[[expect]]\nname = "x"\nalways = "latched == 0"\n'
    (note,) = notes_of(tmp_path, text, Asked(lambda turn: []))
    assert note.startswith(f"precondition: {action}: the gate came to rest at ")
    assert f"°, not at {end}°" in note


def test_a_precondition_that_reaches_its_end_position_gives_no_note(tmp_path: Path) -> None:
    for actions in ('"open"', '"open", "close", "open"'):
        assert notes_of(tmp_path, f"precondition = [{actions}]\n", "reference") == ()


def test_an_unused_parameter_is_noted(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text("[parameters]\nof_others = 1\n", encoding="utf-8")
    text = (
        'include = ["bench.toml"]\n'
        "[parameters]\nrod = 10_000\nlimit = 3\nfree = 1\n"
        "[[obstacle]]\nangle_deg = 35\nstiffness = '$rod'\n"
        "[[expect]]\nname = 'x'\nnever = 'gate_angle_deg > $limit'\n"
    )
    (note, *_) = notes_of(tmp_path, text, ScriptedEcu(lambda turn: []))
    assert note == "parameters.free: not used: $free stands nowhere"


def flooding(frames: int, identifier: int = 0x55) -> ScriptedEcu:
    """Return an ECU that sends a number of frames of 8 bytes in each cycle of 10 ms."""
    return ScriptedEcu(lambda turn: [message(identifier, bytes(8))] * frames)


@pytest.mark.parametrize("clock", ["free", "lockstep"])
def test_an_overloaded_bus_is_noted_with_its_load(tmp_path: Path, clock: str) -> None:
    (note,) = notes_of(tmp_path, "", flooding(100), clock)  # 11,100 bits in 10 ms
    assert re.fullmatch(
        r"the bus was overloaded, with 2[56]\d % of its 500 kbit/s on average: on a real one frames come late, .*",
        note,
    )
    assert notes_of(tmp_path, "", flooding(1), clock) == ()


@pytest.mark.parametrize(
    ("identifier", "name"), [(0x120, r"DriveCommand \(0x120\)"), (0x55, "0x55")], ids=["ours", "foreign"]
)
def test_can_fd_frames_on_a_classic_bus_are_noted(tmp_path: Path, identifier: int, name: str) -> None:
    frame = can.Message(arbitration_id=identifier, is_extended_id=False, is_fd=True, data=bytes(8))
    (note,) = notes_of(tmp_path, "", ScriptedEcu(lambda turn: [frame]))
    assert re.fullmatch(
        rf"(49|50|51) CAN FD frames on a classic bus, the first {name} at 0\.0\d\d s: on a real one .*frame", note
    )


def test_frames_that_overflowed_the_send_queue_are_noted(rig: Rig) -> None:
    summary = Summary(link=LinkCounts(send_failures=3, send_queue_full=2))
    way = find_way(WireChoice(serial="loop://"), rig)
    plan: Any = SimpleNamespace(rig=rig, way=way)
    assert on_the_bus(plan, summary) == [f"2 frames of the gate not sent: {way.why_full}"]
    fd: Any = SimpleNamespace(rig=rig, way=Way({"interface": "virtual"}, None, is_fd=True))
    assert on_the_bus(fd, Summary(fd_frames=5, model_time_s=1.0, bus_load_percent=200.0)) == []
