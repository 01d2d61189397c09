"""Faults in force too briefly to matter are reported, for a run and for its recording alike."""

from __future__ import annotations

from pathlib import Path

import pytest
from hil_support import text_file

import liftgate_hil as lh
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.testing import suite
from liftgate_hil.testing.rejudge import expectations_of, judged
from liftgate_hil.testing.request import JudgeRequest
from liftgate_hil.testing.words import happenings

HEAD = """
duration = 2.0
initial = 30
[[request]]
time = 0.1
action = "open"
[[expect]]
name = "x"
always = "time_s > 0"
"""
LOST = 'kind = "frame_lost"\nwhere = "DriveCommand"\ndirection = "received"\n'
# A fault, and what is told of it. The command's time-out is 3 cycles of 10 ms, that of LeftDrive 3 of 5 ms.
FAULTS = [
    (LOST + "start = 1.0\nfor_s = 0.02\n", "frame_lost) was in force for 0.02 s, from 1 s: too short to matter, "
     "the time-out of DriveCommand bridges 0.03 s"),
    (LOST + "start = 1.0\nfor_s = 0.03\n", None),
    (LOST + "start = 1.995\n", "in force for 0.005 s, from 1.995 s"),
    ('kind = "supply_open"\nstart = 1.0\nend = "time_s > 0.5"\n', "in force for 0.001 s, from 1 s"),
    ('kind = "supply_open"\nstart = "gate_angle_deg > 32"\ndelay_s = 0.1\nfor_s = 0.01\n', "for 0.01 s, from "),
    ('kind = "supply_open"\nstart = "gate_angle_deg > 32"\nend = "gate_angle_deg > 34"\n', None),
    ('kind = "supply_open"\nstart = "gate_angle_deg > 32"\nend = "gate_angle_deg > 31"\n', "for 0.001 s, from "),
    ('kind = "frame_frozen"\nwhere = "LeftDrive"\ndirection = "sent"\nstart = 1.0\nend = 1.01\n',
     "the time-out of LeftDrive bridges 0.015 s"),
    (LOST + "period_s = 0.02\nshare = 0.5\nstart = 1.0\n", None),  # intermittent: as a whole
]  # fmt: skip


@pytest.mark.parametrize(("fault", "note"), FAULTS)
def test_a_fault_in_force_for_too_short_a_time_is_reported(tmp_path: Path, fault: str, note: str | None) -> None:
    path, log = tmp_path / "s.toml", [tmp_path / "r.csv", tmp_path / "r.log"]
    path.write_text(f"{HEAD}[[fault]]\n{fault}")
    result = lh.run(path, record=log)
    assert result.verdict == "pass"
    assert len(result.notes) == (note is not None)
    if note is not None:
        assert result.notes[0].startswith("fault[0] (")
        assert note in result.notes[0]
    assert judged(log, expectations_of(JudgeRequest(recordings=log, scenario=path))).fault_notes == result.notes


def test_the_note_on_a_brief_fault_is_among_the_notes_of_the_outcome(tmp_path: Path) -> None:
    path = text_file(tmp_path / "s.toml", f"{HEAD}[[fault]]\n{FAULTS[0][0]}")
    (case,) = suite.cases_of([path], Job(RunRequest()))
    assert FAULTS[0][1] is not None
    assert [each for each in suite.run_case(case).notes if FAULTS[0][1] in each]


@pytest.mark.parametrize(
    ("faults", "notes"),
    [
        (["start = 5.0"], ["fault supply_open at 5 s is never made: the run ends at 2 s"]),  # nor was it too short
        (
            ['start = "time_s >= 1"\ndelay_s = 5', 'start = "time_s >= 1"\ndelay_s = 0.5'],
            ["fault supply_open, 5 s after time_s >= 1, is never made: at 6 s, where the run ends at 2 s"],
        ),
        (
            ['start = "time_s >= 1"\ndelay_s = 1'],
            ["fault supply_open, 1 s after time_s >= 1, is never made: at 2 s, where the run ends at 2 s"],
        ),
    ],
)
def test_a_stimulus_due_at_or_after_the_end_of_a_run_is_noted_as_never_made(
    tmp_path: Path, faults: list[str], notes: list[str]
) -> None:
    text = "".join(f'[[fault]]\nkind = "supply_open"\n{fault}\n' for fault in faults)
    assert list(lh.run(text_file(tmp_path / "s.toml", HEAD + text)).notes) == notes


def test_a_result_and_its_report_say_when_a_condition_came_true(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    # The end's condition counts after the start's: it came true, and no stimulus begins with it.
    faults = "".join(
        f'[[fault]]\nkind = "supply_open"\nstart = "{start}"\ndelay_s = 0.25\nend = "time_s >= 1.5"\n'
        for start in ("time_s >= 1", "gate_angle_deg > 79")
    )
    path.write_text(HEAD + faults)
    (case,) = suite.cases_of([path], Job(RunRequest()))
    outcome = suite.run_case(case)
    assert outcome.result is not None
    assert outcome.result.condition_times == {"time_s >= 1": 1.0}
    told = happenings(case.plan.setup.scenario, outcome.result.condition_times, 2.001)
    came = [each.rpartition(" (the condition ")[2] for each in told[-2:]]
    assert came == ["came true at 1.000 s)", "had not come true when the run ended, at 2.001 s)"]
    assert outcome.to_dict()["condition_times"] == {"time_s >= 1": 1.0}


BEHIND = """duration = 3.0
[[request]]
time = 5
action = "close"
[[request]]
time = 1
action = "open"
[[request]]
time = "gate_angle_deg > 200"
action = "stop"
[[obstacle]]
start = 50
angle_deg = 35
stiffness = 10000
[[fault]]
kind = "spring_lost"
where = "left"
start = 3.0
[[profile]]
quantity = "supply_voltage_v"
points = [[0, 12], [1, 13], [40, 13], [41, 9]]
[[expect]]
name = "stays"
always = "gate_angle_deg < 200"
"""


def test_a_stimulus_that_is_never_applied_is_noted(tmp_path: Path) -> None:
    path = text_file(tmp_path / "s.toml", BEHIND)
    notes = [each for each in lh.run(path).notes if "never made" in each]
    assert notes == [
        "request close at 5 s is never made: the run ends at 3 s",
        "an obstacle at 50 s is never made: the run ends at 3 s",
        "fault spring_lost at 3 s is never made: the run ends at 3 s",
        "change of supply_voltage_v at 40 s is never made: the run ends at 3 s",
    ]
    assert not [each for each in lh.run(path, duration=60.0).notes if "never made" in each]
