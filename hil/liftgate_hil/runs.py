"""A run of a scenario against an ECU: `liftgate_hil.run`, and what it gives.

import liftgate_hil as lh
result = lh.run("demo", ecu="reference", clock="free")
result.maxima["pinch_force_n"]
"""

from __future__ import annotations

import contextlib
import functools
import math
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil import session
from liftgate_hil.compiling import told_of_compiling
from liftgate_hil.config.arguments import (
    numbers_of,
    paths_of,
    size_of,
    text_or_none,
    texts_of,
)
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.rig_fit import notes_on_fit
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.sources import Source, sources_of
from liftgate_hil.config.variant import AS_FILED, Variant
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.events import Event
from liftgate_hil.ecu.find import ON_A_BUS, adapter_for, check_ecu, is_library
from liftgate_hil.ecu.identity import identity_of
from liftgate_hil.ecu.mutants import mutant_ecu
from liftgate_hil.ecu.node import NO_ECU
from liftgate_hil.ecu.peer import Peer
from liftgate_hil.emulator import Emulator
from liftgate_hil.errors import (
    ConfigError,
    EcuError,
    LiftgateError,
    OverrunError,
    PreconditionError,
    causes,
)
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.sketch import Sketch, Sketcher
from liftgate_hil.judging.verdict import Verdict, worst
from liftgate_hil.listener import Listener
from liftgate_hil.loop.closed_loop import Episode, Extremes, Trace
from liftgate_hil.loop.lookout import Lookout
from liftgate_hil.loop.precondition import gone_through
from liftgate_hil.loop.recorder import RecordingTaker, Taker
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.origin import origin_of
from liftgate_hil.preparation import phases_of
from liftgate_hil.recording.content import Content
from liftgate_hil.recording.trigger import Triggered
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS, columns_of
from liftgate_hil.staging import expected_in, staged, trigger_in
from liftgate_hil.transport.can_arguments import WireChoice
from liftgate_hil.transport.find import Way, find_way, open_transport
from liftgate_plant.compiler import GivenUpError
from liftgate_plant.vehicle import Vehicle

if TYPE_CHECKING:
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.tick import LoopConfig, LoopState
    from liftgate_hil.stimuli.scene import Scene


_PRIVATE = "virtual"  # what recordings call a bus that is in this process alone
_WORKER = "liftgate_hil.worker"  # that runs a job in a process of its own


@dataclass(frozen=True)
class Result:
    """What a run showed. `maxima` and `minima` hold every column of recordings, in its unit."""

    verdict: str  # the worst of its expectations'; "error": the run did not come to its end
    reason: str  # why not
    maxima: Mapping[str, float]
    minima: Mapping[str, float]
    events: Sequence[Event]  # what the ECU told, where it is the reference ECU
    summary: Summary
    recording: tuple[Path, ...] = ()
    pinch_time_s: float = math.nan  # of the largest pinch force; NaN: nothing was pinched
    expectations: Mapping[str, Verdict] = field(default_factory=dict)
    sources: Mapping[str, Source] = field(default_factory=dict)  # vehicle, rig, dbc, scenario, ecu
    trace: Mapping[str, NDArray[np.float64]] = field(
        default_factory=dict
    )  # every row, if asked for
    sketches: Mapping[str, Sketch] = field(default_factory=dict)  # by expectation, if asked for


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
    is_sketched: bool = False  # keep what pictures of the expectations need


