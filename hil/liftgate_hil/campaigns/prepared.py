"""Preparation of a campaign: files of its request loaded and checked, and compared with one to resume."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from liftgate_hil.campaigns.base import Base, base_of
from liftgate_hil.campaigns.folder import MANIFEST, Folder
from liftgate_hil.campaigns.request import DEFAULT_METHOD, DESIGN, PROBABILITY, CampaignRequest
from liftgate_hil.campaigns.results import check_columns
from liftgate_hil.campaigns.space import DRAW, Design, Space, space_of
from liftgate_hil.config.parameter_units import parameter_units
from liftgate_hil.config.scenario import ScenarioFile, read_scenario
from liftgate_hil.config.shipped import DEFAULT_VEHICLE, find_config
from liftgate_hil.config.vehicle import VehicleFile, read_vehicle
from liftgate_hil.described_result import Shown
from liftgate_hil.ecu.find import check_ecu
from liftgate_hil.ecu.mutants import ecu_and_mutant
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.errors import ConfigError
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.plan.plan import Plan, plan_of
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.plan.setup import rig_of, scenario_of

LEAST_OF_A_PROBABILITY = 1200  # evaluations: with fewer, the levels of a small probability are chance


@dataclass(frozen=True)
class Prepared:
    """Prepared campaign: the objects that its request names, loaded and checked."""

    request: CampaignRequest
    base: Base
    space: Space
    plan: Plan  # of the scenario as it is
    design: Design | None  # None: the variants depend on the results
    against: Base | None  # with the other ECU; None: there is none


def prepared(request: CampaignRequest) -> Prepared:
    """Load and check all that a campaign's request names: files, ECUs, varied values. Raises ConfigError."""
    job = _job_of(request)
    plan = plan_of(job)
    if plan.ticks is None:
        raise ConfigError(f"{request.scenario}: duration: missing; allowed: in the scenario, or `duration`")
    assert isinstance(job.request.vehicle, VehicleFile)  # see _job_of
    assert isinstance(job.request.scenario, ScenarioFile)
    units = parameter_units(part.raw for part in job.request.scenario.parts)
    parameters = {name: units.get(name, "") for name in plan.setup.scenario.parameters}
    space = space_of(request.vary, parameters, plan.setup.vehicle, job.request.vehicle.raw)
    given = {*request.parameter_values, *(each.partition("=")[0].strip() for each in request.settings)}
    given |= {name for name, value in (("seed", request.seed), ("draw", request.draw)) if value is not None}
    if twice := [name for name in space.names if name in given]:
        raise ConfigError(f"`vary` {', '.join(twice)}: varied, and given by another flag; allowed: one of the two")
    if request.ideal and any(each.kind == DRAW for each in space.targets):
        raise ConfigError("`vary` draw: allowed without `ideal`, which has no spread")
    base = base_of(plan, space.targets)
    check_columns(base)
    design = None
    if request.kind == DESIGN:
        design = Design(space, request.samples or 0, request.method or DEFAULT_METHOD, request.sampling_seed)
    else:
        check_expectation(request, base, {each.name: each for each in plan.setup.scenario.expectations})
    against = None
    if request.against:
        ecu, mutant = ecu_of(str(request.against), "against")
        against = base_of(plan_of(job.asking(ecu=ecu)._replace(mutant=mutant)), base.targets)
    return Prepared(request, base, space, plan, design, against)


def units_of(found: Prepared) -> dict[str, str]:
    """Return the units by varied name, in order; "": none, or unknown."""
    return {each.name: each.unit for each in found.space.targets}


def inputs_of(found: Prepared) -> list[Path]:
    """Return the campaign's input files, the second ECU's library included, which it must not overwrite."""
    return [*found.plan.inputs, *([] if found.against is None else [Path(found.request.against or "")])]


