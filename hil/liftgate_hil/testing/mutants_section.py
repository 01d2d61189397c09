"""Section of a test report on mutants: which scenarios find which defects."""

from __future__ import annotations

from liftgate_hil.ecu.mutants import MUTANTS
from liftgate_hil.report.page import Markup, section, table, text
from liftgate_hil.testing.mutation import MutationResult

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