def run(
    scenario: str | Path | Scenario | None = None,
    ecu: Any = "reference",
    clock: str = "free",
    parameters: Mapping[str, float] | None = None,
    *,
    vehicle: str | Path | Vehicle | None = None,
    rig: str | Path | Rig | None = None,
    settings: Sequence[str] = (),
    initial: float | str | None = None,
    seed: int | None = None,
    draw: int | None = None,
    ideal: bool = False,
    rate: float = 1000.0,
    duration: float | None = None,
    record: str | Path | Sequence[str | Path] = (),
    record_limit: int | str | None = None,
    record_keep: int | None = None,
    record_when: str | Sequence[str] = (),
    record_before: float | None = None,
    record_after: float | None = None,
    bus: str | None = None,
    wall_timeout: float | None = None,
    trace: bool = False,
) -> Result:
    """Run a scenario (a shipped name, a file, or one that was loaded) against an ECU.

    `ecu` is "reference", the path of a C library, "module:Class" of a Python object, an object, or "bus" for one
    on `bus` (INTERFACE:CHANNEL). `clock` is "free" (waits for nobody, so for no real bus),
    "lockstep" or "realtime".
    `parameters` replace the scenario's, `settings` (KEY=VALUE) the vehicle's keys; `vehicle`, `rig`, `initial`
    ("closed", "open" or degrees) and `seed` win over the scenario's. `draw` and `ideal` say which car of the
    vehicle's file, see `load_vehicle`. `rate` [Hz], `duration` [s of model time],
    files to `record`, each in parts of at most `record_limit` (bytes, "500MB"), of which the last `record_keep`
    stay; with `record_when`, conditions, only from `record_before` to `record_after` [s] around the ticks in which
    one is true. `trace`: keep every row. A C library runs in a process of its own.

    Raises ConfigError for what cannot be meant. What goes wrong in the run itself is the result's verdict.
    """
    from liftgate_hil.recording.open import check_file

    if clock not in session.CLOCKS:
        raise ConfigError(f"`clock` {clock}: allowed: {', '.join(session.CLOCKS)}")
    bus = text_or_none("bus", bus)
    options = session.RunOptions(
        rate=rate,
        clock=clock,
        duration=duration,
        records=tuple(check_file("record", name) for name in paths_of("record", record)),
        record_limit=size_of("record_limit", record_limit),
        record_keep=record_keep,
        record_when=(record_when,)
        if isinstance(record_when, str)
        else texts_of("record_when", record_when),
        record_before=record_before,
        record_after=record_after,
        wall_timeout=wall_timeout,
    )
    job = Job(
        scenario=scenario,
        ecu=ecu,
        parameters=numbers_of("parameters", parameters),
        vehicle=vehicle,
        rig=rig,
        settings=texts_of("settings", settings),
        initial=initial,
        seed=seed,
        variant=session.variant_of(draw, ideal),
        wire=None if bus is None else WireChoice(bus=bus),
        options=options,
        trace=int(trace),
    )
    return execute(job)


def execute(
    job: Job, stopped: Callable[[], bool] = lambda: False, parts: Parts | None = None
) -> Result:
    """Run a job, in a process of its own where its ECU may crash; `parts` are its objects, if there already.

    Raises ConfigError.
    """
    parts = parts or resolve(job)  # what is wrong with the job is told here
    for note in notes_on_fit(parts.rig, parts.setup.vehicle, parts.options.rate):
        job.listener.say(f"note: {note}")
    if job.is_isolated or is_library(job.ecu):
        result = _isolated(job, stopped)
    else:
        result = run_job(job, (), stopped, parts=parts)
    return replace(result, sources=parts.sources)


def _isolated(job: Job, stopped: Callable[[], bool]) -> Result:
    """Run a job in a process of its own. Raises ConfigError."""
    from liftgate_hil.isolation import run_isolated

    check_ecu(job.ecu)
    ticks = 0
    try:
        sent = pickle.dumps(job)
        answer = pickle.loads(run_isolated(_WORKER, sent, 1.0 / job.options.rate, stopped))
    except EcuError as error:
        answer, ticks = error, error.ticks
    if isinstance(answer, EcuError):  # it could not be made, crashed or hung
        return _nothing(job, str(answer), ticks)
    if isinstance(answer, LiftgateError):
        raise answer
    assert isinstance(answer, Result)
    return answer


