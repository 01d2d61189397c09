"""Stimuli that wait for a condition, and faults over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from formulas import COLUMNS, FORMULAS, PARAMETERS, SIGNALS, VALUES, Made
from hil_support import CALM, issues_of, keys_of, text_file
from hypothesis import given, reject
from hypothesis import strategies as st

import liftgate_hil as lh
from liftgate_hil.conditions.parser import parsed
from liftgate_hil.errors import ConfigError
from liftgate_hil.signals import COLUMN_PLACE
from liftgate_hil.stimuli.moments import necessary


def ran(folder: Path, text: str, **more: Any) -> lh.Result:
    path = text_file(folder / "s.toml", text)
    return lh.run(path, trace=True, **more)


OPENING = 'duration = 3.0\ninitial = 30\n[[request]]\ntime = 0.1\naction = "open"\n'


def first_tick(result: lh.Result, column: str, above: float) -> int:
    """Return the index of the first row in which a column exceeds a value; 0 if there is none."""
    return int(np.argmax(result.trace[column] > above))


@pytest.mark.parametrize("delay", [0, 250])  # ticks
def test_a_stimulus_acts_from_the_tick_after_its_condition_came_true_plus_its_delay(
    tmp_path: Path, delay: int
) -> None:
    fault = '[[fault]]\nkind = "motor_open"\nwhere = "left"\nstart = "gate_angle_deg > 32"\n'
    result = ran(tmp_path, f"{OPENING}{fault}delay_s = {1e-3 * delay}\n")
    begin = first_tick(result, "gate_angle_deg", 32.0) + delay
    current = result.trace["left_current_a"]
    assert current[begin] != 0.0
    assert np.all(current[begin + 1 :] == 0.0)


def test_the_duration_of_a_fault_counts_from_its_start(tmp_path: Path) -> None:
    """The duration is counted in ticks from the fault's start, whatever its condition does meanwhile."""
    fault = '[[fault]]\nkind = "motor_open"\nwhere = "left"\nfor_s = 0.3\n'
    result = ran(tmp_path, OPENING + fault + 'start = "gate_angle_deg > 32"\ndelay_s = 0.1\n')
    begin = first_tick(result, "gate_angle_deg", 32.0) + 1 + 100
    current = result.trace["left_current_a"]
    assert np.all(current[begin : begin + 300] == 0.0)
    assert current[begin - 1] != 0.0
    assert current[begin + 300] != 0.0
    result = ran(tmp_path, OPENING + fault + "start = 1.0\n")
    current = result.trace["left_current_a"]
    assert np.flatnonzero(current[500:-1] == 0.0).tolist() == list(range(500, 800))


def test_the_end_condition_of_a_fault_is_evaluated_only_after_its_start(tmp_path: Path) -> None:
    # The rate is above 1 long before the fault begins.
    fault = '[[fault]]\nkind = "bridge_stuck"\nstate = "coast"\nstart = 1.5\nend = "gate_rate_degps > 1"\n'
    result = ran(tmp_path, OPENING + fault)
    coast = result.trace["left_coast"]
    assert coast[1500] == 1.0
    assert coast[1501] == 0.0  # it still moved


def test_a_request_waits_for_a_condition_of_a_bus_signal(tmp_path: Path) -> None:
    later = '[[request]]\ntime = "Gate.Angle > 33"\naction = "stop"\n'
    result = ran(tmp_path, OPENING + later)
    assert [event.text for event in result.events if "stop" in event.text.lower()] or (
        abs(result.trace["gate_rate_degps"][-1]) < 0.1
    )
    assert 33.0 < result.trace["gate_angle_deg"][-1] < 36.0


def test_an_obstacle_appears_and_disappears_by_conditions(tmp_path: Path) -> None:
    text = (
        'duration = 3.0\ninitial = 50\n[[request]]\ntime = 0.1\naction = "close"\n'
        '[[obstacle]]\nangle_deg = 45\nstart = "gate_rate_degps < -3"\nend = "pinch_force_n > 20"\n'
    )
    result = ran(tmp_path, text)
    force = result.trace["pinch_force_n"]
    assert 20.0 < force.max() < 30.0
    assert force[first_tick(result, "pinch_force_n", 20.0) + 2] == 0.0


