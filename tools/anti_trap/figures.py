"""Figures of the study, and their file: page and picture are drawn from it again without the study."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tools.anti_trap.study import Energy, Many
from tools.anti_trap.trials import Outcome

FILE = "anti-trap.json"


class Figures(NamedTuple):
    """Figures of the study."""

    travel: Mapping[str, Mapping[str, Outcome]]  # by vehicle and condition
    many: Mapping[str, Many]  # drawn cars, by vehicle
    trade: Mapping[float, Mapping[str, Many]]  # the same by tolerance scale
    rods: Mapping[tuple[str, float], list[tuple[float, float]]]  # (speed [m/s], peak [N]) by vehicle and stiffness
    energies: Mapping[str, Energy]  # by vehicle

    def write(self, path: Path) -> None:
        """Write the figures as JSON; NaN is null."""
        content = {
            "travel": {
                vehicle: {name: each._asdict() for name, each in found.items()}
                for vehicle, found in self.travel.items()
            },
            "many": {vehicle: each._asdict() for vehicle, each in self.many.items()},
            "trade": {
                str(factor): {vehicle: each._asdict() for vehicle, each in found.items()}
                for factor, found in self.trade.items()
            },
            "rods": [[*key, points] for key, points in self.rods.items()],
            "energies": {vehicle: each._asdict() for vehicle, each in self.energies.items()},
        }
        path.write_text(json.dumps(_without_nan(content)) + "\n", encoding="utf-8")


def read(path: Path) -> Figures:
    """Return the figures of a file."""
    content = json.loads(path.read_text(encoding="utf-8"))
    return Figures(
        {
            vehicle: {name: Outcome(**_with_nan(each)) for name, each in found.items()}
            for vehicle, found in content["travel"].items()
        },
        {vehicle: Many(**_with_nan(each)) for vehicle, each in content["many"].items()},
        {
            float(factor): {vehicle: Many(**_with_nan(each)) for vehicle, each in found.items()}
            for factor, found in content["trade"].items()
        },
        {(vehicle, rod): [tuple(_with_nan(each)) for each in points] for vehicle, rod, points in content["rods"]},
        {vehicle: Energy(**each) for vehicle, each in content["energies"].items()},
    )


def _without_nan(value: Any) -> Any:
    """Return a value for JSON, whose NaN are None."""
    if isinstance(value, dict):
        return {name: _without_nan(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(each) for each in value]
    return None if isinstance(value, float) and value != value else value  # noqa: PLR0124  # NaN


def _with_nan(value: Any) -> Any:
    """Return a value of JSON, whose None are NaN and whose lists are tuples."""
    if isinstance(value, dict):
        return {name: _with_nan(each) for name, each in value.items()}
    if isinstance(value, list):
        return tuple(_with_nan(each) for each in value)
    return float("nan") if value is None else value
