"""Conditions: text to table, and what the evaluator makes of it against an evaluation of our own."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest
from formulas import COLUMNS, FORMULAS, PARAMETERS, SIGNALS, VALUES, Made
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.conditions import (
    DEEPEST,
    SIGNAL,
    evaluate,
    parsed,
    table_of,
    work_for,
)
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH
from liftgate_plant.compiler import compiled


def evaluated(text: str, known: list[dict[str, float]], call: Any = evaluate) -> Any:
    condition = parsed(text, PARAMETERS)
    table = table_of([condition], SIGNALS)
    rows, signals = np.full((len(known), ROW_WIDTH), np.nan), np.full((len(known), 2), np.nan)
    for i, values in enumerate(known):
        for name, column in COLUMNS.items():
            rows[i, COLUMN_PLACE[column]] = values[name]
        signals[i] = [values[name] for name in SIGNALS]
    work = work_for(max(len(known), 1))
    call(table, 0, rows, signals, len(known), work)
    return work.truths[0] != 0, work.numbers[0], work.deciders[0]


@CALM
@given(FORMULAS, st.lists(st.lists(VALUES, min_size=5, max_size=5), min_size=1, max_size=4))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_random_formulas_have_the_truth_and_the_margin_of_an_evaluation_of_our_own(
    formula: Made, values: list[list[float]]
) -> None:
    text, value = formula
    known = [dict(zip([*COLUMNS, *SIGNALS], each, strict=True)) for each in values]
    for call in (evaluate, compiled(evaluate)):
        truths, margins, _ = evaluated(text, known, call)
        for i, each in enumerate(known):
            truth, margin = value(each)
            assert bool(truths[i]) == truth
            np.testing.assert_equal(margins[i] + 0.0, margin + 0.0)


@pytest.mark.parametrize(
    ("text", "truth"),
    [
        ("time_s < 1 or time_s < 3 and latched == 1", False),  # `and` binds tighter
        ("not latched == 1 and time_s > 1", True),  # `not` tighter still, a comparison tightest
        ("time_s - 1 - 1 == 0", True),  # from the left
        ("time_s / 2 / 2 == 0.5", True),
        ("1 + 2 * time_s == 5", True),
        ("-time_s < - - 1", True),
        ("abs(1 - time_s) == 1", True),
    ],
)
def test_what_binds_tighter(text: str, truth: bool) -> None:
    known = {"time_s": 2.0, "latched": 0.0, "sensed.latched": 0.0, "Msg.A": 0.0, "Other.B": 0.0}
    truths, _, _ = evaluated(text, [known])
    assert truths[0] == truth


def test_the_margin_has_the_unit_of_the_comparison_that_decides() -> None:
    text = "gate_angle_deg > 20 and left_current_a < 5"
    condition = parsed(text, {})
    assert condition.units == ("deg", "A")
    table, work = table_of([condition], ()), work_for(2)
    rows = np.zeros((2, ROW_WIDTH))
    rows[:, COLUMN_PLACE["gate_angle_deg"]] = 21.0, 90.0
    evaluate(table, 0, rows, np.zeros((2, 0)), 2, work)
    assert work.numbers[0].tolist() == [1.0, 5.0]
    assert [condition.units[each] for each in work.deciders[0]] == ["deg", "A"]


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
def test_units_of_products(text: str, unit: str) -> None:
    assert parsed(text, {}).units == (unit,)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the end; allowed: a column"),
        ("gate_angle_deg", "compares nothing"),
        ("gate_angle_deg >", "the end; allowed"),
        ("1 < gate_angle_deg < 3", "one comparison at a time"),
        ("gate_angle_deg > 3 )", ") at character 20; allowed: and, or, or the end"),
        ("(gate_angle_deg > 3", "the end; allowed: )"),
        ("gate_angle_deg + left_current_a > 3", "takes deg and A together"),
        ("gate_angle_deg > left_current_a", "takes deg and A together"),
        ("gate_angle > 3", "no such column; allowed: gate_angle_deg"),
        ("sensed.gate_angel_deg > 3", "no such column; allowed: sensed.gate_angle_deg"),
        ("sensed_gate_angle_deg > 3", "no such column"),
        ("$limit > 3", "$limit: no such parameter; allowed: $p, $q"),
        ("gate_angle_deg & 3", "'&' at character 16"),
        ("gate_angle_deg > 1e999", "1e999; allowed: a finite number"),
        ("not gate_angle_deg", "a number beside `not`"),
        ("gate_angle_deg and time_s > 1", "a number beside `and`"),
        ("(time_s > 1) > 2", "a comparison where a number is meant"),
        ("abs(time_s > 1) > 2", "a comparison where a number is meant"),
        ("a.b.c > 1", "'.' at character 4"),
        ("abs > 1", "abs at character 1"),
        ("(" * (DEEPEST + 1) + "time_s > 1" + ")" * (DEEPEST + 1), "parentheses deeper than"),
        ("time_s > 1 and " * 400 + "time_s > 1", "characters; allowed"),
        ("__import__(x)", "no such column"),
    ],
)
def test_what_is_wrong_is_told(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=r"allowed|meant") as caught:
        parsed(text, PARAMETERS)
    assert said in str(caught.value)


@CALM
@given(st.text(alphabet="abs()andornt $p.<>=!+-*/01e_gM\n\té", max_size=40))
def test_any_text_is_a_condition_or_a_clear_mistake(text: str) -> None:
    with contextlib.suppress(ValueError):
        parsed(text, PARAMETERS)


def test_signals_are_looked_up_where_there_is_a_database() -> None:
    units = {"Msg.A": "A"}
    assert parsed("Msg.A > left_current_a", {}, units.get).names(SIGNAL) == ["Msg.A"]
    with pytest.raises(ValueError, match="no such signal"):
        parsed("Msg.B > 1", {}, units.get)
