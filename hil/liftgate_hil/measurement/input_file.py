"""Input files of `simulate`: columns over time, a sample holding until the next one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.read import open_columns
from liftgate_hil.measurement.table import time_issue
from liftgate_hil.signals import INPUT_SIGNALS
from liftgate_hil.stimuli.samples import Floats, Samples

# Column of an input file, and the columns of the step's inputs that it fills.
_FILLS: dict[str, tuple[str, ...]] = {
    "voltage_v": ("left_voltage_v", "right_voltage_v"),
    **{name: (name,) for name in INPUT_SIGNALS},
}


def _range_of(name: str) -> tuple[float, float]:
    signal = INPUT_SIGNALS[_FILLS[name][0]]
    return signal.low, signal.high


def read_samples(path: Path) -> Samples:
    """The samples of a CSV or MF4 file. Raises ConfigError with all faults."""
    file = open_columns(path)
    issues: list[str] = []
    # A recording of ours is an input too; its output columns are not for us.
    used = [name for name in file.names if name in _FILLS]
    by_rows = file.sample == "row"
    if by_rows and "time_s" not in file.names:
        issues.append(f"{path}: time_s: missing; allowed: a column of seconds")
    if not used:
        issues.append(f"{path}: no input column; allowed: {', '.join(['time_s', *_FILLS])}")
    issues += _clashes(path, used)
    wanted = [
        name for name in ("time_s", *used) if name in file.names and (by_rows or name in used)
    ]
    series = file.read(wanted, issues)
    for name in used:
        if name in series:
            issues += _range_issues(path, name, series[name].values, file.sample)
    if by_rows and "time_s" in series:
        fault = time_issue(series["time_s"].values, "row")
        issues += [f"{path}: time_s: {fault}"] if fault else []
    if not issues and not all(len(each.values) for each in series.values()):
        issues.append(f"{path}: no rows")
    if issues:
        raise ConfigError(issues)
    own = [each.times for each in series.values() if each.times is not None]
    times = series["time_s"].values if by_rows else np.unique(np.concatenate(own))
    columns: dict[str, Floats] = {}
    for name in used:
        held = series[name].values
        at = series[name].times
        if at is not None:
            held = held[np.maximum(np.searchsorted(at, times, side="right") - 1, 0)]
        columns |= dict.fromkeys(_FILLS[name], held)
    return Samples(times, columns)


def _clashes(path: Path, used: Sequence[str]) -> list[str]:
    """Drives that are told two things at once."""
    issues = []
    for side in ("left", "right"):
        own, duty = f"{side}_voltage_v", f"{side}_duty"
        for pair in (("voltage_v", own), ("voltage_v", duty), (own, duty)):
            if pair[0] in used and pair[1] in used:
                issues.append(f"{path}: {pair[0]} and {pair[1]}: allowed: one or the other")
    return issues


def _range_issues(path: Path, name: str, values: Floats, word: str) -> list[str]:
    low, high = _range_of(name)
    bad = np.flatnonzero(~((values >= low) & (values <= high)))
    if len(bad) == 0:
        return []
    first = int(bad[0])
    shown = "empty cell" if np.isnan(values[first]) else repr(float(values[first]))
    return [
        f"{path}: {name}: {shown} in {word} {first + 1} ({len(bad)} such {word}s); "
        f"allowed: {low:g} to {high:g}"
    ]