@pytest.mark.parametrize("clock", ["free", "lockstep"])
def test_an_intermittent_fault_is_on_in_the_first_part_of_each_period(tmp_path: Path, clock: str) -> None:
    fault = '[[fault]]\nkind = "bridge_stuck"\nstate = "coast"\nstart = 0.5\nend = 1.45\n'
    fault += "period_s = 0.2\nshare = 0.25\n"
    result = ran(tmp_path, OPENING + fault, clock=clock, duration=2.0)
    on = result.trace["left_coast"] == 1.0
    # A row holds what drove the step before it.
    expected = [500 <= k < 1450 and (k - 500) % 200 < 50 for k in range(200, 2000)]
    assert on[200:2000].tolist() == expected


def test_a_ramped_fault_parameter_changes_linearly_to_its_value(tmp_path: Path) -> None:
    text = (
        'duration = 3.0\ninitial = 30\n[[fault]]\nkind = "parameter"\nkey = "supply.voltage"\n'
        "value = 9.0\nstart = 1.0\nend = 2.5\nramp_s = 1.0\n"
    )
    volts = ran(tmp_path, text, ideal=True).trace["supply_voltage_v"]
    assert volts[999] == 12.0
    assert volts[1499] == pytest.approx(12.0 - 3.0 * 0.499)
    assert volts[1999] == pytest.approx(9.0, abs=0.01)
    assert volts[2400] == 9.0
    assert volts[2501] == 12.0


def test_conditional_stimuli_act_alike_on_free_and_lockstep_clocks(tmp_path: Path) -> None:
    text = OPENING + (
        '[[fault]]\nkind = "hall_missing"\nprobability = 0.2\nstart = "gate_angle_deg > 31"\n'
        '[[fault]]\nkind = "spring_weak"\nfactor = 0.5\nstart = 1.0\nperiod_s = 0.5\nshare = 0.5\n'
        '[[request]]\ntime = "sensed.left_hall_count > 100"\naction = "close"\n'
    )
    free = ran(tmp_path, text, clock="free")
    lockstep = ran(tmp_path, text, clock="lockstep")
    for name, values in free.trace.items():
        assert np.array_equal(values[:3000], lockstep.trace[name][:3000]), name


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('[[fault]]\nkind = "nix"', "fault[0].kind: 'nix'; allowed: one of supply_open"),
        ('[[fault]]\nkind = "motor_open"\nstart = "gate_angle > 3"', "fault[0].start: gate_angle: no such column"),
        ('[[fault]]\nkind = "motor_open"\nstart = "Nobody.X > 3"', "Nobody.X: no such signal"),
        ('[[fault]]\nkind = "motor_open"\nstart = 3\nend = 2', "fault[0].end: 2; allowed: later than start"),
        ('[[fault]]\nkind = "motor_open"\nfor_s = 0.3\nend = 2.0', "fault[0].for_s: allowed: without end"),
        ('[[fault]]\nkind = "motor_open"\nshare = 0.5', "fault[0].share: allowed: together with period_s"),
        ('[[fault]]\nkind = "motor_open"\nstart = true', "start: True; allowed: 0 to 1e+06 s, or a condition"),
        ('[[fault]]\nkind = "parameter"\nkey = "gate.mas"\nvalue = 1', "'gate.mas': no such parameter"),
        ('[[request]]\ntime = "x"\naction = "open"', "request[0].time: x: no such column"),
        ('[[obstacle]]\nangle_deg = 30\nend = "latched"', "obstacle[0].end: 'latched' is not a comparison"),
    ],
)  # fmt: skip
def test_mistakes_in_conditional_stimuli_are_reported(tmp_path: Path, table: str, said: str) -> None:
    issues = issues_of(ran, tmp_path, f"duration = 1.0\n{table}\n")
    assert any(said in issue for issue in issues)
    assert all(issue.startswith(str(tmp_path / "s.toml")) for issue in issues)


def test_a_fault_of_a_missing_drive_is_refused(tmp_path: Path) -> None:
    text = 'duration = 1.0\n[[fault]]\nkind = "motor_open"\nwhere = "right"\nstart = "right_current_a > 1"\n'
    assert keys_of(issues_of(ran, tmp_path, text, vehicle="compact")) == ["fault[0].where", "fault[0].start"]


def test_no_expectation_passes_if_a_stimulus_never_occurred(tmp_path: Path) -> None:
    text = (
        'duration = 0.2\n[[fault]]\nkind = "motor_open"\nstart = "gate_angle_deg > 500"\n'
        '[[expect]]\nname = "holds"\nalways = "1 < 2"\n[[expect]]\nname = "fails"\nalways = "2 < 1"\n'
    )
    found = ran(tmp_path, text).expectations
    assert found["holds"].verdict == "inconclusive"
    assert found["holds"].reason == "fault[0].start never came: gate_angle_deg > 500"
    assert found["fails"].verdict == "fail"


