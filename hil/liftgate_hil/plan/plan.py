"""Plan of a run, prepared once: its loop's start (constants, state, stimuli), expectations, recording trigger."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.codec.transmit import message_of
from liftgate_hil.config.bus_fault import located
from liftgate_hil.config.fault_kinds import FAULT_KINDS, MESSAGE
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.rig_fit import NS, check_fit
from liftgate_hil.config.scenario import Scenario, begins
from liftgate_hil.config.scenario_tables import Fault
from liftgate_hil.config.sources import Source, sources_of
from liftgate_hil.ecu.find import check_ecu
from liftgate_hil.ecu.mutants import identity_of
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.errors import ConfigError
from liftgate_hil.judging.expected import Expected, PreconditionEnd, expected_of
from liftgate_hil.judging.stimulus_times import TimedFault
from liftgate_hil.loop.datagrams import POSSIBLE
from liftgate_hil.loop.episode import LoopStart
from liftgate_hil.loop.tick import EDGES, LoopConfig, LoopState, initial_loop
from liftgate_hil.plan.recording_trigger import Trigger, trigger_of
from liftgate_hil.plan.request import Job, RunRequest, ticks_of
from liftgate_hil.plan.setup import Setup, setup_and_rig
from liftgate_hil.plan.stimulation import opening_of, planned_stimuli
from liftgate_hil.signals import OUT
from liftgate_hil.stimuli.command_queue import CLOSED, Opening
from liftgate_hil.transport.find import Way, find_way
from liftgate_plant.faults import SOUND
from liftgate_plant.friction_profile import friction_profile
from liftgate_plant.initial import closed_state, initial_state
from liftgate_plant.vehicle import Vehicle, load_of, plant_of


@dataclass(frozen=True)
class Subject:
    """Subject of a report: the job of a run, with the setup and the rig that the job names."""

    job: Job
    setup: Setup
    rig: Rig
    sources: Mapping[str, Source]  # the files that these were made from

    @property
    def request(self) -> RunRequest:
        """Request of the job."""
        return self.job.request

    @property
    def duration(self) -> float | None:
        """Model time of the run [s]: the job's, or else the scenario's; None: the run lasts until stopped."""
        given = self.request.duration
        return self.setup.scenario.duration if given is None else given

    @property
    def inputs(self) -> list[Path]:
        """Input files of the run, to which no run may write."""
        return [*(Path(each.path) for each in self.sources.values()), *self.setup.inputs]

    @property
    def ecu_identity(self) -> Mapping[str, Any]:
        """Identity of the ECU for recordings."""
        return _identity_of(self.job, self.setup)


@dataclass(frozen=True)
class Plan(Subject):
    """Plan of a run: all that it needs, validated. A plan of several runs lends each a copy of `start`."""

    way: Way | None  # of the wire; None: there is none
    start: LoopStart  # the gate at rest; the scenario's precondition, if any, comes before its time 0
    opening: Opening  # what may be injected while it runs
    expected: Expected
    trigger: Trigger | None  # None: all of the run is recorded

    @property
    def ticks(self) -> int | None:
        """Number of ticks of the run; None: the run lasts until it is stopped."""
        return ticks_of(self.duration, self.request.rate)

    def varied(self, job: Job | None = None, setup: Setup | None = None) -> Plan:
        """Return this plan with another job or setup of the same files, not read again. Raises ConfigError."""
        job = self.job if job is None else job
        own, others = (each.request.replaced(record=()) for each in (self.job, job))
        if setup is None and own == others and job.attachable_as == self.job.attachable_as:
            return replace(self, job=job)
        return planned(job, setup or self.setup, self.rig, self.way, self.sources, self)


def plan_of(job: Job) -> Plan:
    """Build the plan of a job, completed from its scenario. Raises ConfigError with all issues."""
    check_ecu(job.request.ecu if job.ecu_elsewhere is None else job.ecu_elsewhere)
    setup, rig = setup_and_rig(job.request)
    job.request.check()
    way = None if job.wire is None else find_way(job.wire, rig)
    files = {"rig": Path(rig.source), "dbc": rig.database, **setup.files}  # none of what a program made
    if (ecu := _identity_of(job, setup).get("path")) is not None:
        files["ecu"] = Path(ecu)
    return planned(job, setup, rig, way, sources_of(files))


def planned(
    job: Job, setup: Setup, rig: Rig, way: Way | None, sources: Mapping[str, Source], other: Plan | None = None
) -> Plan:
    """Plan a job; with `other`, of the same rig, reuse its constants if they are alike. Raises ConfigError."""
    request = job.request
    if way is None and request.ecu == ON_A_BUS:
        raise ConfigError("`bus`: missing; allowed: INTERFACE:CHANNEL of the bus with the ECU")
    if request.clock == "realtime" and not POSSIBLE:
        text = "64-bit little-endian Linux; free and lockstep run everywhere"
        raise ConfigError(f"`clock` realtime: not possible on this platform; allowed: {text}")
    if request.clock == "free" and way is not None and not way.is_interface("virtual"):
        raise ConfigError("`clock` free: allowed without a bus, or on a virtual one")
    if job.ecu_elsewhere is not None:  # it gets requests by its own clock: no preconditions
        setup = replace(setup, scenario=replace(setup.scenario, precondition=()))
    issues = _periods(setup.scenario, request.rate)

    def fitted(make: Callable[[], Any]) -> Any:
        try:
            return make()
        except ConfigError as error:
            issues.extend(line for line in error.issues if line not in issues)
            return None

    is_on_bus = request.ecu == ON_A_BUS
    opening = CLOSED if job.is_episode else opening_of(rig, job.attachable_as is not None)
    stimuli = fitted(lambda: planned_stimuli(setup, rig, is_on_bus, opening=opening))
    expected = fitted(lambda: expected_in(setup, rig))
    trigger = fitted(lambda: trigger_in(setup, rig, request))
    if issues:
        raise ConfigError(issues)
    made_from = setup.vehicle, setup.seed, request.rate
    if other is not None and (other.setup.vehicle, other.setup.seed, other.request.rate) == made_from:
        config = other.start.config
    else:
        config = loop_config_of(setup.vehicle, rig, request.rate, setup.seed)
    start = LoopStart(config, start_of(config, setup.start_angle), stimuli)
    return Plan(job, setup, rig, sources, way, start, opening, expected, trigger)


def loop_config_of(vehicle: Vehicle, rig: Rig, rate: float, seed: int) -> LoopConfig:
    """Return the constants of a loop at a rate [Hz]. Raises ConfigError where the rig does not fit."""
    check_fit(rig, vehicle, rate)
    mapped = {mapping.quantity for mapping in rig.inputs}
    outputs = rig.output_config()
    plant = plant_of(vehicle)
    return LoopConfig(
        plant=plant,
        sensors=vehicle.sensors,
        friction=friction_profile(vehicle, plant, seed),
        load=load_of(vehicle),
        faults=SOUND,
        inputs=rig.input_config(),
        outputs=outputs,
        signed_left=int("left_direction" not in mapped),
        signed_right=int("right_direction" not in mapped),
        latch_mapped=int("latch_release" in mapped),
        hold_message=message_of(outputs, OUT.pinch_force_max),
        obstacle_distance=vehicle.gate.length,
        step=1.0 / rate,
        step_ns=round(NS / rate),
        seed=seed,
        nothing=empty_frames(0),
    )


def loop_start_of(setup: Setup, rig: Rig, rate: float, opening: Opening = CLOSED, edges: int = EDGES) -> LoopStart:
    """Return a loop at rest with a setup's stimuli, for an ECU in this process. Raises ConfigError."""
    config = loop_config_of(setup.vehicle, rig, rate, setup.seed)
    state = start_of(config, setup.start_angle, edges)
    return LoopStart(config, state, planned_stimuli(setup, rig, opening=opening))


