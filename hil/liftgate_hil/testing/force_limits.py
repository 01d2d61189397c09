"""Force limits in the expectations of a suite, and the rules that have the same value."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from liftgate_hil.conditions.parser import parsed
from liftgate_hil.judging.comparisons import comparisons_of
from liftgate_hil.report.page import section, table, text
from liftgate_hil.report.pinch import BORROWED, ORIGINS, OWN_LIMIT
from liftgate_hil.testing.suite import Outcome

_FORCES = ("pinch_force_n", "pinch_force_peak_n")
_TIMED = "pinch_over_limit_s"  # s over the vehicle's [gate] pinch_limit
_ON_BUS = ("pinch_force", "pinch_force_max", "pinch_force_peak")
_UPPER = {"always": ("<", "<="), "never": (">", ">=")}  # comparisons that limit a force from above, by their kind
_MOST_USERS = 4  # expectations that are named


def limits_section(outcomes: Sequence[Outcome]) -> str:
    """Return the report's section on limits of pinch forces; empty where there are none."""
    users: dict[float, list[str]] = {}
    for outcome in outcomes:
        for force, name in _limits_of(outcome):
            users.setdefault(force, []).append(f"{outcome.case.file}: {name}")
    rows = [(f"{force:g} N", ORIGINS.get(force, OWN_LIMIT), _named(users[force])) for force in sorted(users)]
    if not rows:
        return ""
    return section(
        "Force limits",
        f"<p>{text(BORROWED)} An expectation on the force alone checks neither how long it lasts nor the other "
        "limits of that rule.</p>",
        table(("limit", "value also found in", "used by"), rows, ("n", "", "name")),
    )


def _limits_of(outcome: Outcome) -> Iterable[tuple[float, str]]:
    """Yield (limit [N], name of the expectation) for each upper limit of a pinch force."""
    plan = outcome.case.plan
    rig, scenario = plan.rig, plan.setup.scenario
    on_bus = {f"{wire.message}.{wire.signal}" for wire in rig.outputs if wire.quantity in _ON_BUS}
    for each in scenario.expectations:
        if each.kind == "dtc":
            continue
        condition = parsed(each.condition, scenario.parameters, rig.messages)
        for comparison in comparisons_of(condition):
            limit = comparison.limit
            if _TIMED in (*comparison.left.names(), *comparison.right.names()):
                yield plan.setup.vehicle.gate.pinch_limit, f"{each.name} (time over it)"
            if limit is None or limit[0].unit != "N":
                continue
            if set(limit[0].names()) & {*_FORCES, *on_bus} and limit[1] in _UPPER.get(each.kind, ()):
                yield limit[2], each.name


def _named(users: Sequence[str]) -> str:
    found = list(dict.fromkeys(users))
    rest = len(found) - _MOST_USERS
    return ", ".join(found[:_MOST_USERS]) + (f" and {rest} more" if rest > 0 else "")