def test_all_stimuli_that_never_occurred_are_named(tmp_path: Path) -> None:
    text = (
        'duration = 0.2\n[[fault]]\nkind = "motor_open"\nstart = "gate_angle_deg > 500"\n'
        '[[request]]\naction = "open"\ntime = "left_duty > 3"\n'
        '[[expect]]\nname = "holds"\nalways = "1 < 2"\n'
    )
    reason = ran(tmp_path, text).expectations["holds"].reason
    assert sorted(reason.split("; ")) == [
        "fault[0].start never came: gate_angle_deg > 500",
        "request[0].time never came: left_duty > 3",
    ]


@pytest.mark.parametrize("state", ["present", "absent"])
def test_a_trouble_code_is_inconclusive_if_its_fault_never_occurred(tmp_path: Path, state: str) -> None:
    text = (
        'duration = 1.0\n[[fault]]\nkind = "motor_open"\nwhere = "left"\nstart = "gate_angle_deg > 500"\n'
        f'[[expect]]\nname = "code"\ndtc = "B1A01"\nstate = "{state}"\n'
    )
    verdict = ran(tmp_path, text).expectations["code"]
    assert verdict.verdict == "inconclusive"
    assert verdict.reason == "fault[0].start never came: gate_angle_deg > 500"


def test_a_delay_is_added_to_a_start_time_too(tmp_path: Path) -> None:
    fault = '[[fault]]\nkind = "bridge_stuck"\nstate = "coast"\nstart = 0.5\nend = 1.0\ndelay_s = 0.25\n'
    coast = ran(tmp_path, OPENING + fault).trace["left_coast"]
    assert coast[200:2000].tolist() == [float(750 <= k < 1250) for k in range(200, 2000)]


def test_an_on_or_off_time_of_a_fault_shorter_than_a_tick_is_refused(tmp_path: Path) -> None:
    fault = '[[fault]]\nkind = "bridge_stuck"\nstate = "coast"\nperiod_s = 0.01\nshare = 0.05\n'
    with pytest.raises(ConfigError, match=r"fault\[0\].period_s: 0.01: on or off for less than a tick of 1 ms"):
        ran(tmp_path, OPENING + fault)
    ran(tmp_path, OPENING + fault, rate=10_000.0, duration=0.05)


@CALM
@given(FORMULAS, st.lists(VALUES, min_size=5, max_size=5))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_pre_filter_of_a_condition_skips_no_true_tick(formula: Made, values: list[float]) -> None:
    text, value = formula
    known = dict(zip([*COLUMNS, *SIGNALS], values, strict=True))
    try:
        column, low, high = necessary(parsed(text, PARAMETERS))
    except ValueError:  # such as seconds beside their square
        reject()
    if column >= 0 and value(known)[0]:
        name = next(each for each, own in COLUMNS.items() if COLUMN_PLACE[own] == column)
        assert low <= known[name] <= high


@pytest.mark.parametrize(
    ("text", "column", "low", "high"),
    [
        ("gate_angle_deg > 20", "gate_angle_deg", 20.0, np.inf),
        ("20 >= gate_angle_deg", "gate_angle_deg", -np.inf, 20.0),
        ("-5 < gate_rate_degps", "gate_rate_degps", -5.0, np.inf),
        ("latched == 1 and gate_angle_deg < 3", "latched", 1.0, 1.0),
        ("abs(gate_rate_degps) > 5 and time_s > 2", "time_s", 2.0, np.inf),
        ("(latched == 0 or time_s > 2) and time_s < 9", "time_s", -np.inf, 9.0),
        ("latched == 0 or time_s > 2", "", -np.inf, np.inf),
        ("not time_s > 2", "", -np.inf, np.inf),
        ("time_s != 2", "", -np.inf, np.inf),
        ("Gate.Angle > 33", "", -np.inf, np.inf),
        ("2 * gate_angle_deg > 33", "", -np.inf, np.inf),
    ],
)
def test_the_pre_filter_is_a_range_of_one_column(text: str, column: str, low: float, high: float) -> None:
    place = COLUMN_PLACE[column] if column else -1
    assert necessary(parsed(text, {})) == (place, low, high)
