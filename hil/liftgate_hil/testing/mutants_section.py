"""Section of a test report on mutants: which scenarios find which defects."""

from __future__ import annotations

from liftgate_hil.ecu.mutants import MUTANTS
from liftgate_hil.report.page import Markup, section, table, text
from liftgate_hil.testing.mutation import Matrix

_MOST = 6  # expectations that are named


def mutants_section(matrix: Matrix) -> str:
    """Return the section: defects of the reference ECU, and the expectations that find them."""
    killed = len(matrix.killed)
    rows = [(each.name, each.meaning, _killers(matrix.kills(each.name))) for each in MUTANTS.values()]
    idle = matrix.prove_nothing
    nothing = [f"{file}: {name}" for file, name in idle]
    parts = [
        f"<p>{killed} of {len(MUTANTS)} mutants of the reference ECU, each with one defect, fail an expectation "
        "that the ECU without a defect passes.</p>",
        table(("mutant", "defect", "found by"), rows, ("", "", "")),
    ]
    if nothing:
        items = "".join(f"<li>{text(each)}</li>" for each in nothing)
        parts.append(
            "<p>Expectations that hold with every mutant, and with no ECU at all, prove nothing:</p>"
            f"<ul>{items}</ul>"
        )
    return section("Mutants", *parts)


def _killers(found: list[tuple[str, str]]) -> Markup:
    """Return the first of the expectations that find a defect."""
    if not found:
        return Markup("<strong>none</strong>")
    named = "; ".join(f"{file}: {name}" for file, name in found[:_MOST])
    more = f"; and {len(found) - _MOST} more" if len(found) > _MOST else ""
    return Markup(text(named + more))
