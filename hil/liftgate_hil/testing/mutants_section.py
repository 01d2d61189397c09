"""Section of a test report on mutants: which scenarios find which defects."""

from __future__ import annotations

from liftgate_hil.ecu.mutants import MUTANTS
from liftgate_hil.report.page import Markup, section, table, text
from liftgate_hil.testing.mutation import Matrix

_MOST = 6  # expectations that are named


def mutants_section(matrix: Matrix) -> str:
    """Return the section: the defects of the reference ECU that no expectation finds, then all others."""
    alive = [(each.name, each.meaning) for each in MUTANTS.values() if each.name in matrix.alive]
    rows = [
        (each.name, each.meaning, _killers(matrix.kills(each.name)))
        for each in MUTANTS.values()
        if each.name in matrix.killed
    ]
    nothing = [f"{file}: {name}" for file, name in matrix.prove_nothing]
    parts = [
        "<p>Each mutant of the reference ECU has one defect. It is found if an expectation fails that the ECU "
        "without a defect passes.</p>"
    ]
    if alive:
        parts += [
            "<p>Not found: no expectation tells these from the ECU without a defect.</p>",
            table(("mutant", "defect"), alive, ("", "")),
        ]
    if rows:
        parts += ["<p>Found:</p>", table(("mutant", "defect", "found by"), rows, ("", "", ""))]
    if nothing:
        items = "".join(f"<li>{text(each)}</li>" for each in nothing)
        parts.append(
            "<p>Expectations that hold with every mutant, and with no ECU at all, prove nothing:</p>"
            f"<ul>{items}</ul>"
        )
    return section("Mutants", *parts)


def score_of(matrix: Matrix) -> str:
    """Return how many mutants are found, in words."""
    return f"{len(matrix.killed)} of {len(MUTANTS)} mutants found, {len(matrix.alive)} not."


def _killers(found: list[tuple[str, str]]) -> Markup:
    """Return the first of the expectations that find a defect."""
    named = "; ".join(f"{file}: {name}" for file, name in found[:_MOST])
    more = f"; and {len(found) - _MOST} more" if len(found) > _MOST else ""
    return Markup(text(named + more))
