"""Stimuli at times that a run does not reach."""

from __future__ import annotations

from pathlib import Path

from hil_support import text_file

import liftgate_hil as lh

SCENARIO = """duration = 3.0
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


def test_a_stimulus_that_is_never_made_is_noted(tmp_path: Path) -> None:
    path = text_file(tmp_path / "s.toml", SCENARIO)
    notes = [each for each in lh.run(path).notes if "never made" in each]
    assert notes == [
        "request close at 5 s is never made: the run ends at 3 s",
        "an obstacle at 50 s is never made: the run ends at 3 s",
        "fault spring_lost at 3 s is never made: the run ends at 3 s",
        "change of supply_voltage_v at 40 s is never made: the run ends at 3 s",
    ]
    assert not [each for each in lh.run(path, duration=60.0).notes if "never made" in each]
