"""Input files of `simulate`: columns over time, a sample holding until the next one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError

Floats = NDArray[np.float64]

# Column of an input file, the rows of the step's inputs that it fills, and its allowed range.
_COLUMNS: dict[str, tuple[tuple[str, ...], float, float]] = {
    "voltage_v": (("left_voltage", "right_voltage"), -1000.0, 1000.0),
    "left_voltage_v": (("left_voltage",), -1000.0, 1000.0),
    "right_voltage_v": (("right_voltage",), -1000.0, 1000.0),
    "left_duty": (("left_duty",), -1.0, 1.0),
    "right_duty": (("right_duty",), -1.0, 1.0),
    "supply_voltage_v": (("supply_voltage",), 0.0, 1000.0),
    "road_slope_deg": (("road_slope",), -45.0, 45.0),
    "hand_force_n": (("hand_force",), -1e5, 1e5),
}
ROWS = (
    "left_voltage",
    "right_voltage",
    "left_duty",
    "right_duty",
    "supply_voltage",
    "road_slope",
    "hand_force",
)
_CLASH = {"voltage_v": ("left_voltage_v", "right_voltage_v")}


@dataclass(frozen=True)
class Samples:
    """Times (n,) and, per row of ROWS that the file has, values (n,); SI."""

    times: Floats
    values: dict[str, Floats]

    def at(self, times: Floats, row: str) -> Floats:
        """The row at these times, each sample held until the next; NaN before the first."""
        if row not in self.values:
            return np.full(len(times), np.nan)
        index = np.searchsorted(self.times, times, side="right") - 1
        return np.where(index >= 0, self.values[row][np.maximum(index, 0)], np.nan)


def constant_voltage(volts: float) -> Samples:
    """A step of the motor voltage at time 0, on both drives."""
    value = np.array([volts])
    return Samples(np.zeros(1), {"left_voltage": value, "right_voltage": value})


def read_samples(path: Path) -> Samples:
    """The samples of a .csv or .mf4 file. Raises ConfigError with all faults."""
    columns = _read_mf4(path) if path.suffix.lower() == ".mf4" else _read_csv(path)
    faults = []
    known = ["time_s", *_COLUMNS]
    # A recording of ours is an input too; its output columns are not for us.
    if "time_s" not in columns:
        faults.append(f"{path}: time_s: missing; allowed: a column of seconds")
    used = [name for name in columns if name in _COLUMNS]
    if not used:
        faults.append(f"{path}: no input column; allowed: {', '.join(known)}")
    for name, others in _CLASH.items():
        faults += [
            f"{path}: {name} and {other}: allowed: one or the other"
            for other in others
            if name in columns and other in columns
        ]
    for side in ("left", "right"):
        volts = [n for n in ("voltage_v", f"{side}_voltage_v") if n in columns]
        if volts and f"{side}_duty" in columns:
            faults.append(f"{path}: {volts[0]} and {side}_duty: allowed: one or the other")
    for name in used:
        faults += _range_faults(path, name, columns[name])
    times = columns.get("time_s", np.zeros(0))
    if not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0.0):
        row = int(np.argmin(np.append(np.diff(times) > 0.0, False))) + 1
        faults.append(f"{path}: time_s: row {row + 1}; allowed: finite and rising")
    if len(times) == 0 and "time_s" in columns:
        faults.append(f"{path}: no rows")
    if faults:
        raise ConfigError(faults)
    values: dict[str, Floats] = {}
    for name in used:
        factor = np.pi / 180.0 if name.endswith("_deg") else 1.0
        for row_name in _COLUMNS[name][0]:
            values[row_name] = columns[name] * factor
    return Samples(times, values)


def _range_faults(path: Path, name: str, values: Floats) -> list[str]:
    _, low, high = _COLUMNS[name]
    bad = np.flatnonzero(~((values >= low) & (values <= high)))
    if len(bad) == 0:
        return []
    first = int(bad[0])
    return [
        f"{path}: {name}: {float(values[first])!r} in row {first + 1} ({len(bad)} such rows); "
        f"allowed: {low:g} to {high:g}"
    ]


def _read_csv(path: Path) -> dict[str, Floats]:
    import csv

    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            rows = list(csv.reader(stream))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    if not rows:
        raise ConfigError(f"{path}: empty; allowed: a header and rows")
    names = [name.strip() for name in rows[0]]
    body = [row for row in rows[1:] if row]
    return {
        name: _numbers(path, name, [row[i] if i < len(row) else "" for row in body])
        for i, name in enumerate(names)
        if name == "time_s" or name in _COLUMNS
    }


def _numbers(path: Path, name: str, cells: Sequence[str]) -> Floats:
    try:
        return np.array([float(cell) for cell in cells], dtype=np.float64)
    except ValueError:
        for row, cell in enumerate(cells):
            try:
                float(cell)
            except ValueError:
                raise ConfigError(
                    f"{path}: {name}: {cell!r} in row {row + 1}; allowed: a number"
                ) from None
        raise


def _read_mf4(path: Path) -> dict[str, Floats]:
    try:
        from asammdf import MDF
    except ImportError as error:
        raise ConfigError(
            f"{path}: MF4 needs asammdf; allowed after: pip install 'liftgate-hil[mf4]'"
        ) from error
    try:
        with MDF(path) as measurement:
            wanted = [name for name in _COLUMNS if name in measurement.channels_db]
            signals = [measurement.get(name) for name in wanted]
    except Exception as error:  # asammdf raises what its parsers raise
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    if not signals:
        return {}
    times = np.unique(np.concatenate([signal.timestamps for signal in signals]))
    columns = {"time_s": times.astype(np.float64)}
    for name, signal in zip(wanted, signals, strict=True):
        index = np.searchsorted(signal.timestamps, times, side="right") - 1
        columns[name] = signal.samples.astype(np.float64)[np.maximum(index, 0)]
    return columns
