"""Reasons of failed expectations: the measured value, the allowed value, the time."""

from __future__ import annotations

import math
import operator
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from formulas import Made, compared, joined, negated
from hil_support import CALM, shipped_rig
from hypothesis import given
from hypothesis import strategies as st

import liftgate_hil as lh
from liftgate_hil.codec.frames import no_logged
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.judging.expected import expected_of
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.verdict import Verdict
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH

RATE = 100.0


def failed(expectation: Expectation, blocks: int = 1, **columns: list[float]) -> Verdict:
    """The verdict on rows with these columns, one per tick from 0.01 s on, taken in this number of blocks."""
    count = len(next(iter(columns.values())))
    rows = np.zeros((count, ROW_WIDTH))
    rows[:, COLUMN_PLACE["time_s"]] = np.arange(1, count + 1) / RATE
    for name, values in columns.items():
        rows[:, COLUMN_PLACE[name]] = values
    expected = expected_of([expectation], {"limit": 150.0}, shipped_rig().messages, 2, "file")
    judge = Judge(expected, RATE, count / RATE)
    for part in np.array_split(rows, blocks):
        judge.take(part, no_logged())
    (verdict,) = judge.verdicts()
    return verdict


FORCE = [0.0, 120.0, 152.5, 171.3, 40.0]
ANGLE = [10.0, 20.0, 30.0, 40.0, 50.0]
# The expectation, the columns, why it fails.
FAILURES: list[tuple[tuple[Any, ...], dict[str, list[float]], str]] = [
    (
        ("always", "pinch_force_n < $limit"), {"pinch_force_n": FORCE},
        "pinch_force_n: 171.3 N, allowed below 150 N, at 0.04 s, first violated at 0.03 s",
    ),
    (
        ("always", "150 > pinch_force_n"), {"pinch_force_n": [0.0, 150.004]},
        "pinch_force_n: 150.004 N, allowed below 150 N, at 0.02 s",
    ),
    (
        ("never", "pinch_force_n >= 150"), {"pinch_force_n": [0.0, 150.0]},
        "pinch_force_n: 150 N, allowed below 150 N, at 0.02 s",
    ),
    (
        ("always", "not (gate_angle_deg > 45 or pinch_force_n >= 170)"),
        {"pinch_force_n": FORCE, "gate_angle_deg": ANGLE},
        "gate_angle_deg: 50 deg, allowed at most 45 deg, at 0.05 s, first violated at 0.04 s",
    ),
    (
        ("never", "latched == 1"), {"latched": [0.0, 1.0]},
        "latched: 1, allowed other than 1, at 0.02 s",
    ),
    (
        ("always", "pinch_force_n == 100"), {"pinch_force_n": [100.0, 100.5]},
        "pinch_force_n: differs by 0.5 N from 100 N, the only value allowed, at 0.02 s",
    ),
    (
        ("always", "latched == 1"), {"latched": [1.0, 0.0]},
        "latched: 0, allowed exactly 1, at 0.02 s",
    ),
    (
        ("never", "latched != 0"), {"latched": [0.0, 1.0]},
        "latched: 1, allowed exactly 0, at 0.02 s",
    ),
    (
        ("always", "left_current_a >= right_current_a - 1"),
        {"left_current_a": [1.0, 2.0], "right_current_a": [2.0, 5.25]},
        "left_current_a - (right_current_a - 1): -2.25 A, allowed at least 0 A, at 0.02 s",
    ),
    (
        ("eventually", "gate_angle_deg > 42"), {"gate_angle_deg": ANGLE[:4]},
        "gate_angle_deg > 42: not true from 0 s to 0.04 s; closest: gate_angle_deg: 40 deg, allowed above 42 deg, "
        "at 0.04 s",
    ),
    (
        ("eventually", "gate_angle_deg > 42", 0.01, 0.02), {"gate_angle_deg": ANGLE},
        "gate_angle_deg > 42: true only at 0.05 s, allowed until 0.03 s; closest until then: "
        "gate_angle_deg: 30 deg, allowed above 42 deg, at 0.03 s",
    ),
    (
        ("eventually", "gate_angle_deg > 25", 0.01, 0.03, 0.02), {"gate_angle_deg": ANGLE},
        "gate_angle_deg > 25 for 0.02 s: true only at 0.05 s, allowed until 0.04 s; closest until then: "
        "gate_angle_deg: 20 deg, allowed above 25 deg, at 0.04 s",
    ),
    (
        ("eventually", "abs(gate_angle_deg) < $limit and not pinch_force_n < 500", 0.02, 0.01),
        {"pinch_force_n": FORCE, "gate_angle_deg": ANGLE},
        "abs(gate_angle_deg) < 150 and not pinch_force_n < 500: not true from 0.02 s to 0.03 s; closest: "
        "pinch_force_n: 152.5 N, allowed at least 500 N, at 0.03 s",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("given_as", "columns", "reason"), FAILURES)
@pytest.mark.parametrize("blocks", [1, 2, 5])
def test_a_failure_states_the_measured_value_the_allowed_value_and_the_time(
    given_as: tuple[Any, ...], columns: dict[str, list[float]], reason: str, blocks: int
) -> None:
    found = failed(Expectation("x", *given_as), blocks, **columns)
    assert (found.verdict, found.reason) == ("fail", reason)


def test_a_condition_true_for_less_than_its_hold_time_is_not_reported_as_late() -> None:
    """A hold time counts where it is complete, and not over a tick without a value."""
    each = Expectation("x", "eventually", "gate_angle_deg > 25", 0.0, 0.02, 0.02)
    assert "not true from" in failed(each, gate_angle_deg=[0.0, 0.0, 30.0, 30.0]).reason
    holes = [0.0, 0.0, 30.0, math.nan, 30.0, 30.0]
    assert "not true from" in failed(each, gate_angle_deg=holes).reason
    assert "true only at 0.07 s" in failed(each, gate_angle_deg=[*holes, 30.0]).reason


def test_a_passed_expectation_has_no_reason() -> None:
    assert failed(Expectation("x", "always", "time_s > 0"), time_s=[0.01]).reason == ""


SIDES = st.sampled_from(
    [
        ("latched", lambda known: known["latched"]),
        ("sensed.latched", lambda known: known["sensed.latched"]),
        ("0", lambda known: 0.0),
        ("-0.5", lambda known: -0.5),
    ]
)
COMPARED = st.builds(compared, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), SIDES, SIDES)
CONDITIONS = st.recursive(
    COMPARED,
    lambda inner: st.one_of(inner.map(negated), st.builds(joined, st.sampled_from(["and", "or"]), inner, inner)),
    max_leaves=4,
)
TOLD = re.compile(r".*: (\S+), allowed (below|at most|above|at least|other than) (\S+), at \S+ s.*")
ALLOWED = {
    "below": operator.lt, "at most": operator.le, "above": operator.gt, "at least": operator.ge,
    "other than": operator.ne,
}  # fmt: skip


