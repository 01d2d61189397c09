"""Page docs/signals.md: every column of recordings with its unit and meaning, from the catalogue of signals."""

from __future__ import annotations

from liftgate_hil.signals import COLUMNS
from tools.docs.markdown import code, page, table

_INTRO = """\
What a recording holds in each of its rows, what conditions of scenarios refer to, and what `simulate` writes.
Names end with the unit. A column that begins with `sensed_` is what the ECU's sensor reports, the one without is
the true value; in conditions the former is `sensed.NAME`."""


def signals_page() -> str:
    """Return the text of the page."""
    rows = (
        (code(name), each.unit, each.meaning, ", ".join(map(code, each.values or ())))
        for name, each in COLUMNS.items()
    )
    return page("Signals", _INTRO, table(["column", "unit", "meaning", "values"], rows))
