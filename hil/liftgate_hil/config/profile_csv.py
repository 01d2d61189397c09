"""Read the points of a profile from a CSV file: the columns `time_s` and the quantity's, among any others."""

from __future__ import annotations

import csv
from pathlib import Path

from liftgate_hil.config.files import read_bytes
from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigError

_MOST_BYTES = 100_000_000


class PointsReader:
    """Reader of points in CSV files, which reads each column once and keeps its points."""

    def __init__(self) -> None:
        self._kept: dict[tuple[Path, str], list[list[float]]] = {}

    @property
    def files(self) -> list[Path]:
        """The files that were read."""
        return list(dict.fromkeys(path for path, _ in self._kept))

    def read(self, path: Path, quantity: str) -> list[list[float]]:
        """Return the points [time, value]. Raises ConfigError."""
        if (path, quantity) not in self._kept:
            self._kept[path, quantity] = _read_points(path, quantity)
        return self._kept[path, quantity]


def _read_points(path: Path, quantity: str) -> list[list[float]]:
    """Return the points [time, value]. Raises ConfigError."""
    try:
        lines = read_bytes(path, _MOST_BYTES).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8: {error}") from error
    try:
        rows = [row for row in csv.reader(lines) if row]
    except csv.Error as error:
        raise ConfigError(f"{path}: {error}; allowed: a CSV file") from error
    header = [name.strip() for name in rows[0]] if rows else []
    places = []
    for name in ("time_s", quantity):
        if header.count(name) != 1:
            raise ConfigError(f"{path}: column {name} {header.count(name)} times in its first line; allowed: once")
        places.append(header.index(name))
    points = []
    for line, row in enumerate(rows[1:], 2):
        try:
            points.append([float(row[place]) for place in places])
        except (ValueError, IndexError):
            raise ConfigError(
                f"{path}: row {line}: {show(','.join(row))}; allowed: a number in both columns"
            ) from None
    return points
