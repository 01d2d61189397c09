"""Request of a campaign, in plain values, and what is prepared from it: base, space and first plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from liftgate_hil.campaign.base import Base, base_of
from liftgate_hil.campaign.design import DEFAULT_METHOD, Design
from liftgate_hil.campaign.results import check_columns
from liftgate_hil.campaign.space import DRAW, Space, space_of
from liftgate_hil.config.parameter_units import parameter_units
from liftgate_hil.config.scenario import ScenarioFile, read_scenario
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.toml import show
from liftgate_hil.config.vehicle import VehicleFile, read_vehicle
from liftgate_hil.ecu.find import check_ecu
from liftgate_hil.ecu.mutants import ecu_and_mutant
from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE
from liftgate_hil.errors import ConfigError
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.running.job import Job
from liftgate_hil.running.plan import Plan, plan_of
from liftgate_hil.running.request import RunRequest
from liftgate_hil.running.setup import rig_of, scenario_of

LEAST_OF_A_PROBABILITY = 1200  # evaluations: with fewer, the levels of a small probability are chance
DESIGN, WORST, PROBABILITY = "design", "worst", "probability"  # kinds of campaigns


@dataclass(frozen=True)
class Request:
    """Request of a campaign, as the command line gives it and campaign.json keeps it."""

    scenario: str
    vary: tuple[str, ...]
    ecu: str = REFERENCE
    against: str = ""  # another ECU that goes through the same variants
    vehicle: str | None = None
    rig: str | None = None
    settings: tuple[str, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    seed: int | None = None
    draw: int | None = None
    ideal: bool = False
    rate: float = RunRequest.rate
    duration: float | None = None
    kind: str = DESIGN
    expectation: str = ""  # of WORST and PROBABILITY
    samples: int = 0
    method: str = ""  # of METHODS; "": DEFAULT_METHOD
    sampling_seed: int = 0
    evaluations: int = 0  # of WORST and PROBABILITY; 0: the default of each

    def as_dict(self) -> dict[str, Any]:
        """Return the request as a dictionary for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, given: Any) -> Request:
        """Return the request of such a dictionary. Raises ConfigError where it is none."""
        own = cls("", ())
        if not isinstance(given, Mapping) or set(given) != {each.name for each in fields(cls)}:
            raise ConfigError(
                "campaign.json: request: damaged or of another version; allowed: as this version writes it"
            )
        issues = [
            f"campaign.json: request.{name}: {show(value)}; allowed: as it was written"
            for name, value in given.items()
            if not _is_like(value, getattr(own, name), _KINDS.get(name))
        ]
        if issues:
            raise ConfigError(issues)
        values: dict[str, Any] = {
            name: tuple(each) if isinstance(each, list) else each for name, each in given.items()
        }
        return cls(**values)


# Kinds of the values whose default is None.
_KINDS = {"vehicle": str, "rig": str, "seed": int, "draw": int, "duration": float}


def _is_like(value: Any, default: Any, kind: type | None) -> bool:
    """Whether a value of a request may stand in place of its default; `kind` is that of a value beside None."""
    if isinstance(value, bool) and not isinstance(default, bool):
        return False
    if default is None:
        return value is None or isinstance(value, int | float if kind is float else kind or ())
    if isinstance(default, tuple):
        return isinstance(value, list | tuple) and all(isinstance(each, str) for each in value)
    if isinstance(default, Mapping):
        numbers = value.values() if isinstance(value, Mapping) else [None]
        return all(isinstance(each, int | float) and not isinstance(each, bool) for each in numbers)
    if isinstance(default, float):
        return isinstance(value, int | float)
    return type(value) is type(default) and (not isinstance(value, int) or value >= 0)  # counts and a seed


@dataclass(frozen=True)
class Prepared:
    """What a request stands for, its files loaded and checked."""

    request: Request
    base: Base
    space: Space
    plan: Plan  # of the scenario as it is
    design: Design | None  # None: the variants depend on the results
    against: Base | None  # with the other ECU; None: there is none


def prepared(request: Request) -> Prepared:
    """Load the files of a request, and check it. Raises ConfigError with all issues."""
    job = _job_of(request)
    plan = plan_of(job)
    if plan.ticks is None:
        raise ConfigError(f"{request.scenario}: duration: missing; allowed: in the scenario, or `duration`")
    assert isinstance(job.request.vehicle, VehicleFile)  # see _job_of
    content = job.request.vehicle.raw
    space = space_of(request.vary, _parameters_of(job, plan), plan.setup.vehicle, content)
    _check_once(request, space)
    if request.ideal and any(each.kind == DRAW for each in space.targets):
        raise ConfigError("`vary` draw: allowed without `ideal`, which has no spread")
    base = base_of(plan, space.targets)
    check_columns(base)
    design = None
    if request.kind == DESIGN:
        design = Design(space, request.samples, request.method or DEFAULT_METHOD, request.sampling_seed)
    else:
        check_expectation(request, base, {each.name: each for each in plan.setup.scenario.expectations})
    against = _against(request, base) if request.against else None
    return Prepared(request, base, space, plan, design, against)


