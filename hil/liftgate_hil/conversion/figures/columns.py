"""Figure of columns over time, related ones in one panel."""

from __future__ import annotations

from liftgate_hil.conversion import picture
from liftgate_hil.conversion.figures.subject import Drawn, Subject
from liftgate_hil.conversion.table import chosen, columns_in


def draw(subject: Subject) -> Drawn:
    """Draw the requested columns, or the usual ones. Raises ConfigError."""
    table = subject.recording()
    names = chosen(table, subject.columns) or picture.usual_columns(table, subject.rig)
    panels = picture.panels_of(names, table)
    columns = columns_in(table, names, subject.window)
    units = {name: table.signals[name].unit for name in names}
    left_out = 0 if subject.columns else len(table.signals) - 1 - len(names)
    note = f"not drawn: {left_out} more column{'s' * (left_out > 1)}, see --columns" if left_out else ""
    return Drawn(picture.run_picture(subject.title, columns, panels, units), ", ".join(names), note)
