"""Data sources of a page."""

from __future__ import annotations

from typing import Any, Protocol

from liftgate_hil.loop.histogram import Distribution
from liftgate_hil.signals import COLUMNS, SENSED_PREFIX, Bench

JsonObject = dict[str, Any]  # a JSON object


class Source(Protocol):
    """Data source of a page: a run, or a recording."""

    def about(self) -> JsonObject:
        """Return what the source is, its columns with their units, and what can be commanded."""

    def state(self, time: float | None = None) -> JsonObject:
        """Return the latest state, or that at a time [s] of a recording: see `GET /api/state`."""

    def plot(self) -> JsonObject:
        """Return the curves so far: `time_s`, and by column `low` and `high` of the stretch that ends there."""


def split(names: list[str], values: list[float]) -> tuple[JsonObject, JsonObject]:
    """Return a row's true and sensed values, by the same names."""
    truth, sensed = {}, {}
    for name, value in zip(names, values, strict=True):
        if name.startswith(SENSED_PREFIX):
            sensed[name.removeprefix(SENSED_PREFIX)] = value
        elif name not in Bench._fields:
            truth[name] = value
    return truth, sensed


def units_of(names: list[str]) -> dict[str, str]:
    """Return the unit of each column of the catalogue."""
    return {name: COLUMNS[name].unit if name in COLUMNS else "" for name in names}


def times_of(figures: Distribution) -> JsonObject | None:
    """Return a distribution of durations [µs]; None: there are none."""
    return figures._asdict() if figures.count else None
