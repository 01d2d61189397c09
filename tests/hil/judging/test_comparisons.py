"""Conditions split into comparisons: their texts, limits and values are those of the condition."""

from __future__ import annotations

import numpy as np
import pytest
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.conditions.parser import parsed
from liftgate_hil.judging.comparisons import comparisons_of, sides_of

READ = {"gate_angle_deg": np.array([3.0, -1.0]), "gate_rate_degps": np.array([0.5, np.nan])}
SUMS = st.recursive(
    st.sampled_from(["gate_angle_deg", "gate_rate_degps", "2", "0.125", "$rod"]),
    lambda part: st.one_of(
        st.tuples(part, st.sampled_from("*/"), part).map(lambda it: f"({it[0]}) {it[1]} ({it[2]})"),
        st.tuples(part, part).map(lambda it: f"({it[0]}) * 2 - 3 * ({it[0]})"),
        part.map(lambda it: f"-({it})"),
        part.map(lambda it: f"abs({it})"),
    ),
    max_leaves=6,
)


@CALM
@given(SUMS, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]))
def test_the_text_of_a_comparison_parses_to_the_same_comparison(side: str, sign: str) -> None:
    condition = parsed(f"not ({side} {sign} 1)", {"rod": 7.5})
    (comparison,) = comparisons_of(condition)
    (again,) = comparisons_of(parsed(comparison.text, {}))
    assert again.text == comparison.text
    assert again.sign == comparison.sign
    first, second = (
        each.left.values({name: READ[name] for name in each.left.names()}, 2) for each in (comparison, again)
    )
    assert np.array_equal(first, second, equal_nan=True)


def test_the_sides_of_a_comparison_are_calculated_as_written() -> None:
    (comparison,) = comparisons_of(
        parsed("2 * (gate_angle_deg - $x) / abs(-4) > gate_angle_deg - 1 - 1", {"x": 1.0})
    )
    assert comparison.left.text == "2 * (gate_angle_deg - 1) / abs(-4)"
    assert comparison.left.values(READ, 2).tolist() == [1.0, -1.0]
    assert comparison.right.text == "gate_angle_deg - 1 - 1"
    assert comparison.right.values(READ, 2).tolist() == [1.0, -3.0]
    assert comparison.limit is None


@pytest.mark.parametrize(
    "side",
    [
        "gate_angle_deg - (1 - 2)",
        "gate_angle_deg / (2 / (4 * 8))",
        "gate_angle_deg - (gate_angle_deg + 1)",
        "-(-gate_angle_deg)",
        "2 * -(gate_angle_deg + 1)",
    ],
)
def test_needed_parentheses_are_kept_in_the_text_of_a_comparison(side: str) -> None:
    (comparison,) = comparisons_of(parsed(f"{side} > 0", {}))
    assert comparison.left.text == side


def test_a_side_without_a_finite_value_is_nan() -> None:
    (comparison,) = comparisons_of(parsed("gate_rate_degps / (gate_angle_deg - 3) > 0", {}))
    assert np.isnan(comparison.left.values(READ, 2)).all()


@pytest.mark.parametrize(
    ("text", "limit"),
    [
        ("pinch_force_n < $most", ("pinch_force_n", "<", 100.0)),
        ("20 + 5 >= gate_angle_deg", ("gate_angle_deg", "<=", 25.0)),
        ("0 == latched", ("latched", "==", 0.0)),
        ("sensed.left_current_a < left_current_a", None),
        ("1 < 2", None),
        ("latched < 1 / 0", None),
    ],
)
def test_the_limit_of_a_comparison_is_its_constant_side(text: str, limit: tuple[str, str, float] | None) -> None:
    (comparison,) = comparisons_of(parsed(text, {"most": 100.0}))
    found = comparison.limit
    assert (None if found is None else (found[0].text, *found[1:])) == limit


def test_comparisons_and_units_of_a_condition_have_the_same_order() -> None:
    condition = parsed("gate_angle_deg > 1 or not (left_current_a < 2 and Gate.Angle == 1)", {})
    found = comparisons_of(condition)
    assert [each.text for each in found] == [
        "gate_angle_deg > 1", "left_current_a < 2", "Gate.Angle == 1",
    ]  # fmt: skip
    assert [each.left.unit for each in found] == list(condition.units)
    assert [side.text for side in sides_of(found)] == [
        "gate_angle_deg", "left_current_a", "Gate.Angle",
    ]  # fmt: skip
