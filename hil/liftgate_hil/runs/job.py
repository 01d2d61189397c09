"""A run as it is asked for: a job, said in plain values, and the objects that it names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from liftgate_hil import session
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.sources import Source, sources_of
from liftgate_hil.config.variant import AS_FILED, Variant
from liftgate_hil.ecu.find import ON_A_BUS
from liftgate_hil.ecu.identity import identity_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.listener import Listener
from liftgate_hil.staging import expected_in, staged, trigger_in
from liftgate_hil.transport.can_arguments import WireChoice
from liftgate_hil.transport.find import Way, find_way
from liftgate_plant.vehicle import Vehicle

PRIVATE_BUS = "virtual"  # what recordings call a bus that is in this process alone


@dataclass(frozen=True)
class Job:
    """A run, fully said; plain values where it may be, so that another process can be given it."""

    scenario: str | Path | Scenario | None
    ecu: Any
    parameters: Mapping[str, float] = field(default_factory=dict)
    vehicle: str | Path | Vehicle | None = None
    rig: str | Path | Rig | None = None
    settings: tuple[str, ...] = ()
    initial: float | str | None = None
    seed: int | None = None
    variant: Variant = AS_FILED  # of the vehicle
    wire: WireChoice | None = None  # None: the ECU is in this process, and so is the bus
    options: session.RunOptions = field(default_factory=session.RunOptions)
    trace: int = 0  # keep every so many rows; 0: none
    ecu_elsewhere: Any = None  # what `ecu` bus is, where this program runs it in another process
    mutant: str = ""  # of the reference ECU, see ecu/mutants.py
    is_isolated: bool = False  # in a process of its own, as C libraries always are
    listener: Listener = field(default_factory=Listener)
    attachable_as: int | None = None  # the process that others may attach to; None: they may not
    is_sketched: bool = False  # keep what pictures of the expectations need


@dataclass(frozen=True)
class Parts:
    """The objects of a job."""

    setup: session.Setup
    rig: Rig
    options: session.RunOptions
    way: Way | None  # of the wire, if there is to be one
    sources: Mapping[str, Source]  # the files among them


def resolve(job: Job) -> Parts:
    """The objects that a job names; the scenario gives what the job leaves open. Raises ConfigError."""
    setup = session.setup_of(
        job.scenario,
        parameters=job.parameters,
        vehicle=job.vehicle,
        settings=job.settings,
        initial=job.initial,
        seed=job.seed,
        variant=job.variant,
    )
    job.options.check()
    rig = session.rig_of(job.rig, setup.scenario)
    way = None if job.wire is None else find_way(job.wire, rig)
    if way is None and job.ecu == ON_A_BUS:
        raise ConfigError("`bus`: missing; allowed: INTERFACE:CHANNEL of the bus with the ECU")
    if job.options.clock == "free" and way is not None and not way.is_interface("virtual"):
        raise ConfigError("`clock` free: allowed without a bus, or on a virtual one")
    _check_stage(setup, rig, job.options, job.ecu == ON_A_BUS)
    return Parts(setup, rig, job.options, way, sources_of(_files_of(job, setup, rig)))


def _periods(scenario: Scenario, rate: float) -> list[str]:
    """Of intermittent faults, what ticks cannot show."""
    found = []
    for each in scenario.faults:
        shares = [share for share in (each.share, 1.0 - each.share) if share > 0.0]
        if each.period and min(shares) * each.period * rate < 1.0 - 1e-9:
            said = f"on or off for less than a tick of {1e3 / rate:g} ms"
            found.append(
                f"{each.key}.period_s: {each.period:g}: {said}; allowed: a tick or more of each"
            )
    return found


def _check_stage(
    setup: session.Setup, rig: Rig, options: session.RunOptions, is_on_bus: bool
) -> None:
    """Raise ConfigError with all of scenario and trigger that does not fit vehicle, rig or rate."""
    issues = _periods(setup.scenario, options.rate)
    for fit in (
        lambda: staged(setup, rig, is_on_bus),
        lambda: expected_in(setup, rig),
        lambda: trigger_in(setup, rig, options),
    ):
        try:
            fit()
        except ConfigError as error:
            issues += [line for line in error.issues if line not in issues]
    if issues:
        raise ConfigError(issues)


def _files_of(job: Job, setup: session.Setup, rig: Rig) -> dict[str, Path]:
    """The files that a job was made from; of objects that a program made there are none."""
    files = {"rig": Path(rig.source), "dbc": rig.database}
    vehicle = job.vehicle if job.vehicle is not None else setup.vehicle_name
    if isinstance(vehicle, str | Path):
        files["vehicle"] = find_config("vehicles", str(vehicle))
    if isinstance(job.scenario, str | Path):
        files["scenario"] = find_config("scenarios", str(job.scenario))
        for k, name in enumerate(setup.scenario.included, 1):
            files[f"included {k}"] = Path(name)
    path = identity_of_ecu(job, setup).get("path")
    return files if path is None else {**files, "ecu": Path(path)}


def identity_of_ecu(job: Job, setup: session.Setup) -> Mapping[str, Any]:
    """What recordings say of the ECU."""
    ecu = job.ecu if job.ecu_elsewhere is None else job.ecu_elsewhere
    return identity_of(ecu, setup.vehicle.coding, job.mutant)
