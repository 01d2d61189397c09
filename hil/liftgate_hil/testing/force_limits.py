"""Force limits in the expectations of a suite, and the rules that have the same value."""

from __future__ import annotations

from collections.abc import Sequence

from liftgate_hil.plan.force_limits import force_limits_of
from liftgate_hil.report.page import section, table, text
from liftgate_hil.report.pinch import BORROWED, ORIGINS, OWN_LIMIT
from liftgate_hil.testing.outcome import Outcome

_MOST_USERS = 4  # expectations that are named


def limits_section(outcomes: Sequence[Outcome]) -> str:
    """Return the report's section on limits of pinch forces; empty where there are none."""
    users: dict[float, list[str]] = {}
    for outcome in outcomes:
        plan = outcome.case.plan
        for limit in force_limits_of(plan.setup.scenario, plan.setup.vehicle, plan.rig):
            name = limit.expectation if limit.longest_s == 0.0 else f"{limit.expectation} (time over it)"
            users.setdefault(limit.force_n, []).append(f"{outcome.case.file}: {name}")
    rows = [(f"{force:g} N", ORIGINS.get(force, OWN_LIMIT), _named(users[force])) for force in sorted(users)]
    if not rows:
        return ""
    return section(
        "Force limits",
        f"<p>{text(BORROWED)} An expectation on the force alone checks neither how long it lasts nor the other "
        "limits of that rule.</p>",
        table(("limit", "the same value appears in", "used by"), rows, ("n", "", "name")),
    )


def _named(users: Sequence[str]) -> str:
    found = list(dict.fromkeys(users))
    rest = len(found) - _MOST_USERS
    return ", ".join(found[:_MOST_USERS]) + (f" and {rest} more" if rest > 0 else "")