def start_of(config: LoopConfig, angle: float = 0.0, edges: int = EDGES) -> LoopState:
    """Return a loop's state with room for `edges` Hall edges; its gate rests at `angle` [rad], latched at 0."""
    is_closed = angle == 0.0
    state = closed_state(config.plant, config.load) if is_closed else initial_state(config.plant, angle)
    return initial_loop(config, state, edges)


def _periods(scenario: Scenario, rate: float) -> list[str]:
    """Return an issue for each intermittent fault whose on or off time is shorter than a tick."""
    found = []
    for each in scenario.faults:
        shares = [share for share in (each.share, 1.0 - each.share) if share > 0.0]
        if each.period and min(shares) * each.period * rate < 1.0 - 1e-9:
            text = f"on or off for less than a tick of {1e3 / rate:g} ms"
            found.append(f"{each.called('period_s')}: {each.period:g}: {text}; allowed: at least a tick of each")
    return found


def _identity_of(job: Job, setup: Setup) -> Mapping[str, Any]:
    ecu = job.request.ecu if job.ecu_elsewhere is None else job.ecu_elsewhere
    return identity_of(ecu, setup.vehicle.coding, job.mutant)


def expected_in(setup: Setup, rig: Rig) -> Expected:
    """Return a scenario's expectations for vehicle and rig. Raises ConfigError with all mismatches."""
    scenario = setup.scenario
    ends = {"open": math.degrees(setup.vehicle.gate.open_angle), "close": 0.0}
    last = next(reversed(scenario.precondition), "")
    return expected_of(
        scenario.expectations,
        scenario.parameters,
        rig.messages,
        setup.vehicle.drives,
        scenario.source,
        scenario.awaited(),
        rig.diagnostics,
        _timed_faults(scenario.faults, rig),
        begins(scenario),
        PreconditionEnd(last, ends[last]) if last in ends else None,
    )


def _timed_faults(faults: Sequence[Fault], rig: Rig) -> list[TimedFault]:
    """Return the faults' times in force, each with the time-out [s] (message's or command's) it must outlast."""
    if not rig.inputs:
        return []
    found = []
    for each in faults:
        bridge = rig.command_message()
        if FAULT_KINDS[each.kind].of == MESSAGE and each.where is not None:
            bridge = str(located(each, rig).where)
            if bridge not in rig.messages:  # which is reported with the fault's other issues
                continue
        least = 1e-3 * rig.timeout_ms(bridge)
        name = f"{each.key.partition(': ')[2] or each.key} ({each.kind})"
        found.append(TimedFault(name, each.start, each.end, each.length, least, bridge))
    return found


def trigger_in(setup: Setup, rig: Rig, request: RunRequest) -> Trigger | None:
    """Return the trigger of a run's recording; None: all is recorded. Raises ConfigError with all mismatches."""
    if not request.record_when:
        return None
    return trigger_of(
        request.conditions,
        *request.around(),
        request.rate,
        setup.scenario.parameters,
        rig.messages,
        setup.vehicle.drives,
    )