def _nothing(job: Job, reason: str, ticks: int) -> Result:
    """Of a run of which no more is known than how long it was."""
    nothing = dict.fromkeys(COLUMNS, math.nan)
    return Result(
        verdict="error" if reason else "pass",
        reason=reason,
        maxima=nothing,
        minima=nothing,
        events=(),
        summary=Summary(
            clock=job.options.clock, ticks=ticks, model_time_s=ticks / job.options.rate
        ),
        recording=job.options.records,
        trace=Trace(job.trace).columns() if job.trace else {},
    )


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
    if is_library(job.ecu):
        files["ecu"] = Path(job.ecu)
    return files


def run_job(
    job: Job,
    takers: Sequence[Taker] = (),
    stopped: Callable[[], bool] = lambda: False,
    memory: Memory | None = None,
    parts: Parts | None = None,
) -> Result:
    """Run a job in this process; `takers` get its rows and frames, others may see its loop's `memory`.

    Raises ConfigError.
    """
    parts = parts or resolve(job)
    try:
        with told_of_compiling(job.listener, stopped):
            return _run(job, takers, stopped, memory, parts)
    except GivenUpError:  # stopped before it began
        return _nothing(job, "", 0)


def _run(
    job: Job,
    takers: Sequence[Taker],
    stopped: Callable[[], bool],
    memory: Memory | None,
    parts: Parts,
) -> Result:
    seen: list[Taker] = [Extremes(), *takers]
    judge = _judge_of(parts)
    if judge is not None:
        seen.append(judge)
        if job.is_sketched:
            seen.append(Sketcher(judge, parts.options.rate))
    if job.trace:
        seen.append(Trace(job.trace))
    if job.ecu == ON_A_BUS:
        nobody = Adapter(parts.rig, parts.setup.vehicle.drives)
        return _on_bus(job, parts, nobody, seen, stopped, memory)
    with contextlib.ExitStack() as stack:
        with _foreign_code(memory):
            car = parts.setup.vehicle
            if job.mutant:
                adapter = mutant_ecu(job.mutant, parts.rig, car.drives, car.coding)
            else:
                adapter = adapter_for(job.ecu, parts.rig, car.drives, coding=car.coding)
        stack.callback(_close, adapter, memory)
        if job.options.clock == "free":
            return _free(job, parts, adapter, seen, stopped, memory)
        return _on_bus(job, parts, adapter, seen, stopped, memory)


@contextlib.contextmanager
def _foreign_code(memory: Memory | None) -> Iterator[None]:
    """Say in the memory, as far as somebody looks at it, that an ECU's own code runs, which may hang."""
    if memory is None:
        yield
        return
    memory.shared.control.foreign += 1
    try:
        yield
    finally:
        memory.shared.control.foreign += 1


def _judge_of(parts: Parts) -> Judge | None:
    """What judges the run, where anything is expected of it. Raises ConfigError."""
    scenario, options = parts.setup.scenario, parts.options
    if not scenario.expectations:
        return None
    expected = expected_in(parts.setup, parts.rig)
    duration = scenario.duration if options.duration is None else options.duration
    end = math.inf if duration is None else duration
    return Judge(expected, options.rate, end, tolerance_of(scenario, parts.rig))


def tolerance_of(scenario: Scenario, rig: Rig) -> float:
    """How long [s] a frame may wait until the gate picks it up."""
    given = scenario.timing_tolerance
    return 0.5e-3 * rig.command_cycle_ms() if given is None else given


def _close(adapter: Adapter, memory: Memory | None) -> None:
    with _foreign_code(memory):
        adapter.close()


class _Progress:
    """Says in the memory how far a loop has come that has a memory of its own."""

    def __init__(self, memory: Memory) -> None:
        self._control = memory.shared.control[0]

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """See Taker."""
        self._control.tick += len(rows)


