"""What a page can be of."""

from __future__ import annotations

from typing import Any, Protocol

from liftgate_hil.loop.histogram import Distribution
from liftgate_hil.signals import COLUMNS, SENSED_PREFIX, Bench

Told = dict[str, Any]  # as JSON


class Source(Protocol):
    """A run, or a recording."""

    def about(self) -> Told:
        """What it is, its columns with their units, and what can be commanded."""

    def state(self, time: float | None = None) -> Told:
        """The latest, or at a time [s] of a recording: see interface of `GET /api/state`."""

    def plot(self) -> Told:
        """What is there to be drawn: `time_s`, and by column `low` and `high` of the stretch that ends there."""


def split(names: list[str], values: list[float]) -> tuple[Told, Told]:
    """A row's truth, and what was sensed, by the same names."""
    truth, sensed = {}, {}
    for name, value in zip(names, values, strict=True):
        if name.startswith(SENSED_PREFIX):
            sensed[name.removeprefix(SENSED_PREFIX)] = value
        elif name not in Bench._fields:
            truth[name] = value
    return truth, sensed


def units_of(names: list[str]) -> dict[str, str]:
    """The unit of each column of the catalogue."""
    return {name: COLUMNS[name].unit if name in COLUMNS else "" for name in names}


def times_of(figures: Distribution) -> Told | None:
    """How long things took [µs]; None: it is not known."""
    return figures._asdict() if figures.count else None
