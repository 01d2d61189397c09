"""Figure of columns over time, related ones in one panel."""

from __future__ import annotations

import numpy as np

from liftgate_hil.conversion import picture
from liftgate_hil.conversion.figures.subject import Drawn, FigureSubject
from liftgate_hil.conversion.table import Floats, chosen, columns_in
from liftgate_hil.errors import ConfigError


def draw(subject: FigureSubject) -> Drawn:
    """Draw the requested columns, or the usual ones. Raises ConfigError."""
    table = subject.recording()
    names = chosen(table, subject.columns) or picture.usual_columns(table, subject.rig)
    if not names:
        raise ConfigError(f"{table.path}: no column besides time_s; allowed: a recording with one")
    columns = columns_in(table, names, subject.window)
    still = [] if subject.columns else [name for name in names if _is_constant(columns[name])]
    if len(still) < len(names):
        names = [name for name in names if name not in still]
    else:
        still = []
    panels = picture.panels_of(names, table)
    units = {name: table.signals[name].unit for name in names}
    low, high = columns["time_s"][0], columns["time_s"][-1]
    marks = [(time, text) for time, text in table.marks if low <= time <= high]
    left_out = 0 if subject.columns else len(table.signals) - 1 - len(names) - len(still)
    notes = [f"not drawn, as they do not change: {', '.join(still)}"] if still else []
    notes += (
        [f"not drawn: {left_out} more column{'s' * (left_out > 1)}, which --columns NAME,… draws"]
        if left_out
        else []
    )
    drawn = picture.run_picture(subject.title, columns, panels, units, marks)
    return Drawn(drawn, ", ".join(names), "\n".join(notes))


def _is_constant(values: Floats) -> bool:
    there = values[np.isfinite(values)]
    return not len(there) or bool(there.max() == there.min())