def check_expectation(request: CampaignRequest, base: Base, expectations: Mapping[str, Expectation]) -> None:
    """Raise ConfigError where a search or estimate has a wrong expectation, no `vary` or too few evaluations."""
    if request.expectation not in base.expectations:
        known = ", ".join(base.expectations) or "none, the scenario has no [[expect]]"
        raise ConfigError(f"`{request.kind}` {request.expectation}: allowed: {known}")
    if expectations[request.expectation].kind == "dtc":
        raise ConfigError(
            f"`{request.kind}` {request.expectation}: a trouble code has no margin; allowed: one with it"
        )
    if not base.targets:
        raise ConfigError(f"`{request.kind}` {request.expectation}: allowed: together with `vary`")
    if request.kind == PROBABILITY and 0 < (request.evaluations or 0) < LEAST_OF_A_PROBABILITY:
        raise ConfigError(f"`evaluations` {request.evaluations}: allowed: {LEAST_OF_A_PROBABILITY} or more")


def _job_of(request: CampaignRequest) -> Job:
    ecu, mutant = ecu_of(str(request.ecu), "ecu")
    path = find_config("scenarios", str(request.scenario))
    file = read_scenario(path)
    scenario = scenario_of(file, request.parameters)
    called = f"{scenario.source}: vehicle" if scenario.vehicle and request.vehicle is None else ""
    name = str(request.vehicle or scenario.vehicle or DEFAULT_VEHICLE)
    run = RunRequest(
        scenario=file,
        ecu=ecu,
        parameters=request.parameter_values,
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
    """Return (ECU, mutant or "") of an ECU argument; `called` is its name in messages. Raises ConfigError."""
    if name == ON_A_BUS:
        raise ConfigError(f"`{called}` {name}: allowed: reference, mutant:NAME, a library, MODULE:CLASS")
    ecu, mutant = ecu_and_mutant(name, called)
    try:
        check_ecu(ecu)
    except ConfigError as error:
        raise ConfigError([line.replace("`ecu`", f"`{called}`", 1) for line in error.issues]) from None
    return ecu, mutant


def absolute(request: CampaignRequest) -> CampaignRequest:
    """Return the request with absolute file paths, so that it is valid in any working directory."""

    def whole(name: str | Path | None) -> str | None:
        return str(Path(name).resolve()) if name and Path(name).is_file() else None if name is None else str(name)

    names = ("scenario", "vehicle", "rig", "ecu", "against")
    return request.replaced(**{name: whole(getattr(request, name)) for name in names})


class Pace(NamedTuple):
    """Time per variant and number of workers, which determine batch sizes; kept when a campaign is resumed."""

    seconds_each: Annotated[
        float, Shown("time that a variant took in a trial before [s], from which batches are sized")
    ]
    workers: Annotated[int, Shown("number of workers")]


def pace_before(folder: Folder, found: Prepared, is_resumed: bool) -> Pace | None:
    """Return the pace of the campaign to resume in a folder; None: the folder has no campaign.

    Raises ConfigError where the folder has another campaign, or is not to be resumed.
    """
    if not folder.has_campaign:
        return None
    if not is_resumed:
        raise ConfigError(f"`output` {folder.path}: has a campaign; allowed: another folder, or `resume`")
    before = folder.manifest()
    wrong = differences(before, found)
    if wrong:
        raise ConfigError(
            f"`resume` {folder.path}: {', '.join(wrong)}: not as the campaign began; allowed: the same files, "
            "versions and arguments"
        )
    seconds, workers = before.get("seconds_each"), before.get("workers")
    is_pace = isinstance(seconds, float) and 0.0 < seconds < math.inf and type(workers) is int and workers > 0
    if not is_pace:
        raise ConfigError(
            f"{folder.path / MANIFEST}: seconds_each, workers: allowed: as the campaign has written them"
        )
    return Pace(before["seconds_each"], before["workers"])


def differences(before: Mapping[str, object], found: Prepared) -> list[str]:
    """Return the names of files, packages and arguments that differ from a manifest; empty: same campaign."""
    files, known, theirs = (_table(before.get(name)) for name in ("files", "versions", "request"))
    sources = found.plan.sources
    wrong = [name for name, each in sources.items() if _table(files.get(name)).get("sha256") != each.sha256]
    wrong += [name for name, each in found.base.versions.items() if known.get(name) != each]
    own = found.request.kept()
    wrong += [name for name, each in own.items() if theirs.get(name) != each]
    if not wrong and before.get("identity") != found.base.identity:
        wrong.append("a file that the scenario names")
    return wrong


def _table(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}
