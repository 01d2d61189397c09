"""Expectations with parsed conditions, validated against a rig and a gate, and as tables for the judge."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from liftgate_hil.codec.watch import watched
from liftgate_hil.conditions.condition import COLUMN, CONST, EQ, NOT, SIGNAL, Condition
from liftgate_hil.conditions.evaluator import Work, table_of, work_for
from liftgate_hil.conditions.parser import parsed
from liftgate_hil.diagnostics import services
from liftgate_hil.diagnostics.answers import MOST_CODES
from liftgate_hil.diagnostics.tester import Diagnostics
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.judging.expectation import PRESENT, Expectation
from liftgate_hil.judging.stimulus_times import TimedFault
from liftgate_hil.judging.table import (
    ALWAYS,
    BLOCK,
    EVENTUALLY,
    EXPECTATION,
    PROGRESS,
    STRETCH,
    Expectations,
    Judged,
)
from liftgate_hil.stimuli.moments import Instant

if TYPE_CHECKING:
    from liftgate_hil.codec.messages import Messages


FIRST_S = 0.1  # s, before which a row shows where a scenario begins: a gate of 20 deg/s has moved by 2 deg
_NEAR_DEG = 2.0  # from the end of its travel, where a motion counts as complete: a gate sags below its open stop


class PreconditionEnd(NamedTuple):
    """Last request of a scenario's precondition, `open` or `close`, and the final gate angle [deg]."""

    action: str
    angle_deg: float


@dataclass(frozen=True)
class Expected:
    """Expectations with parsed conditions, validated against a rig's database and a gate's drives."""

    expectations: tuple[Expectation, ...]
    conditions: tuple[Condition, ...]  # each expectation's own, then the existing openers
    openers: tuple[int, ...]  # index of the condition that opens each window; -1: a time
    signals: tuple[str, ...]  # bus signals that they refer to
    messages: Messages
    awaited: int = 0  # this many at the end are conditions that stimuli wait for
    codes: tuple[str, ...] = ()  # trouble codes that they refer to
    diagnostics: Diagnostics | None = None  # how the ECU is asked for trouble codes
    faults: tuple[TimedFault, ...] = ()  # of the scenario
    begins: tuple[tuple[str, Instant], ...] = ()  # what each of its stimuli is, and when it begins
    precondition_end: PreconditionEnd | None = None

    def not_completed(self, angle_deg: float) -> str:
        """Return as text why the precondition was not completed; "": it was, or the angle is NaN.

        `angle_deg` is the gate angle when the scenario began; NaN: unknown, taken as completed.
        """
        end = self.precondition_end
        if end is None or not abs(angle_deg - end.angle_deg) > _NEAR_DEG:
            return ""
        return (
            f"precondition: {end.action}: the gate came to rest at {angle_deg:.1f}°, not at {end.angle_deg:.1f}°"
        )

    def notes_on_begin(self, angle_deg: float) -> list[str]:
        """Return one note, in a list, if the precondition was not completed or the angle is NaN; else []."""
        if self.precondition_end is not None and math.isnan(angle_deg):
            action = self.precondition_end.action
            return [f"precondition: {action}: no gate angle before {FIRST_S:g} s says whether it was completed"]
        unmet = self.not_completed(angle_deg)
        return [f"{unmet}: the scenario begins there"] if unmet else []

    def margin_unit(self, place: int) -> str:
        """Return the unit of an expectation's margin; "": none, or its comparisons have different ones."""
        units = {*self.conditions[place].units}
        return units.pop() if len(units) == 1 else ""

    def names(self, place: int) -> list[str]:
        """Return the columns and signals in an expectation and its opening condition, each once."""
        opener = self.openers[place]
        those = [self.conditions[place], *([self.conditions[opener]] if opener >= 0 else [])]
        found = [name for each in those for kind in (COLUMN, SIGNAL) for name in each.names(kind)]
        return list(dict.fromkeys(found))


