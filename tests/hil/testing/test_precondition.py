"""Motions before a scenario's time 0, and an ECU that is reset within the scenario."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

import liftgate_hil as lh
from liftgate_hil.errors import ConfigError
from liftgate_hil.testing.rejudge import expectations_of, judged
from liftgate_hil.testing.request import JudgeRequest

LEARNED = 'precondition = ["open", "close"]\n'
OPENS = '[[request]]\ntime = 0.5\naction = "open"\n'
OPEN = '[[expect]]\nname = "opens"\neventually = "gate_angle_deg > 75"\n'


def scenario(folder: Path, text: str, duration: float = 9.0) -> Path:
    path = folder / "s.toml"
    path.write_text(f"duration = {duration}\n{text}")
    return path


def texts(result: lh.Result) -> list[str]:
    """Return the texts of the ECU's events, each up to its first colon."""
    return [each.text.split(":")[0] for each in result.events]


def test_a_precondition_is_neither_reported_nor_recorded(tmp_path: Path) -> None:
    result = lh.run(scenario(tmp_path, LEARNED + OPENS + OPEN), trace=True, record=tmp_path / "run.log")
    assert result.verdict == "pass"
    assert texts(result) == ["opening", "open"]  # and not "open, travel learned"
    assert result.events[0].time == pytest.approx(0.5, abs=0.01)
    assert result.summary.ticks == len(result.trace["time_s"]) == 9001
    assert result.trace["time_s"][0] == 0.001
    assert result.trace["gate_angle_deg"][0] == pytest.approx(0.0, abs=0.5)
    assert result.trace["latched"][0] == 1.0
    first = (tmp_path / "run.log").read_text().splitlines()[0]
    assert first.startswith("(0000000000.00")


def test_without_a_precondition_the_ecu_learns_within_the_scenario(tmp_path: Path) -> None:
    result = lh.run(scenario(tmp_path, OPENS + OPEN, 15.0))
    assert texts(result) == ["opening", "open, travel learned"]


def test_stimuli_of_the_scenario_do_not_act_during_its_precondition(tmp_path: Path) -> None:
    text = LEARNED + OPENS + OPEN
    text += '[[obstacle]]\nangle_deg = 40\nmeets = "opening"\n'
    text += '[[fault]]\nkind = "spring_lost"\nstart = "pinch_force_n > 5"\n'
    text += '[[profile]]\nquantity = "supply_voltage_v"\npoints = [[0, 11]]\n'
    text += '[[expect]]\nname = "meets"\neventually = "pinch_force_n > 5"\n'
    result = lh.run(scenario(tmp_path, text), trace=True)
    assert result.expectations["meets"].verdict == "pass"  # only then
    assert result.trace["supply_voltage_v"][0] == 11.0


def test_a_precondition_gives_the_same_frames_on_free_and_lockstep_clocks(tmp_path: Path) -> None:
    text = LEARNED + OPENS + OPEN + '[[request]]\ntime = 3.0\naction = "reset"\n'
    logs = []
    for clock in ("free", "lockstep"):
        file = tmp_path / f"{clock}.log"
        lh.run(scenario(tmp_path, text), clock=clock, record=file)
        logs.append([line.split(" ", 2)[::2] for line in file.read_text().splitlines()])
    assert logs[0] == logs[1]


def test_conditions_of_stimuli_and_expectations_count_from_time_0(tmp_path: Path) -> None:
    text = LEARNED + '[[request]]\ntime = "time_s >= 1"\ndelay_s = 0.25\naction = "open"\n' + OPEN
    result = lh.run(scenario(tmp_path, text))
    assert result.events[0].time == pytest.approx(1.25, abs=0.011)


class NeverStill:
    """An ECU that moves the gate back and forth without end."""

    period_s = 0.01

    def step(self, now_s: float, frames: object) -> list[object]:
        import can

        from liftgate_hil.config.shipped import find_config

        if not hasattr(self, "rig"):
            self.rig = lh.load_rig(find_config("rigs", "liftgate"))
            self.count = 0
        from hil_support import both, command_frame

        direction = 1 if int(now_s / 2.0) % 2 == 0 else 2
        identifier, data = command_frame(self.rig, self.count % 16, **both(60.0, direction, 1))
        self.count += 1
        return [can.Message(arbitration_id=identifier, data=data, is_extended_id=False)]


def test_a_precondition_that_never_ends_makes_the_scenario_inconclusive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from liftgate_hil.loop import precondition

    monkeypatch.setattr(precondition, "LONGEST_MOTION", 10.0)
    result = lh.run(scenario(tmp_path, LEARNED + OPEN), ecu=NeverStill())
    assert result.verdict == "inconclusive"
    reason = result.expectations["opens"].reason
    assert reason == (
        "precondition: open: the gate still moves, or a drive is still driven, after 10 s; allowed: "
        "motions that end"
    )


