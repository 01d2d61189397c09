"""Preconditions of a scenario for an ECU on a bus, a reset by the rig and motions, all in lockstep."""

from __future__ import annotations

import itertools
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hil_support import CLOSE, GATE, OPEN, both, command_frame, shipped_rig

import liftgate_hil as lh
from liftgate_hil.codec.frames import no_logged
from liftgate_hil.config.rig import Rig, load_rig
from liftgate_hil.config.rig_table import asked_by
from liftgate_hil.drive.precondition import phases_of
from liftgate_hil.errors import ConfigError, PreconditionError
from liftgate_hil.plan.setup import setup_of
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH

RIG = shipped_rig()
BUTTON, BODY = 0x130, 0x140
_numbers = itertools.count()


class Ecu(threading.Thread):
    """An ECU that answers every Gate message with a command: for `push` [s] after a button press it drives, but
    not while the ignition is off.
    """

    def __init__(self, channel: str, rig: Rig, push: float = 0.3, is_deaf: bool = False) -> None:
        super().__init__(daemon=True)
        self._bus = can.Bus(interface="virtual", channel=channel)
        self._rig, self._push, self._is_deaf = rig, push, is_deaf
        self._ended = threading.Event()
        self.buttons: list[int] = []  # each press that it has heard
        self.counters: list[int] = []  # of the driver's message
        self.offs = 0

    def run(self) -> None:
        cycles, until, way, was, is_off = 0, 0, 0, 0, False
        while not self._ended.is_set():
            message = self._bus.recv(0.05)
            if message is None:
                if cycles == 0:
                    self._command(0, 0)  # in lockstep somebody has to begin
                continue
            if message.arbitration_id == BUTTON:
                button = message.data[0] & 3
                self.counters.append(message.data[1] & 15)
                if button and button != was and not self._is_deaf:
                    self.buttons.append(button)
                    until, way = (cycles + round(self._push * 100), {1: OPEN, 2: CLOSE}.get(button, 0))
                was = button
            elif message.arbitration_id == BODY:
                self.offs += int(message.data[0] & 3 == 0 and not is_off)
                is_off = message.data[0] & 3 == 0
            elif message.arbitration_id == GATE:
                cycles += 1
                self._command(cycles, way if cycles < until and not is_off else 0)

    def _command(self, turn: int, way: int) -> None:
        identifier, payload = command_frame(self._rig, turn, **both(60.0 if way else 0.0, way, int(way == OPEN)))
        self._bus.send(can.Message(arbitration_id=identifier, data=payload, is_extended_id=False))

    def close(self) -> None:
        self._ended.set()
        self.join()
        self._bus.shutdown()


@pytest.fixture
def on_bus() -> Iterator[Callable[..., tuple[Ecu, Any]]]:
    """Return a function that runs a scenario with this ECU on a virtual bus and returns the ECU and the result."""
    ecus = []

    def run(path: Path, rig: Rig = RIG, record: Any = (), **more: Any) -> tuple[Ecu, Any]:
        channel = f"prepared-{next(_numbers)}"
        ecus.append(Ecu(channel, rig, **more))
        ecus[-1].start()
        return ecus[-1], lh.run(
            path,
            "bus",
            "lockstep",
            bus=f"virtual:{channel}",
            rig=rig,
            wall_timeout=60.0,
            trace=True,
            record=record,
        )

    yield run
    for ecu in ecus:
        ecu.close()


def scenario(folder: Path, text: str) -> Path:
    path = folder / "s.toml"
    path.write_text(f"duration = 0.5\ninitial = 30\n{text}", encoding="utf-8")
    return path


def rig_with(folder: Path, text: str) -> Rig:
    """Write the shipped rig with additional text, and load it."""
    whole = Path(RIG.source).read_text(encoding="utf-8").replace('"liftgate.dbc"', f'"{RIG.database}"')
    path = folder / "their.toml"
    path.write_text(f"{whole}\n{text}", encoding="utf-8")
    return load_rig(path)


def test_requests_of_a_scenario_press_the_buttons_of_the_rig(tmp_path: Path, on_bus: Any) -> None:
    ask = '[[request]]\ntime = {}\naction = "{}"\n'
    text = ask.format(0.1, "open") + ask.format('"left_current_a > 1"', "stop")
    ecu, result = on_bus(scenario(tmp_path, text))
    assert result.verdict == "pass", result.reason
    assert ecu.buttons == [1, 3]
    assert result.maxima["left_current_a"] > 1.0


