"""Subject of a figure (a recording with its columns, a vehicle, or both), and the drawn figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from liftgate_hil.conversion.table import OUTPUT_OF, Floats, Window, columns_in, mappings_of, ours_in
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.recording import Recording
from liftgate_hil.signals import SENSED_PREFIX

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from liftgate_plant.vehicle import Vehicle

Columns = Mapping[str, Floats]
WHOLE = Window()
_DRAWN = 1e30  # values from there on are gaps, as in `drawing.line`


class Drawn(NamedTuple):
    """A drawn figure, and its caption for readers who cannot see it."""

    figure: Figure
    caption: str
    note: str = ""  # what it does not show; "": nothing


@dataclass(frozen=True)
class FigureSubject:
    """Subject of a figure: a recording, a vehicle, or both, as the figure's entry in the catalogue requires."""

    title: str
    table: Recording | None = None
    rig: str | None = None  # by which the table was decoded
    columns: Sequence[str] = ()  # the requested ones; none: the figure's own
    window: Window = WHOLE
    vehicle: Vehicle | None = None
    vehicle_name: str = ""

    def recording(self) -> Recording:
        """Return the subject's recording. Raises ConfigError if there is none."""
        if self.table is None:
            raise ConfigError("`recording`: missing; allowed: a recording")
        return self.table

    def car(self) -> Vehicle:
        """Return the subject's vehicle. Raises ConfigError if there is none."""
        if self.vehicle is None:
            raise ConfigError("`vehicle`: missing; allowed: a shipped name, a file")
        return self.vehicle


class Taken(NamedTuple):
    """Columns of a recording by our names, (n,), and a remark on those that hold sensor values."""

    columns: Columns
    remark: str  # a sentence; "": all of them are true values


def taken(subject: FigureSubject, wanted: Sequence[str], optional: Sequence[str] = ()) -> Taken:
    """Return the times, as `time_s`, and the wanted columns by our names, in our units, (n,).

    A column that the recording lacks is replaced by its sensor's. A bus log has columns that its rig maps. Times
    rise; of rows at the same time the last one counts. Raises ConfigError with all of the `wanted` columns that
    are missing, and if there are fewer than two times in the window.
    """
    table = subject.recording()
    places = _places(table, subject.rig, [*wanted, *optional])
    missing = [name for name in wanted if name not in places]
    if missing:
        raise ConfigError(
            f"{table.path}: {', '.join(missing)}: missing; allowed: {_allowed(missing, subject.rig)}"
        )
    found = columns_in(table, list(dict.fromkeys(place.column for place in places.values())), subject.window)
    times = found["time_s"]
    if not np.isfinite(times).all() or (np.diff(times) < 0.0).any():
        raise ConfigError(f"{table.path}: time_s: falls or is not finite; allowed: finite times in order")
    kept = np.append(np.diff(times) > 0.0, True)
    if kept.sum() < 2:
        raise ConfigError(f"{table.path}: only one time in the window; allowed: two or more")
    columns = {"time_s": times[kept]}
    for name, place in places.items():
        values = found[place.column][kept]
        columns[name] = place.scale * np.where(np.abs(values) < _DRAWN, values, np.nan) + place.offset
    sensed = [name for name, place in places.items() if place.is_sensed]
    return Taken(columns, f"As the sensors read them: {', '.join(sensed)}." if sensed else "")


def complete(columns: Columns, names: Sequence[str]) -> Columns:
    """Return the rows in which all of the columns `names` have a finite value."""
    kept = np.logical_and.reduce([np.isfinite(columns[name]) for name in names])
    return {name: values[kept] for name, values in columns.items()}


class _Place(NamedTuple):
    """Column of a table that holds one of our columns: ours = scale · table's + offset."""

    column: str
    is_sensed: bool
    scale: float = 1.0
    offset: float = 0.0


def _places(table: Recording, rig: str | None, names: Sequence[str]) -> dict[str, _Place]:
    """Return which column of a table holds each of our columns `names`, true or sensed; those without: omitted."""
    signals = list(table.signals)
    wired = {} if rig is None else ours_in(rig, signals)
    wires = {} if rig is None else mappings_of(rig)
    found = {}
    for name in names:
        for column in (name, SENSED_PREFIX + name):
            is_sensed = column != name
            if column in signals:
                found[name] = _Place(column, is_sensed)
                break
            if column in wired and wires[column].values is None:  # labels are no numbers
                found[name] = _Place(wired[column], is_sensed, wires[column].scale, wires[column].offset)
                break
    return found


def _allowed(missing: Sequence[str], rig: str | None) -> str:
    if rig is None:
        return "a recording that has them as columns, or as sensed_ ones"
    outputs = [OUTPUT_OF.get(SENSED_PREFIX + name, OUTPUT_OF.get(name, name)) for name in missing]
    return f"a rig that maps {', '.join(outputs)}, with frames of these in the log"
