"""Scenario files: allowed values, and all issues at once."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hil_support import issues_of, keys_of, text_file

from liftgate_hil.config.scenario import Scenario, load_scenario
from liftgate_hil.plan.setup import scenario_from, setup_of
from liftgate_hil.signals import PROFILES
from liftgate_hil.stimuli.moments import no_moments
from liftgate_hil.stimuli.stimulus_plan import TimedStimuli
from liftgate_hil.stimuli.timeline import Timeline, obstacle_at, profiles_over, supply_rise_over, timeline_of


def load(tmp_path: Path, text: str) -> Scenario:
    return load_scenario(text_file(tmp_path / "stimuli.toml", text))


def timeline_in(stimuli: TimedStimuli) -> Timeline:
    return timeline_of(stimuli.profiles, stimuli.obstacles)


def faults_of(tmp_path: Path, text: str) -> list[str]:
    issues = issues_of(load, tmp_path, text)
    for fault in issues:
        assert fault.startswith(str(tmp_path / "stimuli.toml"))
    return issues


def test_the_demo_scenario_requests_open_and_close_twice_around_an_obstacle():
    scenario = scenario_from("demo")
    assert [request.action for request in scenario.requests] == ["open", "close"] * 2
    assert len(scenario.stimuli.obstacles) == 1
    assert scenario.duration is not None


def test_a_switch_profile_is_held_and_takes_only_0_and_1(tmp_path: Path):
    """A switch has no values between two points."""
    lines = ["[[profile]]", 'quantity = "handle_pulled"', "points = [[0, 0], [1, 1], [2, 0]]"]
    timeline = timeline_in(load(tmp_path, "\n".join(lines)).stimuli)
    for time, value in ((0.5, 0.0), (1.5, 1.0), (2.5, 0.0)):
        assert profiles_over(timeline, time, 0.001).handle_pulled == value
    lines[-1] = 'interpolation = "linear"\npoints = [[0, 0.5]]'
    told = faults_of(tmp_path, "\n".join(lines))
    assert keys_of(told) == ["profile[0].interpolation", "profile[0].points[0][1]"]


def test_all_issues_of_a_file_are_reported_at_once(tmp_path: Path):
    text = """
duration = -3
speed = 4
[[profile]]
quantity = "voltage"
points = [[0, 1]]
[[profile]]
quantity = "road_slope_deg"
interpolation = "cubic"
points = [[0, 0], [1, 60], [1, 5], [0.5, nan], "x", [1, 2, 3]]
[[profile]]
quantity = "snow_mass_kg"
[[profile]]
quantity = "hand_force_n"
points = [[1, 0]]
[[profile]]
quantity = "hand_force_n"
points = [[1, 0]]
[[obstacle]]
stiffness = 0
meets = "falling"
height = 3
[[obstacle]]
start = 5
end = 4
angle_deg = 10
[[request]]
time = "now"
action = "fly"
[[request]]
"""
    keys = keys_of(faults_of(tmp_path, text))
    expected = (
        "duration speed profile[0].quantity profile[1].interpolation profile[1].points[1][1] "
        "profile[1].points[2][0] profile[1].points[3][1] profile[1].points[4] profile[1].points[5] "
        "profile[2].points profile obstacle[0].stiffness obstacle[0].meets obstacle[0].height "
        "obstacle[0].angle_deg obstacle[1].end request[0].time request[0].action request[1].time request[1].action"
    )
    assert {*expected.split()} <= {*keys}


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("duration = inf", "duration"),
        ("duration = '3'", "duration"),
        ("profile = 3", "profile"),
        ("profile = [3]", "profile[0]"),
        ("obstacle = 'wall'", "obstacle"),
        ("[obstacle]\nangle_deg = 3", "obstacle"),
        ("[[profile]]\nquantity = 'snow_mass_kg'\npoints = []", "profile[0].points"),
        ("[[profile]]\nquantity = 'snow_mass_kg'\npoints = [[-1, 0]]", "profile[0].points[0][0]"),
        ("[[profile]]\npoints = [[0, 0]]", "profile[0].quantity"),
        ("[[obstacle]]\nangle_deg = 300", "obstacle[0].angle_deg"),
        ("[[obstacle]]\nangle_deg = 30\nend = 0", "obstacle[0].end"),
        ("[[request]]\ntime = -1\naction = 'open'", "request[0].time"),
        ("[[request]]\ntime = 1\naction = ['open']", "request[0].action"),
    ],
)
def test_each_issue_names_its_key(tmp_path: Path, text: str, key: str):
    assert key in keys_of(faults_of(tmp_path, text))


def test_requests_are_sorted_by_their_times(tmp_path: Path):
    text = "".join(
        f"[[request]]\ntime = {time}\naction = '{action}'\n"
        for time, action in ((3, "stop"), (1, "open"), (2.5, "close"))
    )
    scenario = load(tmp_path, text)
    assert [(request.when.time, request.action) for request in scenario.requests] == [
        (1.0, "open"),
        (2.5, "close"),
        (3.0, "stop"),
    ]


def test_profiles_are_linear_or_held_between_points_and_unset_before_the_first(tmp_path: Path):
    scenario = load(
        tmp_path,
        """
