"""Description of a scenario in words for attached clients."""

from __future__ import annotations

from pathlib import Path

from liftgate_hil.operate.attachment.description import stimuli_of
from liftgate_hil.plan.setup import setup_of

SCENARIO = """\
duration = 20
[[request]]
time = 0.5
action = "open"
[[request]]
time = "gate_angle_deg > 70"
delay_s = 0.2
action = "close"
[[profile]]
quantity = "road_slope_deg"
points = [[1, 0], [2, 8]]
[[obstacle]]
angle_deg = 40
stiffness = 20_000
[[fault]]
kind = "hall_a_stuck"
where = "left"
value = 0
start = 2
end = "gate_angle_deg > 50"
[[signal]]
signal = "Body.VehicleSpeed"
value = 12.5
time = 3
"""


def test_each_stimulus_is_reported_with_its_time_or_condition(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(SCENARIO)
    assert stimuli_of(setup_of(path).scenario) == [
        "request open, 0.5 s",
        "request close, once gate_angle_deg > 70 and 0.2 s more",
        "profile road_slope_deg, 1 to 2 s",
        "obstacle at 40 deg, 20000 N/m",
        "fault hall_a_stuck left, seed 0, value 0; from 2 s; until once gate_angle_deg > 50",
        "signal Body.VehicleSpeed 12.5, 3 s",
    ]


def test_without_a_scenario_the_list_of_stimuli_is_empty() -> None:
    assert stimuli_of(setup_of(None).scenario) == []