def test_motions_of_a_precondition_run_on_the_bus_before_time_0(tmp_path: Path, on_bus: Any) -> None:
    text = 'precondition = ["open", "close"]\n[[request]]\ntime = 0.1\naction = "open"\n'
    ecu, result = on_bus(scenario(tmp_path, text))
    assert ecu.buttons == [1, 2, 1]
    # Its motions are not in what is seen of the run, which begins where they end; its message's counter goes on.
    times = result.trace["time_s"]
    assert (times[0], times[-1]) == pytest.approx((0.001, 0.501))
    assert result.trace["gate_angle_deg"][0] > 30.01 or result.trace["gate_angle_deg"][0] < 29.99
    assert abs(result.trace["gate_rate_degps"][0]) < 0.02
    steps = {(b - a) % 16 for a, b in itertools.pairwise(ecu.counters)}
    assert steps == {1}


def test_waiting_for_the_ecu_and_for_a_motion_in_a_precondition_has_a_time_limit(tmp_path: Path) -> None:
    setup = setup_of(scenario(tmp_path, 'precondition = ["open"]\n'))
    heard, motion = (each.end for each in phases_of(setup, RIG, 0.001))
    row = np.zeros((1, ROW_WIDTH))
    heard.take(np.repeat(row, 9000, axis=0), no_logged())
    assert not heard.is_over()
    heard.take(np.repeat(row, 1001, axis=0), no_logged())
    with pytest.raises(PreconditionError, match=r"no command of the ECU \(0x120\) within 10 s"):
        heard.is_over()
    row[0, COLUMN_PLACE["gate_rate_degps"]] = 1.0
    motion.take(np.repeat(row, 120_001, axis=0), no_logged())
    with pytest.raises(PreconditionError, match="open: the gate does not come to rest within 120 s"):
        motion.is_over()


EXPECT = '[[expect]]\nname = "stands"\nalways = "gate_angle_deg > 0"\n'
RESET = '[reset]\nsignal = "Body.Ignition"\nvalue = "off"\nhold_s = 0.3\n'


def test_a_scenario_begins_with_the_reset_of_the_ecu_that_its_rig_states(tmp_path: Path, on_bus: Any) -> None:
    ecu, result = on_bus(scenario(tmp_path, EXPECT), rig_with(tmp_path, RESET))
    assert result.verdict == "pass", result.reason
    assert ecu.offs == 1


def test_a_reset_during_a_scenario_uses_the_signal_of_the_rig(tmp_path: Path, on_bus: Any) -> None:
    text = '[[request]]\ntime = 0.05\naction = "reset"\n'
    ecu, result = on_bus(scenario(tmp_path, text), rig_with(tmp_path, RESET))
    assert result.verdict == "pass", result.reason
    assert ecu.offs == 2


@pytest.mark.parametrize(
    ("ready", "verdict"), [("DriveCommand.LeftDirection == 0", "pass"), ("gate_angle_deg > 90", "inconclusive")]
)
def test_a_reset_ends_with_its_ready_condition(tmp_path: Path, on_bus: Any, ready: str, verdict: str) -> None:
    rig = rig_with(tmp_path, f'{RESET}ready = "{ready}"\ntimeout_s = 0.5\n')
    _, result = on_bus(scenario(tmp_path, EXPECT), rig)
    assert result.verdict == verdict
    if verdict == "inconclusive":
        (told,) = result.expectations.values()
        assert "reset.ready: gate_angle_deg > 90: not true within 0.5 s" in told.reason


PROGRAMS = [
    ("pass", ""),
    ("raise SystemExit('no power supply')", "ended with 1: no power supply"),
    ("import time; time.sleep(60)", "not finished after 3 s"),
]


@pytest.mark.parametrize(("program", "said"), PROGRAMS)
def test_a_reset_may_run_a_program(tmp_path: Path, on_bus: Any, program: str, said: str) -> None:
    command = f"[{sys.executable!r}, '-ISc', {program!r}]".replace("'", '"') if '"' not in program else ""
    if "'" in program:
        (tmp_path / "power.py").write_text(program, encoding="utf-8")
        command = f'["{sys.executable}", "-ISB", "{tmp_path / "power.py"}"]'
    limit = 3.0 if "sleep" in program else 30.0
    rig = rig_with(tmp_path, f"[reset]\ncommand = {command}\ntimeout_s = {limit}\n")
    _, result = on_bus(scenario(tmp_path, EXPECT), rig)
    (told,) = result.expectations.values()
    assert (told.verdict == "pass") == (said == ""), told
    assert said in told.reason


