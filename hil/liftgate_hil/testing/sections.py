"""Sections of a test report: mutants that scenarios find, and force limits in expectations."""

from __future__ import annotations

from collections.abc import Sequence

from liftgate_hil.ecu.mutants import MUTANTS
from liftgate_hil.plan.force_limits import force_limits_of
from liftgate_hil.report.page import Markup, section, table, text
from liftgate_hil.report.pinch import BORROWED, ORIGINS, OWN_LIMIT
from liftgate_hil.testing.mutation import MutationResult
from liftgate_hil.testing.outcome import Outcome

_MOST = 6  # expectations that are named


def mutants_section(mutation: MutationResult) -> str:
    """Return the section: the mutants of the reference ECU that survive, then all others."""
    parts = [f"<p><b>{text(mutation.reason)}.</b></p>"] if mutation.reason else []
    matrix = mutation.matrix
    if matrix is None:
        return section("Mutants", *parts)
    tolerated = [(name, MUTANTS[name].meaning, matrix.where(name)) for name in matrix.tolerated]
    unreached = [(name, MUTANTS[name].meaning) for name in matrix.never_reached]
    rows = [
        (each.name, each.meaning, _killers(matrix.kills(each.name)))
        for each in MUTANTS.values()
        if each.name in matrix.killed
    ]
    parts += [
        "<p>Each mutant of the reference ECU has one defect. It is killed if an expectation fails that the ECU "
        "without a defect passes.</p>"
    ]
    if tolerated:
        parts += [
            "<p>Survived, reached and tolerated: in a scenario the defect changes the ECU's state or "
            "command, and no expectation fails. A stricter expectation kills them; if only internal ECU state "
            "differs, add a scenario that exposes it. "
            "<code>--ecu mutant:NAME</code> runs a scenario with one of them.</p>",
            table(("mutant", "defect", "differs in"), tolerated, ("n", "", "name")),
        ]
    if unreached:
        parts += [
            "<p>Survived, never reached: in every control cycle of every scenario these do what the ECU without a "
            "defect does. It takes another scenario: the manual's page on the pack has one for each mutant.</p>",
            table(("mutant", "defect"), unreached, ("n", "")),
        ]
    if rows:
        parts += ["<p>Killed:</p>", table(("mutant", "defect", "killed by"), rows, ("n", "", ""))]
    for story, expectations in (
        ("Expectations that pass with every mutant, and without an ECU, prove nothing:", matrix.prove_nothing),
        (
            "Expectations that do not pass even with the ECU without a defect can kill no mutant:",
            matrix.not_counted,
        ),
    ):
        items = "".join(f"<li>{text(file)}: {text(name)}</li>" for file, name in expectations)
        parts += [f"<p>{story}</p><ul>{items}</ul>"] if items else []
    return section("Mutants", *parts)


def _killers(found: list[tuple[str, str]]) -> Markup:
    """Return the first of the expectations that kill a mutant."""
    named = "; ".join(f"{file}: {name}" for file, name in found[:_MOST])
    more = f"; and {len(found) - _MOST} more" if len(found) > _MOST else ""
    return Markup(text(named + more))


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