def _free(
    job: Job,
    parts: Parts,
    adapter: Adapter,
    takers: Sequence[Taker],
    stopped: Callable[[], bool],
    memory: Memory | None,
) -> Result:
    """In machine code, as fast as it goes."""
    from liftgate_hil.recording.guarded import failures_of
    from liftgate_hil.recording.open import open_recorders

    options, setup = parts.options, parts.setup
    scenario = setup.scenario
    config = session.loop_config_of(setup.vehicle, parts.rig, options.rate, setup.seed)
    ticks = session.ticks_of(
        scenario.duration if options.duration is None else options.duration, options.rate
    )
    if ticks is None:
        raise ConfigError("`duration`: missing; allowed: in the scenario, or given")
    reason = ""
    about = origin_of(setup, parts.rig, options, _identity(job, setup))
    content = Content(columns_of(setup.vehicle.drives), _PRIVATE, about=about)
    with contextlib.ExitStack() as stack:
        say = job.listener.say
        recorders = open_recorders(options.records, content, options.limit(), say, stack)
        trigger = trigger_in(setup, parts.rig, options)
        triggered = None if trigger is None else Triggered(trigger)
        recording = RecordingTaker(recorders, sieve=triggered)
        stack.callback(recording.flush)
        if recorders:
            takers = [*takers, recording]
        try:
            scene, start = _begin(parts, config, adapter, stopped, memory)
        except PreconditionError as error:
            return result_of(takers, adapter, Summary(clock="free"), "", str(error))
        except LiftgateError as error:
            return _nothing(job, "; ".join(causes(error)), 0)
        episode = Episode(
            config,
            start,
            scene,
            adapter,
            takers,
            is_recorded=bool(recorders)
            or any(isinstance(each, Judge) and each.reads_the_bus for each in takers),
            memory=memory,
        )
        # Too fast for a story: the result has it.
        before, reception = int(scene.origin[0]), episode.state.reception
        episode.lookout = Lookout(parts.rig, config, reception, job.listener, ticks_before=before)
        stack.callback(episode.close)
        try:
            job.listener.starts(f"{setup.vehicle_name} on no bus")
            episode.begin()
            with _foreign_code(memory):
                episode.run(ticks, stopped)
                episode.finish()
        except LiftgateError as error:
            reason = "; ".join(causes(error))
        summary = episode.summary(parts.rig.bitrate)
    summary.recordings = [file for each in recorders for file in each.files]
    if triggered is not None:
        summary.recording_windows = triggered.count
    reason = "; ".join([*([reason] if reason else []), *failures_of(recorders)])
    return result_of(takers, adapter, summary, reason)


def _identity(job: Job, setup: session.Setup) -> Mapping[str, Any]:
    """What recordings say of the ECU."""
    ecu = job.ecu if job.ecu_elsewhere is None else job.ecu_elsewhere
    return identity_of(ecu, setup.vehicle.coding, job.mutant)


def _begin(
    parts: Parts,
    config: LoopConfig,
    adapter: Adapter,
    stopped: Callable[[], bool],
    memory: Memory | None,
) -> tuple[Scene, LoopState]:
    """The scene at its time 0, and the loop there. Raises what `gone_through` raises."""
    setup, is_on_bus = parts.setup, adapter.kind == NO_ECU
    scene = staged(setup, parts.rig, is_on_bus)
    state = session.start_of(config, setup.start_angle)
    if is_on_bus:  # what goes before is on the wire
        return scene, state
    actions, guard = setup.scenario.precondition, functools.partial(_foreign_code, memory)
    return scene, gone_through(config, state, scene, adapter, actions, stopped, guard)


