"""Obstacle and springs in force in a running gate, as its page draws them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from liftgate_hil.operate.attachment.drawing import Acting
from liftgate_hil.operate.by_hand import held_obstacle, obstacle_in
from liftgate_hil.plan.plan import plan_of
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.stimuli.command_queue import NAMES
from liftgate_hil.stimuli.faults import look
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan

TEXT = """
duration = 5
[[obstacle]]
angle_deg = 40
distance = 0.8
meets = "opening"
start = 2.0
end = 4.0
[[fault]]
kind = "spring_weak"
where = "left"
factor = 0.25
start = 1.0
"""


@pytest.fixture
def acting(tmp_path: Path) -> Acting:
    path = tmp_path / "s.toml"
    path.write_text(TEXT, encoding="utf-8")
    plan = plan_of(Job(RunRequest(path, clock="realtime")))
    begin = plan.start.with_own_arrays()
    return Acting(plan.setup.vehicle, begin.config, begin.stimuli, begin.state.reception)


def command(stimuli: StimulusPlan, **keys: object) -> None:
    """Hold the obstacle of these keys, as an operator's command does; without keys, remove it."""
    for name, value in held_obstacle(obstacle_in(keys, 1.2) if keys else None).items():
        stimuli.held[NAMES.index(name)] = value


def test_the_drawn_obstacle_is_the_commanded_one_or_that_of_the_scenario_while_present(acting: Acting) -> None:
    own = {"angle_deg": 40.0, "distance": 0.8, "meets": "opening"}
    assert [acting.at(time)["obstacle"] for time in (1.9, 2.1, 4.1)] == [None, own, None]
    command(acting.stimuli, angle_deg=30)
    assert acting.at(2.1)["obstacle"] == {"angle_deg": 30.0, "distance": 1.2, "meets": "closing"}
    command(acting.stimuli)
    assert acting.at(2.1)["obstacle"] == own
    json.dumps(acting.at(2.1))


def test_the_drawn_spring_force_is_reduced_by_faults_in_force(acting: Acting) -> None:
    assert acting.at(0.5)["spring_health"] == {"left": 1.0, "right": 1.0}
    look(acting.stimuli.faults, acting.stimuli.moments, 1.5)  # as the loop does
    assert acting.at(1.5)["spring_health"] == {"left": 0.25, "right": 1.0}
