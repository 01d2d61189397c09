"""Choice of a vehicle, and of what happens to it, as commands take them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import SEED, File, Flag, NumberOr, Texts


# fmt: off
class VehicleSettings(Record):
    """Base of the requests that replace values of a vehicle."""

    settings: Annotated[tuple[str, ...], Field(Texts("a list of KEY=VALUE"), "replace a value of the vehicle "
        "file, e.g. environment.road_slope_deg=8 (repeatable)", metavar="KEY=VALUE", flag="set")] = ()
    draw: Annotated[int | None, Field(SEED, "draw one car from the vehicle file's [spread]",
        "the file's own values", "SEED")] = None
    ideal: Annotated[bool, Field(Flag(), "the thesis's plant: no noise, ripple, sensor errors, torsion, source "
        "resistance or wear")] = False


class VehicleChoice(VehicleSettings):
    """Base of the requests that concern a vehicle."""

    vehicle: Annotated[str | Path, Field(File(), "the vehicle: a shipped name, or a "
        "file", metavar="NAME|FILE")] = "suv"


class SetupChoice(VehicleSettings):
    """Base of the requests that concern a vehicle in a scenario."""

    scenario: Annotated[str | Path | None, Field(File(), "what happens over time", metavar="NAME|FILE")] = None
    vehicle: Annotated[str | Path | None, Field(File(), "the vehicle: a shipped name, or a file", "the "
        "scenario's, else suv", "NAME|FILE")] = None
    initial: Annotated[float | str | None, Field(NumberOr("closed, open, or degrees"), "where the gate starts",
        "the scenario's, else closed", "closed|open|ANGLE_deg")] = None
    seed: Annotated[int | None, Field(SEED, "seed of noise and other random values", "the scenario's, else "
        "0")] = None
