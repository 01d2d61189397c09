"""Parsing of conditions: units, and messages for invalid texts."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
from formulas import PARAMETERS
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.conditions.condition import DEEPEST, SIGNAL
from liftgate_hil.conditions.parser import parsed
from liftgate_hil.plan.setup import rig_from


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("left_current_a * left_voltage_v > 5", "A V"),
        ("left_current_a / right_current_a > 5", ""),
        ("2 * gate_angle_deg > 5", "deg"),
        ("time_s / 2 > 5", "s"),
        ("1 / time_s > 5", "1/s"),
        ("latched == 1", ""),
    ],
)
def test_products_and_quotients_have_derived_units(text: str, unit: str) -> None:
    assert parsed(text, {}).units == (unit,)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the condition ends; allowed: a column"),
        ("gate_angle_deg", "is not a comparison"),
        ("gate_angle_deg >", "the condition ends; allowed"),
        ("1 < gate_angle_deg < 3", "one comparison at a time"),
        ("gate_angle_deg > 3 )", ") at character 20; allowed: and, or, or the end"),
        (
            "gate_angle_deg > 3 deg",
            "deg at character 20; allowed: and, or, or the end; units are not written, as columns have them",
        ),
        ("gate_angle_deg > 3 AND time_s > 1", "AND at character 20; allowed: and, or, or the end"),
        ("gate_angle_deg > p", "p: no such column; allowed: $p, the parameter"),
        ("gate_angle_deg = 3", "'=' at character 16; allowed: =="),
        ("gate_angle_deg => 3", "'=>' at character 16; allowed: >="),
        ("time_s > 1 && time_s < 2", "'&' at character 12; allowed: and"),
        ("time_s > 1 || time_s < 2", "'|' at character 12; allowed: or"),
        ("!(time_s > 1)", "'!' at character 1; allowed: not"),
        ("(gate_angle_deg > 3", "the condition ends; allowed: )"),
        ("gate_angle_deg + left_current_a > 3", "combines deg and A"),
        ("gate_angle_deg > left_current_a", "combines deg and A"),
        ("gate_angle > 3", "no such column; allowed: gate_angle_deg"),
        ("sensed.gate_angel_deg > 3", "no such column; allowed: sensed.gate_angle_deg"),
        ("sensed_gate_angle_deg > 3", "no such column"),
        ("$limit > 3", "$limit: no such parameter; allowed: $p, $q"),
        ("gate_angle_deg & 3", "'&' at character 16"),
        ("gate_angle_deg > 1e999", "1e999; allowed: a finite number"),
        ("not gate_angle_deg", "a number beside `not`"),
        ("gate_angle_deg and time_s > 1", "a number beside `and`"),
        ("(time_s > 1) > 2", "a comparison where a number is expected"),
        ("abs(time_s > 1) > 2", "a comparison where a number is expected"),
        ("a.b.c > 1", "'.' at character 4"),
        ("abs > 1", "abs at character 1"),
        ("(" * (DEEPEST + 1) + "time_s > 1" + ")" * (DEEPEST + 1), "parentheses deeper than"),
        ("time_s > 1 and " * 400 + "time_s > 1", "characters; allowed"),
        ("__import__(x)", "__import__(): no such function; allowed: abs()"),
        ("rose(latched)", "rose(): no such function; allowed: abs()"),
        ("Gate.LatchState == open", "open: no such column; allowed: columns of recordings, and numbers in"),
        ("latched == open", "open: no such column; allowed: 0, which is open of latched"),
    ],
)
def test_an_invalid_condition_is_reported(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=r"allowed|expected") as caught:
        parsed(text, PARAMETERS)
    assert said in str(caught.value)


@CALM
@given(st.text(alphabet="abs()andornt $p.<>=!+-*/01e_gM\n\té", max_size=40))
def test_any_text_is_parsed_or_refused_without_a_crash(text: str) -> None:
    with contextlib.suppress(ValueError):
        parsed(text, PARAMETERS)


@pytest.mark.parametrize("operand", ["time_s", "2.5", "LeftDrive.MotorCurrent"])
def test_conditions_nested_too_deeply_for_the_evaluator_are_refused(operand: str) -> None:
    """Each pair of parentheses opened before an operator leaves one value on the evaluator's stack."""
    messages = rig_from("liftgate").messages

    def waiting(count: int) -> str:
        sums = f"0 * {operand} + (" * (count - 1) + f"0 * {operand}" + ")" * (count - 1)
        return f"{sums} < 1"

    deepest = next(count for count in range(1, DEEPEST) if not _is_taken(waiting(count + 1), messages))
    assert parsed(waiting(deepest), {}, messages).ops
    with pytest.raises(ValueError, match=f"values nested deeper than {DEEPEST}"):
        parsed(waiting(deepest + 1), {}, messages)
    assert deepest in (DEEPEST - 1, DEEPEST - 2)


def _is_taken(text: str, messages: Any) -> bool:
    try:
        parsed(text, {}, messages)
    except ValueError:
        return False
    return True


def test_unknown_signals_are_reported_with_similar_ones_of_the_database() -> None:
    messages = rig_from("liftgate").messages
    with pytest.raises(ValueError, match=r"open: no such column; allowed: 1, which is open of DriveCommand\."):
        parsed("DriveCommand.LeftDirection == open", {}, messages)
    condition = parsed("LeftDrive.MotorCurrent > left_current_a", {}, messages)
    assert condition.names(SIGNAL) == ["LeftDrive.MotorCurrent"]
    near = {
        "LeftDrive.MotorCurent": "LeftDrive.MotorCurrent, ",
        "LeftDriv.MotorCurrent": "LeftDrive.MotorCurrent, ",
        "Quite.Other": "Message.Signal of it",
    }
    for name, allowed in near.items():
        with pytest.raises(ValueError, match="no such signal in the rig's database") as caught:
            parsed(f"{name} > 1", {}, messages)
        assert f"allowed: {allowed}" in str(caught.value)