@pytest.mark.parametrize(("program", "said"), PROGRAMS)
@pytest.mark.parametrize("when", ["0.05", '"time_s > 0.05"'])
def test_a_reset_during_a_scenario_may_run_a_program(
    tmp_path: Path, on_bus: Any, program: str, said: str, when: str
) -> None:
    runs, script = tmp_path / "runs.txt", tmp_path / "power.py"
    # Before the scenario it succeeds.
    text = f"open({str(runs)!r}, 'a').write('x')\nif len(open({str(runs)!r}).read()) > 1:\n    {program or 'pass'}"
    script.write_text(text, encoding="utf-8")
    rig = rig_with(
        tmp_path,
        f'[reset]\ncommand = ["{sys.executable}", "-ISB", "{script}"]\n'
        f"timeout_s = {3.0 if 'sleep' in program else 30.0}\n",
    )
    request = f'[[request]]\ntime = {when}\naction = "reset"\n'
    path, recorded = scenario(tmp_path, request + EXPECT), [tmp_path / "r.csv", tmp_path / "r.log"]
    _, result = on_bus(path, rig, record=recorded)
    (told,) = result.expectations.values()
    (again,) = lh.judge(recorded, path, rig=rig).verdicts.values()
    assert (again.verdict, again.margin) == (told.verdict, told.margin)
    assert runs.read_text(encoding="utf-8") == "xx"
    assert (told.verdict == "pass") == (program == "pass"), told
    assert said in told.reason
    if said:
        assert told.verdict == "inconclusive"
        assert told.reason.startswith("request: reset: ")


def test_a_reset_program_that_takes_too_long_is_killed_with_its_children(tmp_path: Path, on_bus: Any) -> None:
    alive, script = tmp_path / "alive.txt", tmp_path / "power.py"
    child = f"import time\\nfor n in range(600): open({str(alive)!r}, 'a').write('x'); time.sleep(0.05)"
    script.write_text(
        f"import subprocess, sys, time\nsubprocess.Popen([sys.executable, '-c', \"{child}\"])\ntime.sleep(60)",
        encoding="utf-8",
    )
    rig = rig_with(tmp_path, f'[reset]\ncommand = ["{sys.executable}", "-ISB", "{script}"]\ntimeout_s = 1.5\n')
    _, result = on_bus(scenario(tmp_path, EXPECT), rig)
    (told,) = result.expectations.values()
    assert "not finished after 1.5 s" in told.reason
    written = alive.read_text(encoding="utf-8")
    time.sleep(0.3)
    assert alive.read_text(encoding="utf-8") == written


def test_a_missing_reset_program_is_reported(tmp_path: Path, on_bus: Any) -> None:
    rig = rig_with(tmp_path, '[reset]\ncommand = ["/no/such/program"]\n')
    _, result = on_bus(scenario(tmp_path, EXPECT), rig)
    (told,) = result.expectations.values()
    assert told.verdict == "inconclusive"
    assert "reset.command: /no/such/program: cannot be run" in told.reason


def test_rig_check_describes_requests_and_reset(tmp_path: Path) -> None:
    assert asked_by(RIG)["stop"] == "DriverRequest.Button = 3 for 0.2 s, else 0"
    rig = rig_with(tmp_path, f'{RESET}command = ["power", "cycle"]\nready = "time_s > 1"\n')
    said = "Body.Ignition = 0 for 0.3 s, else 1, runs power cycle, then waits for time_s > 1"
    assert asked_by(rig)["reset"] == said


WRONG_RIGS = [
    ("[reset]\n", "reset: neither signal, uds nor command"),
    ('[reset]\nsignal = "Body.Nope"\nvalue = 1\n', "reset.signal: 'Body.Nope': no such signal"),
    ('[reset]\nsignal = "Body.Ignition"\nvalue = "on"\n', "reset.rest: 1, the same as value"),
    ('[reset]\nsignal = "Body.Ignition"\n', "reset.value: None"),
    ('[reset]\ncommand = ["x"]\nready = "gate_angle_deg >"\n', "reset.ready: "),
    ('[reset]\ncommand = ["x"]\ntimeout_s = 0\n', "reset.timeout_s: 0 is out of range"),
    ('[requests.reset]\nsignal = "Body.Ignition"\nvalue = 0\n', "requests.reset: "),
]


@pytest.mark.parametrize(("text", "said"), WRONG_RIGS)
def test_mistakes_in_the_tables_of_requests_and_reset_are_reported(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        rig_with(tmp_path, text)
    (issue,) = caught.value.issues
    assert said in issue
    assert "allowed: " in issue or "ready" in said


def test_a_reset_request_on_a_bus_is_refused_where_the_rig_has_no_reset_table(tmp_path: Path) -> None:
    text = 'precondition = ["open"]\n[[request]]\ntime = 1\naction = "reset"\n'
    with pytest.raises(ConfigError, match=r"request: reset: allowed on a bus with \[reset\] in the rig"):
        lh.run(scenario(tmp_path, text), "bus", "lockstep", bus="virtual:nobody")