def expected_of(
    expectations: Sequence[Expectation],
    parameters: Mapping[str, float],
    messages: Messages,
    drives: int,
    source: str,
    awaited: Sequence[Expectation] = (),
    diagnostics: Diagnostics | None = None,
    faults: Sequence[TimedFault] = (),
    begins: Iterable[tuple[str, Instant]] = (),
    precondition_end: PreconditionEnd | None = None,
) -> Expected:
    """Return expectations with their conditions parsed and validated against a database and a gate.

    `parameters` are those of the scenario, `messages` the database's by name, `drives` is the gate's number of
    drives, `source` the file that issues name. `awaited` are conditions that stimuli wait for, as expectations: if
    one never comes, nothing passes. `diagnostics` is how the ECU is asked for trouble codes; None: it cannot be.
    `faults` are the scenario's, `begins` what each stimulus is and when it begins, `precondition_end` is where
    its precondition ends. Raises ConfigError with all issues.
    """
    expectations = [*expectations, *awaited]
    issues = ConfigIssues(source)

    def condition_of(of: Expectation, key: str, text: str, is_never: bool = False) -> Condition | None:
        try:
            made = parsed(text, parameters, messages)
        except ValueError as error:
            issues.add_of(of.source, key, str(error))
            return None
        for reason in made.beyond(drives):
            issues.add_of(of.source, key, reason)
        return Condition(text, (*made.ops, (NOT, 0.0)), made.units) if is_never else made

    own: list[Condition | None] = []
    openers, judged = [], len(expectations) - len(awaited)
    codes = codes_of(expectations, diagnostics, issues)
    for place, each in enumerate(expectations):
        is_own = place < judged
        key = f"{each.key}.{each.kind}" if is_own else each.key
        if each.kind == "dtc":
            own.append(_reported(each))
        else:
            own.append(condition_of(each, key, each.condition, each.kind == "never"))
        if isinstance(each.after, str):
            key = f"{each.key}.after" if is_own else each.key
            openers.append(condition_of(each, key, each.after))
    issues.raise_if_any()
    conditions = [each for each in (*own, *openers) if each is not None]
    is_opened = [isinstance(each.after, str) for each in expectations]
    places = itertools.count(len(expectations))  # of the openers, which follow the conditions
    opener_of = tuple(next(places) if opened else -1 for opened in is_opened)
    names = dict.fromkeys(name for each in conditions for name in each.names(SIGNAL))
    signals = tuple(name for name in names if name not in codes)
    watched(messages, signals, issues)
    issues.raise_if_any()
    found = tuple(each.with_numbers(parameters) for each in expectations), tuple(conditions), opener_of
    asked = diagnostics if codes else None
    return Expected(
        *found, signals, messages, len(awaited), codes, asked, tuple(faults), tuple(begins), precondition_end
    )


def codes_of(
    expectations: Sequence[Expectation], diagnostics: Diagnostics | None, issues: ConfigIssues
) -> tuple[str, ...]:
    """Return the trouble codes that expectations refer to; append to `issues` why the bench cannot read them."""
    asking = [each for each in expectations if each.kind == "dtc"]
    codes = tuple(dict.fromkeys(each.condition for each in asking))
    if not asking:
        return ()
    key, source = f"{asking[0].key}.dtc", asking[0].source
    if diagnostics is None:
        text = "the rig has no [diagnostics]; allowed: a rig with [diagnostics] request and response"
        issues.add_of(source, key, f"{asking[0].condition}: {text}")
    if not services.is_there():
        issues.add_of(source, key, f"{asking[0].condition}: trouble codes {services.MISSING}")
    if len(codes) > MOST_CODES:
        issues.add_of(source, key, f"{len(codes)} different codes; allowed: up to {MOST_CODES}")
    return codes


def _reported(expectation: Expectation) -> Condition:
    """Return the condition of an expectation on a trouble code: that the ECU reports it, or that it does not.

    The code's value is 1 in a tick with a response that reports it, 0 in one with another response, none in all
    others.
    """
    code = expectation.condition
    ops = ((SIGNAL, code), (CONST, 1.0), (EQ, 0.0))
    return Condition(code, ops if expectation.state == PRESENT else (*ops, (NOT, 0.0)), ("",))


def tables_of(
    expected: Expected, rate: float, end: float, work: Work | None = None
) -> tuple[Expectations, Judged]:
    """Return a judge's initial tables for rows at a `rate` [Hz] up to `end` [s]; see Judge.

    `work` is memory that other judges may use too, between their blocks.
    """
    count = len(expected.expectations)
    rows = np.zeros(count, dtype=EXPECTATION)
    progress = np.zeros(count, dtype=PROGRESS)
    room = 0
    for place, (row, each) in enumerate(zip(rows, expected.expectations, strict=True)):
        stretches = math.ceil(min(each.hold, end) * rate) + 2
        row["kind"] = ALWAYS if each.is_always else EVENTUALLY
        row["condition"], row["opener"] = place, expected.openers[place]
        row["after"] = math.nan if isinstance(each.after, str) else each.after
        row["within"], row["hold"] = each.within, each.hold
        row["stretch_first"], row["stretch_count"] = room, stretches
        room += stretches if each.hold else 0
    for name in ("begin", "end", "decided_at", "margin", "margin_at", "since", "false_at", "late_at"):
        progress[name] = math.nan
    issues = ConfigIssues("")
    tables = Expectations(
        rows.view(np.recarray),
        table_of(expected.conditions, (*expected.signals, *expected.codes)),
        watched(expected.messages, expected.signals, issues),
        len(expected.codes),
        1.0 / rate,
    )
    signals = len(expected.signals) + len(expected.codes)
    judged = Judged(
        progress.view(np.recarray),
        np.zeros(room, dtype=STRETCH).view(np.recarray),
        np.full(signals, math.nan),
        np.full((BLOCK, signals), math.nan),
        work or work_for(BLOCK),
    )
    return tables, judged
