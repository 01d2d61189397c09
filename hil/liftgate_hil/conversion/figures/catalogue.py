"""Table of the figures of `plot`: a figure is a row here, and the module of its name beside this one."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple, cast

if TYPE_CHECKING:
    from liftgate_hil.conversion.figures.subject import Drawn, FigureSubject


class FigureKind(NamedTuple):
    """What a figure shows, and of what."""

    meaning: str
    of_recording: bool = False
    of_vehicle: bool = False


FIGURES: Mapping[str, FigureKind] = {
    "columns": FigureKind("columns over time", of_recording=True),
    "thesis": FigureKind(
        "voltage, current, speed, position, angle and force, arranged as in the thesis", of_recording=True
    ),
    "phase": FigureKind("gate rate over gate angle", of_recording=True),
    "pinch": FigureKind(
        "the contact with the largest pinch force, and its limit", of_recording=True, of_vehicle=True
    ),
    "forces": FigureKind("torques on the gate at rest over its angle", of_vehicle=True),
    "static": FigureKind(
        "where the gate stays, and where the drives start it, over slope and supply", of_vehicle=True
    ),
}


def drawn(name: str, subject: FigureSubject) -> Drawn:
    """Draw the figure of that name, one of FIGURES. Raises ConfigError where the subject lacks what it needs."""
    module = importlib.import_module(f"liftgate_hil.conversion.figures.{name}")
    return cast("Drawn", module.draw(subject))
