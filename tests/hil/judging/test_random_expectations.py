"""Random expectations, compared with an evaluation that keeps every row and counts in ticks."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from formulas import VALUES, Made, binary, compared, joined, negated
from hil_support import CALM
from hypothesis import given, settings
from hypothesis import strategies as st

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.judging.expected import expected_of
from liftgate_hil.judging.judge import Judge
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH

STEP = 0.7e-3  # s: no tick has a time that is a binary fraction, and many a sum of two is none
COLUMNS = {"latched": "latched", "sensed.latched": "sensed_latched"}
LATCHED = ("latched", lambda known: known["latched"])
SENSED = ("sensed.latched", lambda known: known["sensed.latched"])
ZERO, HALF = ("0", lambda known: 0.0), ("0.5", lambda known: 0.5)
# Often true and often false, so that stretches begin and end; nested, with what has no value at times.
PLAIN = [
    compared(">", LATCHED, ZERO),
    negated(compared("<=", SENSED, HALF)),
    joined("or", compared(">", LATCHED, ZERO), compared(">=", SENSED, HALF)),
    negated(joined("and", compared("<", LATCHED, HALF), negated(compared("==", SENSED, ZERO)))),
]
NUMBERS = st.one_of(
    st.sampled_from([LATCHED, SENSED, ZERO, HALF]),
    st.builds(binary, st.sampled_from("+-*/"), st.just(LATCHED), st.just(SENSED)),
)
COMPARED = st.builds(compared, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), NUMBERS, NUMBERS)
NESTED = st.builds(
    joined,
    st.sampled_from(["and", "or"]),
    st.one_of(COMPARED, COMPARED.map(negated)),
    st.builds(joined, st.sampled_from(["and", "or"]), COMPARED, COMPARED).map(negated),
)
CONDITIONS = st.one_of(st.sampled_from(PLAIN), COMPARED, NESTED)


class Own(NamedTuple):
    """An expectation with its times counted in ticks."""

    kind: str
    condition: Made
    after: int | Made
    within: int | None
    hold: int


OWN = st.builds(
    Own,
    st.sampled_from(["always", "eventually", "never"]),
    CONDITIONS,
    st.one_of(st.integers(0, 12), CONDITIONS),
    st.one_of(st.none(), st.integers(0, 25)),
    st.integers(0, 6),
).map(lambda own: own if own.kind == "eventually" else own._replace(hold=0))
CELLS = st.one_of(st.sampled_from([0.0, 1.0, -1.0]), VALUES)


def by_hand(own: Own, known: list[dict[str, float]], end: int) -> tuple[str, float | None]:
    """Verdict and margin evaluated tick by tick; `known[0]` is tick 1."""
    begin: int | None
    if isinstance(own.after, int):
        begin = own.after
    else:
        opened = [k for k, each in enumerate(known, 1) if own.after[1](each)[0]]
        begin = opened[0] if opened and opened[0] <= end else None
    if begin is None:
        return "inconclusive", None
    until = math.inf if own.within is None else begin + own.within
    ticks = [k for k in range(begin, end + 1) if 1 <= k <= until and k <= len(known)]
    told = {k: own.condition[1](known[k - 1]) for k in ticks}
    if own.kind == "never":
        told = {k: (not truth and not math.isnan(margin), -margin) for k, (truth, margin) in told.items()}
    there = {k: each for k, each in told.items() if not math.isnan(each[1])}
    stretches = [
        [there[j] for j in range(max(k - own.hold, 1), k + 1)]  # of tick 0 nothing is known
        for k in ticks
        if k - own.hold >= begin and all(j in there for j in range(max(k - own.hold, 1), k + 1))
    ]
    margins = [min(margin for _, margin in each) for each in stretches]
    holds = [all(truth for truth, _ in each) for each in stretches]
    is_decided = any(holds) if own.kind == "eventually" else not all(holds)
    is_cut = until > end and own.within is not None
    if not is_decided and (is_cut or not margins):
        return "inconclusive", None
    passes = is_decided == (own.kind == "eventually")
    margin = max(margins) if own.kind == "eventually" else min(margins)
    return "pass" if passes else "fail", margin


@settings(CALM, max_examples=200)
@given(
    st.lists(OWN, min_size=1, max_size=3),
    st.lists(st.lists(CELLS, min_size=2, max_size=2), min_size=1, max_size=30),
    st.integers(0, 3),
    st.lists(st.integers(1, 29), max_size=3),
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_random_expectations_are_judged_as_by_tick_by_tick_evaluation(
    owns: list[Own], values: list[list[float]], beyond: int, cuts: list[int]
) -> None:
    known = [dict(zip(COLUMNS, each, strict=True)) for each in values]
    end = max(len(known) - beyond, 1)
    expectations = [
        Expectation(
            str(place),
            own.kind,
            own.condition[0],
            own.after[0] if isinstance(own.after, tuple) else own.after * STEP,
            math.inf if own.within is None else own.within * STEP,
            own.hold * STEP,
            f"expect[{place}]",
        )
        for place, own in enumerate(owns)
    ]
    rows = np.full((len(known), ROW_WIDTH), np.nan)
    for row, each in zip(rows, known, strict=True):
        for name, column in COLUMNS.items():
            row[COLUMN_PLACE[column]] = each[name]
    rows[:, COLUMN_PLACE["time_s"]] = STEP * np.arange(1, len(known) + 1)
    judge = Judge(expected_of(expectations, {}, {}, 2, "file"), 1.0 / STEP, end * STEP)
    for part in np.split(rows, sorted({cut for cut in cuts if cut < len(rows)})):
        judge.take(part, no_logged())
    for own, found in zip(owns, judge.verdicts(), strict=True):
        verdict, margin = by_hand(own, known, end)
        assert found.verdict == verdict, own
        np.testing.assert_equal(_plain(found.margin), _plain(margin))


def _plain(margin: float | None) -> Any:
    return None if margin is None else margin + 0.0  # no negative zero


@pytest.mark.parametrize("step", [1e-3, 0.7e-3, 1e-4, 0.1])
def test_ends_of_windows_and_hold_times_are_ticks_despite_rounding_of_time_sums(step: float) -> None:
    ticks = np.arange(1, 40)
    rows = np.zeros((len(ticks), ROW_WIDTH))
    rows[:, COLUMN_PLACE["time_s"]] = ticks * step
    rows[:, COLUMN_PLACE["gate_angle_deg"]] = ticks
    expectations = []
    for after in range(1, 13):
        for within in range(26):
            window = after * step, within * step
            last = after + within
            for kind, condition, hold in (
                ("eventually", f"gate_angle_deg == {after}", 0),
                ("eventually", f"gate_angle_deg == {last}", 0),
                ("never", f"gate_angle_deg == {after - 1} or gate_angle_deg == {last + 1}", 0),
                ("eventually", f"gate_angle_deg >= {after} and gate_angle_deg <= {last}", within),
            ):
                name = f"{kind} {condition} for {hold}"
                own = Expectation(name, kind, condition, *window, hold * step, name)
                expectations.append(own)
    judge = Judge(expected_of(expectations, {}, {}, 2, "file"), 1.0 / step, 39 * step)
    judge.take(rows, no_logged())
    assert [each for each in judge.verdicts() if each.verdict != "pass"] == []