[[profile]]
quantity = "supply_voltage_v"
points = [[1, 10], [2, 12], [4, 8]]
[[profile]]
quantity = "road_slope_deg"
interpolation = "hold"
points = [[1, 10], [2, -10]]
""",
    )

    timeline = timeline_in(scenario.stimuli)

    def at(name: str, time: float) -> float:
        return float(getattr(profiles_over(timeline, time, 0.0), name))

    assert [at("supply_voltage_v", time) for time in (0.0, 0.999, 1.0, 1.5, 2.0, 3.0, 4.0, 1e6)] == (
        pytest.approx([math.nan, math.nan, 10.0, 11.0, 12.0, 10.0, 8.0, 8.0], nan_ok=True)
    )
    assert [at("road_slope_deg", time) for time in (0.5, 1.0, 1.999, 2.0, 50.0)] == (
        pytest.approx([math.nan, 10.0, 10.0, -10.0, -10.0], nan_ok=True)
    )
    # Over a step: a straight line's mean and its rise, what is held as it is at the start. A
    # point inside the step is passed over.
    over = profiles_over(timeline, 2.0, 0.5)
    assert (over.supply_voltage_v, over.road_slope_deg) == pytest.approx((11.5, -10.0))
    over = profiles_over(timeline, 1.75, 0.5)
    assert (over.supply_voltage_v, over.road_slope_deg) == pytest.approx((11.5, 10.0))
    rises = [supply_rise_over(timeline, time, 0.5) for time in (0.75, 1.0, 2.0, 4.0)]
    assert rises == pytest.approx([0.0, 1.0, -1.0, 0.0])
    # What has no profile says nothing.
    for name in PROFILES:
        if name not in ("supply_voltage_v", "road_slope_deg"):
            assert math.isnan(at(name, 1.0)), name


@pytest.mark.parametrize("points", [1, 2, 3, 17])
def test_a_profile_is_interpolated_in_every_interval(tmp_path: Path, points: int):
    listed = ", ".join(f"[{index}, {index * index}]" for index in range(points))
    scenario = load(tmp_path, f"[[profile]]\nquantity = 'hand_force_n'\npoints = [{listed}]\n")
    timeline = timeline_in(scenario.stimuli)
    for index in range(points - 1):
        for share in (0.0, 0.25, 0.75):
            expected = index**2 + share * ((index + 1) ** 2 - index**2)
            found = profiles_over(timeline, index + share, 0.0).hand_force_n
            assert found == pytest.approx(expected)


def test_an_obstacle_exists_from_its_start_to_its_end(tmp_path: Path):
    scenario = load(tmp_path, "[[obstacle]]\nstart = 1\nend = 2\nangle_deg = 30\n")
    timeline = timeline_in(scenario.stimuli)
    for time, there in ((0.999, False), (1.0, True), (1.999, True), (2.0, False)):
        found = obstacle_at(timeline, no_moments(), time)
        assert bool(found.stiffness > 0.0) is there


# What is given to a scenario, and what it gives to a vehicle.

ROD = "[parameters]\nrod = 1000\n[[obstacle]]\nangle_deg = 30\nstiffness = '$rod'\n"


@pytest.mark.parametrize("value", ["a", None, True, math.nan, 1e300, [1]])
def test_an_invalid_parameter_of_the_caller_is_reported_once_as_the_callers(tmp_path: Path, value: object):
    path = text_file(tmp_path / "stimuli.toml", ROD)
    (issue,) = issues_of(load_scenario, path, {"rod": value})
    assert issue.startswith("`parameters` rod: ")


def test_an_invalid_parameter_of_the_file_is_reported_once(tmp_path: Path):
    assert keys_of(faults_of(tmp_path, ROD.replace("1000", "'a'"))) == ["parameters.rod"]
    assert keys_of(faults_of(tmp_path, ROD.replace("$rod", "$bar"))) == ["obstacle[0].stiffness"]


def test_a_parameter_out_of_range_for_its_key_is_reported_at_that_key(tmp_path: Path):
    (issue,) = faults_of(tmp_path, ROD.replace("1000", "-1"))
    assert ": obstacle[0].stiffness: -1.0 is out of range" in issue


@pytest.mark.parametrize(
    "said", ['"motor.resistance" = -1', "motor.resistance = -1", "motor = { resistance = -1 }"]
)
def test_an_invalid_setting_of_a_scenario_is_not_reported_for_the_vehicle_file(tmp_path: Path, said: str):
    scenario = load(tmp_path, f"[set]\n{said}\n")
    (issue,) = issues_of(setup_of, scenario)
    assert issue.startswith(f"{tmp_path / 'stimuli.toml'}: set.motor.resistance: -1 is out of range")


def test_a_vehicle_path_is_resolved_beside_the_scenario_even_if_it_is_a_folder(tmp_path: Path):
    (tmp_path / "gate.toml").mkdir()
    assert load(tmp_path, 'vehicle = "gate.toml"\n').vehicle == str(tmp_path / "gate.toml")


def test_a_folder_does_not_hide_a_shipped_vehicle_of_the_same_name(tmp_path: Path):
    (tmp_path / "suv").mkdir()
    assert load(tmp_path, 'vehicle = "suv"\n').vehicle == "suv"