def _on_bus(
    job: Job,
    parts: Parts,
    adapter: Adapter,
    takers: Sequence[Taker],
    stopped: Callable[[], bool],
    memory: Memory | None,
) -> Result:
    """On a bus: in lockstep with an ECU, in real time, or without waiting for anybody."""
    reason = ""
    way = parts.way or find_way(WireChoice(bus=f"virtual:run-{id(parts):x}"), parts.rig)
    with contextlib.ExitStack() as stack:
        peers = []
        try:
            config = session.loop_config_of(
                parts.setup.vehicle, parts.rig, parts.options.rate, parts.setup.seed
            )
            scene, start = _begin(parts, config, adapter, stopped, memory)
        except PreconditionError as error:
            return result_of(takers, adapter, Summary(clock=job.options.clock), "", str(error))
        except LiftgateError as error:
            return _nothing(job, "; ".join(causes(error)), 0)
        if job.ecu != ON_A_BUS:
            wire = open_transport(way)
            stack.callback(wire.close)
            guard = functools.partial(_foreign_code, memory)
            before_ns = int(scene.origin[0]) * round(session.NS / parts.options.rate)
            peers = [Peer(adapter, wire, (scene.requests, scene.moments), guard, before_ns)]
        emulator = Emulator(
            setup=parts.setup,
            rig=parts.rig,
            way=way,
            options=parts.options,
            scene=scene,
            start=start,
            phases=[] if peers else phases_of(parts.setup, parts.rig, 1.0 / parts.options.rate),
            peers=peers,
            ecu=_identity(job, parts.setup),
            channel="" if parts.way else _PRIVATE,
            takers=takers if memory is None else [*takers, _Progress(memory)],
            listener=job.listener,
            events=adapter.events,
            stopped=stopped,
        )
        try:
            emulator.run()
        except ConfigError:
            raise
        except PreconditionError as error:
            return result_of(takers, adapter, emulator.summary, "", str(error))
        except LiftgateError as error:
            reason = "; ".join(causes(error))
            if isinstance(error, OverrunError) and job.options.clock == "realtime":
                late = f"the bench was late: {reason}"
                return result_of(takers, adapter, emulator.summary, "", late)
    return result_of(takers, adapter, emulator.summary, reason, _not_made(parts))


def _lateness(summary: Summary, extremes: Extremes) -> str:
    """How the bench was late beside what its rows tell; "": it was not, or has no clock to be late by."""
    if summary.clock != "realtime" or extremes.high is None:
        return ""
    untold = summary.link.dropped - int(extremes.high[COLUMN_PLACE["frames_dropped"]])
    return f"the bench was late: {untold} frames dropped" if untold > 0 else ""


def _not_made(parts: Parts) -> str:
    """Which faults that were asked for this bus cannot make; "": none."""
    if parts.way is None or parts.way.is_interface("virtual"):
        return ""
    found = [each.key for each in parts.setup.scenario.faults if each.kind == "bus_off"]
    said = "a real controller cannot be taken off its bus from here"
    return "; ".join(f"{key}: bus_off: {said}" for key in found)


def result_of(
    takers: Sequence[Taker],
    adapter: Adapter,
    summary: Summary,
    reason: str,
    not_made: str = "",
) -> Result:
    """What the takers have seen; `not_made` are faults that the bus cannot make."""
    extremes = next(each for each in takers if isinstance(each, Extremes))
    trace = next((each.columns() for each in takers if isinstance(each, Trace)), {})
    judge = next((each for each in takers if isinstance(each, Judge)), None)
    verdicts = (
        judge.verdicts(reason, not_made or _lateness(summary, extremes))
        if judge is not None
        else []
    )
    high = extremes.high if extremes.high is not None else np.full(len(COLUMNS), np.nan)
    low = extremes.low if extremes.low is not None else high
    return Result(
        verdict="error" if reason else worst(each.verdict for each in verdicts),
        reason=reason,
        expectations={each.name: each for each in verdicts},
        maxima=dict(zip(COLUMNS, high.tolist(), strict=True)),
        minima=dict(zip(COLUMNS, low.tolist(), strict=True)),
        events=adapter.events(),
        summary=replace(summary, ecu_dropped_frames=adapter.dropped()),
        recording=tuple(map(Path, summary.recordings)),
        pinch_time_s=extremes.pinch_time,
        trace=trace,
        sketches=next((each.sketches() for each in takers if isinstance(each, Sketcher)), {}),
    )
