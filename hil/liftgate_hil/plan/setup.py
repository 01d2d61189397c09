"""The composition root: builds vehicle, rig, scenario and setup from files and values.

No flags, no printing, no signal handlers: the command line, pytest and the rest of the API use this module.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.config.choices import SetupChoice
from liftgate_hil.config.described import seed_of, value_of
from liftgate_hil.config.kinds import NumbersByName
from liftgate_hil.config.rig import Rig, load_rig
from liftgate_hil.config.scenario import Scenario, ScenarioFile, load_scenario, no_scenario
from liftgate_hil.config.settings import settings_of
from liftgate_hil.config.shipped import DEFAULT_RIG, DEFAULT_VEHICLE, find_config
from liftgate_hil.config.toml import show
from liftgate_hil.config.variant import AS_FILED, Variant
from liftgate_hil.config.vehicle import VehicleFile, load_vehicle, read_vehicle
from liftgate_hil.errors import ConfigError
from liftgate_plant.vehicle import Vehicle

if TYPE_CHECKING:
    from liftgate_hil.plan.request import RunRequest


def vehicle_from(
    name: str | Path, settings: Sequence[str] = (), *, draw: int | None = None, ideal: bool = False
) -> Vehicle:
    """Load a vehicle by a shipped name or a path, with KEY=VALUE settings applied.

    `draw`: the seed of one car of the file's `[spread]`; `ideal`: without errors of sensors, torsion, source
    resistance. Raises ConfigError.
    """
    return vehicle_of(str(name), settings, variant_of(draw, ideal))


def variant_of(draw: int | None, ideal: bool) -> Variant:
    """Return the variant to load: as filed, one car of the spread (seed `draw`), or ideal. Raises ConfigError."""
    return Variant(None if draw is None else seed_of(draw, "draw"), bool(ideal))


def rig_from(name: str | Path) -> Rig:
    """Load a rig by a shipped name or a path. Raises ConfigError."""
    return load_rig(find_config("rigs", str(name)))


def scenario_from(
    name: str | Path | None, parameters: Mapping[str, float] | Sequence[str] | None = None
) -> Scenario:
    """Load a scenario by a shipped name or a path, its parameters replaced; None: an empty one.

    Raises ConfigError.
    """
    if name is None:
        return no_scenario()
    return load_scenario(find_config("scenarios", str(name)), _numbers(parameters))


def _numbers(parameters: Mapping[str, float] | Sequence[str] | None) -> dict[str, float]:
    """Return parameters that replace a scenario's, as numbers by name. Raises ConfigError."""
    found: dict[str, float] = value_of("parameters", parameters or (), NumbersByName())
    return found


def vehicle_of(
    vehicle: str | Path | Vehicle, settings: Sequence[str] = (), variant: Variant = AS_FILED
) -> Vehicle:
    """Return the vehicle given, or load a variant of it by name or path, with settings. Raises ConfigError."""
    if isinstance(vehicle, str | Path):
        return load_vehicle(find_config("vehicles", str(vehicle)), settings_of(settings), variant)
    if not isinstance(vehicle, Vehicle):
        raise ConfigError(f"`vehicle` {show(vehicle)}: allowed: a shipped name, a file, a Vehicle")
    if settings:
        raise ConfigError(f"`settings` {', '.join(settings)}: allowed with a vehicle by its name or file")
    if variant != AS_FILED:
        asked = "`ideal`" if variant.is_ideal else f"`draw` {variant.draw}"
        raise ConfigError(f"{asked}: allowed with a vehicle by its name or file")
    return vehicle


def rig_of(rig: str | Path | Rig | None, scenario: Scenario | None = None) -> Rig:
    """Return the rig given, or load it by name or path; None: the scenario's or liftgate. Raises ConfigError."""
    if rig is None and scenario is not None and scenario.rig:
        return load_rig(find_config("rigs", scenario.rig, f"{scenario.source}: rig"))
    rig = DEFAULT_RIG if rig is None else rig
    if isinstance(rig, str | Path):
        return rig_from(rig)
    if not isinstance(rig, Rig):
        raise ConfigError(f"`rig` {show(rig)}: allowed: a shipped name, a file, a Rig")
    return rig


def scenario_of(
    scenario: str | Path | ScenarioFile | Scenario | None,
    parameters: Mapping[str, float] | Sequence[str] | None = None,
) -> Scenario:
    """Return the scenario given, or load it with other parameters; None: an empty one. Raises ConfigError."""
    if isinstance(scenario, ScenarioFile):
        return scenario.scenario(_numbers(parameters))
    if isinstance(scenario, str | Path):
        return scenario_from(str(scenario), parameters)
    if scenario is not None and not isinstance(scenario, Scenario):
        raise ConfigError(f"`scenario` {show(scenario)}: allowed: a shipped name, a file, a Scenario, or None")
    if parameters:
        names = ", ".join(_numbers(parameters))
        raise ConfigError(f"`parameters` {names}: allowed with a scenario by its name or file")
    return no_scenario() if scenario is None else scenario