@CALM
@given(
    st.sampled_from(["always", "never", "eventually"]),
    CONDITIONS,
    st.lists(st.lists(st.sampled_from([0.0, 1.0, -0.5, 2.25]), min_size=2, max_size=2), min_size=1),
)
def test_a_reason_names_a_value_outside_the_allowed_set(kind: str, made: Made, values: list[list[float]]) -> None:
    truth, sensed = (list(each) for each in zip(*values, strict=True))
    found = failed(Expectation("x", kind, made[0]), latched=truth, sensed_latched=sensed)
    assert (found.reason == "") == (found.verdict == "pass")
    if found.verdict == "pass" or "the only value allowed" in found.reason:
        return
    told = TOLD.fullmatch(found.reason)
    assert told is not None, found.reason
    assert not ALLOWED[told[2]](float(told[1]), float(told[3]))


def test_a_failed_result_has_a_reason_for_each_failed_expectation(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    late = 'after = "time_s > 9"'
    path.write_text(
        'duration = 0.1\n[[expect]]\nname = "a"\nalways = "time_s < 0.05"\n[[expect]]\nname = "b"\n'
        f'never = "latched == 1"\n[[expect]]\nname = "c"\nalways = "latched == 1"\n[[expect]]\nname = "d"\n'
        f'always = "latched == 1"\n{late}\n'
    )
    result = lh.run(path)
    assert result.verdict == "fail"
    assert result.reason == (
        "a: time_s: 0.1 s, allowed below 0.05 s, at 0.1 s, first violated at 0.05 s; "
        "b: latched: 1, allowed other than 1, at 0.001 s"
    )
    path.write_text('duration = 0.1\n[[expect]]\nname = "c"\nalways = "latched == 1"\n')
    assert lh.run(path).reason == ""
