"""Evaluation of conditions, against an independent evaluation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from formulas import COLUMNS, FORMULAS, PARAMETERS, SIGNALS, VALUES, Made
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st

from liftgate_compiler import compiled
from liftgate_hil.conditions.evaluator import evaluate, table_of, work_for
from liftgate_hil.conditions.parser import parsed
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH


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
def test_random_conditions_have_the_truth_and_margin_of_an_independent_evaluation(
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
def test_operators_have_their_documented_precedence(text: str, truth: bool) -> None:
    known = {"time_s": 2.0, "latched": 0.0, "sensed.latched": 0.0, "Msg.A": 0.0, "Other.B": 0.0}
    truths, _, _ = evaluated(text, [known])
    assert truths[0] == truth


@pytest.mark.parametrize(
    ("text", "decides"),
    [
        ("time_s < 2 and time_s <= 2", 0),  # at the same margin of 0 the one that is false decides `and`
        ("time_s <= 2 and time_s < 2", 1),
        ("time_s < 2 or time_s <= 2", 1),  # and the one that is true `or`
        ("time_s <= 2 or time_s < 2", 0),
        ("time_s <= 2 and 2 >= time_s", 0),  # of two that are alike the first one
    ],
)
def test_of_comparisons_with_equal_margins_the_one_that_sets_the_truth_decides(text: str, decides: int) -> None:
    known = {"time_s": 2.0, "latched": 0.0, "sensed.latched": 0.0, "Msg.A": 0.0, "Other.B": 0.0}
    for call in (evaluate, compiled(evaluate)):
        _, margins, deciders = evaluated(text, [known], call)
        assert margins[0] == 0.0
        assert deciders[0] == decides


def test_the_margin_has_the_unit_of_the_deciding_comparison() -> None:
    text = "gate_angle_deg > 20 and left_current_a < 5"
    condition = parsed(text, {})
    assert condition.units == ("deg", "A")
    table, work = table_of([condition], ()), work_for(2)
    rows = np.zeros((2, ROW_WIDTH))
    rows[:, COLUMN_PLACE["gate_angle_deg"]] = 21.0, 90.0
    evaluate(table, 0, rows, np.zeros((2, 0)), 2, work)
    assert work.numbers[0].tolist() == [1.0, 5.0]
    assert [condition.units[each] for each in work.deciders[0]] == ["deg", "A"]