def _parameters_of(job: Job, plan: Plan) -> dict[str, str]:
    """Return the parameters of the scenario with their units; "": unknown."""
    assert isinstance(job.request.scenario, ScenarioFile)  # see _job_of
    units = parameter_units(part.raw for part in job.request.scenario.parts)
    return {name: units.get(name, "") for name in plan.setup.scenario.parameters}


def units_of(found: Prepared) -> dict[str, str]:
    """Return the unit of each varied name, in their order; "": none, or it is not known."""
    return {each.name: each.unit for each in found.space.targets}


def inputs_of(found: Prepared) -> list[Path]:
    """Return the files of a request, with the library of the other ECU, none of which a campaign writes."""
    return [*found.plan.inputs, *([] if found.against is None else [Path(found.request.against)])]


def _check_once(request: Request, space: Space) -> None:
    """Raise ConfigError where something is both varied and given."""
    given = {*request.parameters, *(each.partition("=")[0].strip() for each in request.settings)}
    given |= {"seed"} if request.seed is not None else set()
    given |= {"draw"} if request.draw is not None else set()
    twice = [name for name in space.names if name in given]
    if twice:
        raise ConfigError(f"`vary` {', '.join(twice)}: varied, and given by another flag; allowed: one of the two")


def check_expectation(request: Request, base: Base, expectations: Mapping[str, Expectation]) -> None:
    """Raise ConfigError where the scenario has no expectation of the name, or it has no margin."""
    if request.expectation not in base.expectations:
        known = ", ".join(base.expectations) or "none, the scenario has no [[expect]]"
        raise ConfigError(f"`{request.kind}` {request.expectation}: allowed: {known}")
    if expectations[request.expectation].kind == "dtc":
        raise ConfigError(
            f"`{request.kind}` {request.expectation}: a trouble code has no margin; allowed: one with it"
        )
    if not base.targets:
        raise ConfigError(f"`{request.kind}` {request.expectation}: allowed: together with `vary`")
    if request.kind == PROBABILITY and 0 < request.evaluations < LEAST_OF_A_PROBABILITY:
        raise ConfigError(f"`evaluations` {request.evaluations}: allowed: {LEAST_OF_A_PROBABILITY} or more")


def _against(request: Request, base: Base) -> Base:
    """Return the base of the other ECU, for the same values. Raises ConfigError."""
    ecu, mutant = ecu_of(request.against, "against")
    return base_of(plan_of(replace(base.job.asking(ecu=ecu), mutant=mutant)), base.targets)


def _job_of(request: Request) -> Job:
    ecu, mutant = ecu_of(request.ecu, "ecu")
    path = find_config("scenarios", request.scenario)
    file = read_scenario(path)
    scenario = scenario_of(file, request.parameters)
    called = f"{scenario.source}: vehicle" if scenario.vehicle and request.vehicle is None else ""
    name = request.vehicle or scenario.vehicle or "suv"
    run = RunRequest(
        scenario=file,
        ecu=ecu,
        parameters=dict(request.parameters),
        vehicle=read_vehicle(find_config("vehicles", name, called), name),
        rig=rig_of(request.rig, scenario),
        settings=tuple(request.settings),
        seed=request.seed,
        draw=request.draw,
        ideal=request.ideal,
        rate=request.rate,
        duration=request.duration,
    )
    return Job(run, mutant=mutant)


def ecu_of(name: str, called: str) -> tuple[str, str]:
    """Return the ECU and the mutant of a name, see `ecu_and_mutant`. Raises ConfigError."""
    if name == ON_A_BUS:
        raise ConfigError(f"`{called}` {name}: allowed: reference, mutant:NAME, a library, MODULE:CLASS")
    ecu, mutant = ecu_and_mutant(name, called)
    try:
        check_ecu(ecu)
    except ConfigError as error:
        raise ConfigError([line.replace("`ecu`", f"`{called}`", 1) for line in error.issues]) from None
    return ecu, mutant


def absolute(request: Request) -> Request:
    """Return the request with absolute paths of files, so that it holds from any folder."""

    def whole(name: str | None) -> str | None:
        return str(Path(name).resolve()) if name and Path(name).is_file() else name

    return replace(
        request,
        scenario=whole(request.scenario) or request.scenario,
        vehicle=whole(request.vehicle),
        rig=whole(request.rig),
        ecu=whole(request.ecu) or request.ecu,
        against=whole(request.against) or request.against,
    )