def angle_from(initial: float | str, open_angle: float, others: str = "") -> float:
    """Return the angle [rad] that "closed", "open" (`open_angle`, rad) or a number of degrees means.

    `others` are words that the caller allows besides, for the error's text. Raises ConfigError.
    """
    named = {"closed": 0.0, "open": open_angle}
    if isinstance(initial, str) and initial in named:
        return named[initial]
    try:
        degrees = math.nan if isinstance(initial, bool) else float(initial)
    except (TypeError, ValueError, OverflowError):
        degrees = math.nan
    top = math.degrees(open_angle)
    if not 0.0 <= degrees <= top:
        given = initial if isinstance(initial, str) and len(initial) <= 60 else show(initial)
        raise ConfigError(f"`initial` {given}: allowed: {others}closed, open, or 0 to {top:g} degrees")
    return math.radians(degrees)


@dataclass(frozen=True)
class Setup:
    """Setup of a run: the vehicle, its initial angle, and the scenario."""

    scenario: Scenario
    vehicle: Vehicle
    vehicle_name: str
    vehicle_file: Path | None  # None: a program made the vehicle
    scenario_file: Path | None  # None: there is none, or a program made the scenario
    seed: int
    start_angle: float  # rad

    @property
    def files(self) -> dict[str, Path]:
        """Files from which vehicle and scenario were loaded, by purpose."""
        found = {} if self.vehicle_file is None else {"vehicle": self.vehicle_file}
        if self.scenario_file is not None:
            found["scenario"] = self.scenario_file
            found |= {f"included {k}": Path(name) for k, name in enumerate(self.scenario.included, 1)}
        return found

    @property
    def inputs(self) -> list[Path]:
        """All input files of the setup, including those of a loaded scenario's profiles."""
        own = self.scenario
        return [*self.files.values(), *(Path(name) for name in (own.source, *own.included, *own.tables) if name)]

    def varied(
        self, scenario: Scenario, vehicle: Vehicle, *, initial: float | str | None = None, seed: int | None = None
    ) -> Setup:
        """Return a copy with a scenario and vehicle; the others default to the scenario's. Raises ConfigError."""
        return replace(
            self,
            scenario=scenario,
            vehicle=vehicle,
            seed=seed_of(scenario.seed if seed is None else seed),
            start_angle=angle_from(scenario.initial if initial is None else initial, vehicle.gate.open_angle),
        )


def setup_for(choice: SetupChoice) -> Setup:
    """Build the setup from a request's choice of its values. Raises ConfigError."""
    return setup_of(
        choice.scenario,
        parameters=choice.parameters,
        vehicle=choice.vehicle,
        settings=choice.settings,
        initial=choice.initial,
        seed=choice.seed,
        variant=variant_of(choice.draw, choice.ideal),
    )


def setup_and_rig(request: RunRequest) -> tuple[Setup, Rig]:
    """Build the setup and the rig that a request for a run chooses. Raises ConfigError."""
    setup = setup_for(request)
    return setup, rig_of(request.rig, setup.scenario)


def setup_of(
    scenario: str | Path | ScenarioFile | Scenario | None = None,
    *,
    parameters: Mapping[str, float] | Sequence[str] | None = None,
    vehicle: str | Path | VehicleFile | Vehicle | None = None,
    settings: Sequence[str] = (),
    initial: float | str | None = None,
    seed: int | None = None,
    variant: Variant = AS_FILED,
) -> Setup:
    """Build the setup from these arguments; for None the scenario's value, else suv, closed, seed 0.

    `settings` come after the scenario's, and both after the variant. Raises ConfigError.
    """
    is_a_file = isinstance(scenario, str | Path | ScenarioFile)
    scenario = scenario_of(scenario, parameters)
    called = ""
    if vehicle is None:
        vehicle = scenario.vehicle or DEFAULT_VEHICLE
        called = f"{scenario.source}: vehicle" if scenario.vehicle else ""
    if isinstance(vehicle, str | Path):
        vehicle = read_vehicle(find_config("vehicles", str(vehicle), called), str(vehicle))
    if isinstance(vehicle, VehicleFile):
        built = vehicle.vehicle([*scenario.settings, *settings_of(settings)], variant)
        file, name = vehicle.path, vehicle.name
    else:
        if scenario.settings:
            keys = ", ".join(each.source + each.key for each in scenario.settings)
            raise ConfigError(f"{keys}: allowed with a vehicle by its name or file")
        built, file, name = vehicle_of(vehicle, settings, variant), None, "a vehicle"
    own = Path(scenario.source) if is_a_file else None
    made = Setup(scenario, built, vehicle_name=name, vehicle_file=file, scenario_file=own, seed=0, start_angle=0.0)
    return made.varied(scenario, built, initial=initial, seed=seed)
