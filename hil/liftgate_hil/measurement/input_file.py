"""Input files of `simulate`: columns over time; a sample holds until the next one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from liftgate_hil.errors import ConfigError, printable
from liftgate_hil.formats.open import open_file
from liftgate_hil.formats.suffixes import WITH_ROWS
from liftgate_hil.measurement.mapping import ColumnMap, Theirs
from liftgate_hil.measurement.measurement import INPUTS, OUTPUTS
from liftgate_hil.measurement.table import (
    INPUT_KIND,
    RECORDED_NOTE,
    SIDES,
    TableReading,
    misspelt,
    read_series,
    shift_inputs,
)
from liftgate_hil.signals import COLUMN_PLACE
from liftgate_hil.stimuli.samples import Floats, Samples

_OURS = {*COLUMN_PLACE, *OUTPUTS}  # what a recording or a measurement also holds, which nobody takes for an input
_MOST_NAMED = 5  # unknown columns


def read_samples(path: Path, mapping: ColumnMap) -> tuple[Samples, tuple[str, ...]]:
    """Return the inputs in a table, by our names or as mapped, from time 0 on, and notes on the table.

    Raises ConfigError with all issues.
    """
    reading, series, shared = read_series(path, open_file(path, WITH_ROWS), mapping, INPUT_KIND)
    issues = [
        f"{path}: {name}: empty cell in row {int(np.argmax(np.isnan(each.values))) + 1}; allowed: a number"
        for name, each in series.items()
        if np.any(np.isnan(each.values))
    ]
    own = [each.times for each in series.values() if each.times is not None]
    times = shared if shared is not None else np.unique(np.concatenate(own))
    if not issues and not len(times):
        issues.append(f"{path}: no rows; allowed: one or more")
    if issues:
        raise ConfigError(issues)
    columns: dict[str, Floats] = {}
    for name, each in series.items():
        held = each.values
        if each.times is not None:
            held = held[np.maximum(np.searchsorted(each.times, times, side="right") - 1, 0)]
        columns[name] = held
    return Samples(times - times[0], _as_simulated(reading, columns)), _notes(reading, times)


def _as_simulated(reading: TableReading, columns: dict[str, Floats]) -> dict[str, Floats]:
    """Return the columns of the inputs of a step, each holding from its row on."""
    if reading.recorded:
        shift_inputs(columns)
    if reading.names.get("latch_released") == "latched":
        columns["latch_released"] = 1.0 - columns["latch_released"]
    both = columns.pop("voltage_v", None)
    if both is not None:
        columns |= {f"{side}_voltage_v": both for side in SIDES}
    return columns


def _notes(reading: TableReading, times: Floats) -> tuple[str, ...]:
    notes = [*reading.file.notes, *([RECORDED_NOTE] if reading.recorded else [])]
    if times[0] != 0.0:
        notes.append(f"begins at {times[0]:.9g} s, which is time 0 here")
    names, near = reading.file.names, misspelt(reading, ("voltage_v", *INPUTS))
    notes += near.values()
    known = {*near, *reading.names.values(), *(Theirs(name).found_in(names) for name in _OURS)}
    others = [name for name in names if name and name not in known]
    if others:
        more = f" and {len(others) - _MOST_NAMED} more" if len(others) > _MOST_NAMED else ""
        notes.append(f"ignored, as no input has this name: {printable(', '.join(others[:_MOST_NAMED]))}{more}")
    return tuple(notes)