class Idle:
    """An ECU that sends nothing."""

    def step(self, frames: object, time: float) -> list[object]:
        return []


def test_expectations_that_pass_after_an_incomplete_precondition_are_inconclusive(tmp_path: Path) -> None:
    text = 'precondition = ["open"]\n' + OPEN + "[[expect]]\nname = 'soft'\nalways = 'pinch_force_n < 150'\n"
    file = scenario(tmp_path, text)
    result = lh.run(file, ecu=Idle(), record=tmp_path / "run.csv")
    unmet = "precondition: open: the gate came to rest at 0.0°, not at 80.0°"
    assert {name: each.verdict for name, each in result.expectations.items()} == {
        "opens": "fail",  # which may be for the same reason: it is noted
        "soft": "inconclusive",
    }
    assert result.expectations["soft"].reason == unmet
    assert f"{unmet}: the scenario begins there" in result.notes
    assert lh.judge([tmp_path / "run.csv"], file).verdicts == dict(result.expectations)


def test_an_incomplete_precondition_is_seen_in_a_recording(tmp_path: Path) -> None:
    """No condition uses the gate's angle, but judging reads it to check the precondition."""
    expected = "[[expect]]\nname = 'soft'\nalways = 'pinch_force_n < 150'\n"
    file = scenario(tmp_path, f'precondition = ["open"]\n{expected}', 0.5)
    result = lh.run(file, ecu=Idle(), record=tmp_path / "run.csv")
    assert result.expectations["soft"].verdict == "inconclusive"
    assert lh.judge([tmp_path / "run.csv"], file).verdicts == dict(result.expectations)


@pytest.mark.parametrize("clock", ["free", "realtime"])
def test_an_incomplete_precondition_is_noted_without_expectations_too(tmp_path: Path, clock: str) -> None:
    result = lh.run(scenario(tmp_path, 'precondition = ["open"]\n', 0.2), ecu=Idle(), clock=clock)
    assert (result.verdict, result.expectations) == ("pass", {})
    assert any(each.endswith("not at 80.0°: the scenario begins there") for each in result.notes)


def test_without_the_gate_angle_a_recording_cannot_show_a_completed_precondition(tmp_path: Path) -> None:
    expected = "[[expect]]\nname = 'soft'\nalways = 'pinch_force_n < 150'\n"
    file = scenario(tmp_path, f'precondition = ["open"]\n{expected}', 0.5)
    lh.run(file, record=tmp_path / "run.csv")
    rows = [line.split(",") for line in (tmp_path / "run.csv").read_text().splitlines()]
    angle = rows[0].index("gate_angle_deg")
    kept = [[cell for place, cell in enumerate(row) if place != angle] for row in rows]
    (tmp_path / "part.csv").write_text("\n".join(map(",".join, kept)) + "\n")
    about = expectations_of(JudgeRequest((), file))
    assert judged([tmp_path / "run.csv"], about).fault_notes == ()
    part = judged([tmp_path / "part.csv"], about)
    assert part.verdicts["soft"].verdict == "pass"
    assert part.fault_notes == ("precondition: open: no gate angle before 0.1 s says whether it was completed",)


