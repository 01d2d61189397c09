"""Page docs/signals.md: every column of recordings with its unit and meaning, from the catalogue of signals."""

from __future__ import annotations

from liftgate_hil.signals import COLUMNS
from tools.docs.markdown import code, page, table

_INTRO = """\
What a recording holds in each of its rows, what conditions of scenarios refer to, and what `simulate` writes.
Names end with the unit. A column that begins with `sensed_` is what the ECU's sensor reports, the one without is
the true value; in conditions the former is `sensed.NAME`.

In place of `faults_in_force` a recording has a column for each of the first 51 faults of the scenario, 1 while
it is in force:
`fault.KIND` or `fault.KIND.WHERE`, such as `fault.spring_lost.left`, and of a second one alike
`fault.spring_lost.left.2`. In real time `fault.injected` is 1 while any other is in force, from a page or a test
bench. What each fault is stands in the provenance, under `faults`."""


def signals_page() -> str:
    """Return the text of the page."""
    rows = (
        (code(name), each.unit, each.meaning, ", ".join(map(code, each.values or ())))
        for name, each in COLUMNS.items()
    )
    return page("Signals", _INTRO, table(["column", "unit", "meaning", "values"], rows))