def test_the_reason_of_an_inconclusive_run_names_the_undecided_expectations(tmp_path: Path) -> None:
    text = OPENS + "".join(
        f"[[expect]]\nname = '{name}'\nalways = 'pinch_force_n < 150'\nafter = 'gate_angle_deg > {angle}'\n"
        for name, angle in (("a", 200), ("b", 200), ("c", 300), ("d", 10))
    )
    result = lh.run(scenario(tmp_path, text))
    assert (result.verdict, result.ending) == ("inconclusive", "inconclusive")
    assert result.reason == (
        "a, b: its trigger never came: gate_angle_deg > 200; c: its trigger never came: gate_angle_deg > 300"
    )


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('precondition = ["open", "reset"]', "allowed: a list of open, close, stop"),
        ('precondition = "open"', "allowed: a list of open, close, stop"),
        ("precondition = [1]", "allowed: a list of open, close, stop"),
    ],
)
def test_an_invalid_precondition_is_reported(tmp_path: Path, line: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        lh.run(scenario(tmp_path, line + "\n"))
    assert f"precondition: {line.split(' = ')[1]}".replace('"', "'") in str(caught.value)
    assert said in str(caught.value)


class Listens:
    """An ECU that sends nothing, and keeps the times [s] at which it was called."""

    times: list[float]
    period_s = 0.001

    def __init__(self) -> None:
        self.times = []

    def request(self, action: str) -> None:
        pass

    def step(self, now_s: float, frames: object) -> list[object]:
        self.times.append(now_s)
        return []


@pytest.mark.parametrize("clock", ["free", "lockstep"])
def test_the_ecus_clock_is_continuous_through_the_precondition(tmp_path: Path, clock: str) -> None:
    ecu = Listens()
    lh.run(scenario(tmp_path, LEARNED + OPENS, 1.0), ecu=ecu, clock=clock)
    steps = [b - a for a, b in itertools.pairwise(ecu.times)]
    assert min(steps) == pytest.approx(0.001)
    assert max(steps) == pytest.approx(0.001)
    assert ecu.times[0] == 0.0
    assert ecu.times[-1] > 3.0  # two motions that never began, and the scenario


# Reset.

RESET = '[[request]]\ntime = 2.0\naction = "reset"\n'


def test_a_reset_of_the_reference_ecu_stops_the_gate_and_clears_what_was_learned(tmp_path: Path) -> None:
    text = LEARNED + OPENS + RESET + '[[request]]\ntime = 4.0\naction = "open"\n' + OPEN
    text += '[[expect]]\nname = "stops"\neventually = "abs(gate_rate_degps) < 0.1"\nafter = 2.0\nwithin_s = 1.0\n'
    result = lh.run(scenario(tmp_path, text, 15.0))
    assert result.verdict == "pass"
    assert texts(result) == ["opening", "opening", "open, travel learned"]
    assert [round(each.time, 1) for each in result.events[:2]] == [0.5, 4.0]


class Counts:
    """ECU whose frame has the number of its calls since it was created."""

    period_s = 0.01

    def __init__(self) -> None:
        self.calls = 0

    def step(self, now_s: float, frames: object) -> list[object]:
        import can

        self.calls += 1
        return [can.Message(arbitration_id=0x555, data=self.calls.to_bytes(4, "big"), is_extended_id=False)]


def calls(log: Path) -> list[int]:
    """Return the numbers in the frames of `Counts` or LIBRARY, in order."""
    return [int(line.split("#")[1].split()[0], 16) for line in log.read_text().splitlines() if " 555#" in line]


@pytest.mark.parametrize("clock", ["free", "lockstep"])
def test_a_reset_creates_a_new_python_ecu(tmp_path: Path, clock: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    log = tmp_path / "run.log"
    lh.run(scenario(tmp_path, RESET, 3.0), f"{Path(__file__).stem}:Counts", clock, record=log)
    told = calls(log)
    assert max(told) == pytest.approx(200, abs=2)
    assert told.count(1) == 2
    assert told[-1] == pytest.approx(100, abs=2)


class Resets(Counts):
    """ECU with a reset method of its own."""

    def reset(self) -> None:
        self.calls = 0


def test_an_ecu_object_is_reset_by_its_own_method_or_makes_the_run_an_error(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    lh.run(scenario(tmp_path, RESET, 3.0), Resets(), record=log)
    assert calls(log).count(1) == 2
    result = lh.run(scenario(tmp_path, RESET, 3.0), Counts())
    assert result.verdict == "error"
    assert "cannot be reset; allowed: MODULE:CLASS, or an object with reset()" in result.reason


LIBRARY = """
#include "liftgate_ecu.h"
#include <string.h>
static uint32_t calls; /* what generated code keeps */
void *liftgate_ecu_create(void) { return &calls; }
void liftgate_ecu_destroy(void *ecu) { (void)ecu; }
int liftgate_ecu_step(void *ecu, int64_t now_ns, const struct liftgate_frame *in, int count,
                      struct liftgate_frame *out, int capacity)
{
    (void)ecu; (void)now_ns; (void)in; (void)count; (void)capacity;
    calls++;
    memset(out, 0, sizeof *out);
    out->id = 0x555;
    out->length = 4;
    for (int i = 0; i < 4; i++) out->data[i] = (uint8_t)(calls >> (24 - 8 * i));
    return 1;
}
"""


def test_a_reset_reloads_an_ecu_library_with_its_static_variables(tmp_path: Path) -> None:
    from c_library import build

    log = tmp_path / "run.log"
    result = lh.run(scenario(tmp_path, RESET, 3.0), str(build(tmp_path, LIBRARY)), record=log)
    assert result.reason == ""
    told = calls(log)
    assert told.count(1) == 2
    assert max(told) == pytest.approx(2000, abs=2)
