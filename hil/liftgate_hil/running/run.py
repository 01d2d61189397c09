"""A run of a scenario against an ECU: `liftgate_hil.run`.

import liftgate_hil as lh
result = lh.run("demo", ecu="reference", clock="free")
result.maxima["pinch_force_n"]
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from liftgate_hil.config.after_the_end import stimuli_after
from liftgate_hil.config.arguments import numbers_of, text_or_none, texts_of
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.rig_fit import notes_on_fit
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.wire_choice import WireChoice
from liftgate_hil.ecu.find import is_library
from liftgate_hil.errors import EcuError, LiftgateError, shown
from liftgate_hil.running.job import Job
from liftgate_hil.running.options import RunOptions
from liftgate_hil.running.plan import Plan, plan_of
from liftgate_hil.running.result import Result, nothing_of
from liftgate_hil.running.run_plan import run_plan
from liftgate_hil.running.setup import variant_of
from liftgate_plant.vehicle import Vehicle

_WORKER = "liftgate_hil.running.worker"  # module that runs a job in a process of its own


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
    rate: float = RunOptions.rate,
    duration: float | None = None,
    record: str | Path | Sequence[str | Path] = (),
    record_limit: int | str | None = None,
    record_keep: int | None = None,
    record_when: str | Sequence[str] = (),
    record_before: float | None = None,
    record_after: float | None = None,
    bus: str | None = None,
    wall_timeout: float | None = None,
    realtime: bool | None = False,
    trace: bool = False,
) -> Result:
    """Run a scenario (a shipped name, a file, or a loaded one) against an ECU.

    `ecu` is "reference", the path of a C library, "module:Class" of a Python object, an object, or "bus" for one
    on `bus` (INTERFACE:CHANNEL). `clock` is "free" (as fast as possible, so not for a real bus), "lockstep" or
    "realtime". `parameters` replace the scenario's, `settings` (KEY=VALUE) the vehicle's keys; `vehicle`, `rig`,
    `initial` ("closed", "open" or degrees) and `seed` override the scenario's. `draw` and `ideal` select the
    variant of the vehicle's file, see `load_vehicle`. `rate` is in Hz, `duration` in s of model time.

    `record` names files, each in parts of at most `record_limit` (bytes, "500MB"), of which the last `record_keep`
    are kept; with `record_when`, conditions, only from `record_before` to `record_after` [s] around the ticks in
    which one is true. `trace`: keep every row. A C library runs in a process of its own. `realtime`: in real time,
    request FIFO scheduling, locked memory, a CPU and no deep sleep; None: the first two, where they are granted.

    Raises ConfigError for invalid arguments. What goes wrong in the run itself is the result's verdict.
    """
    bus = text_or_none("bus", bus)
    options = RunOptions.of(
        rate=rate,
        clock=clock,
        duration=duration,
        record=record,
        record_limit=record_limit,
        record_keep=record_keep,
        record_when=record_when,
        record_before=record_before,
        record_after=record_after,
        wall_timeout=wall_timeout,
        realtime=realtime,
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
        variant=variant_of(draw, ideal),
        wire=None if bus is None else WireChoice(bus=bus),
        options=options,
        trace=int(trace),
    )
    return execute(plan_of(job))


def execute(plan: Plan, stopped: Callable[[], bool] = lambda: False) -> Result:
    """Run a plan, in a process of its own where its ECU may crash. Raises ConfigError."""
    job = plan.job
    fit = notes_on_fit(plan.rig, plan.setup.vehicle, plan.options.rate)
    for note in fit:
        job.listener.say(f"note: {note}")
    if job.is_isolated or is_library(job.ecu):
        result = _isolated(plan, stopped)
    else:
        result = run_plan(plan, (), stopped)
    late = [] if plan.duration is None else stimuli_after(plan.setup.scenario, plan.duration)
    return replace(result, sources=plan.sources, notes=(*fit, *result.notes, *late))


def _isolated(plan: Plan, stopped: Callable[[], bool]) -> Result:
    """Run a plan in a process of its own. Raises ConfigError."""
    from liftgate_hil.running.isolation import run_isolated

    job = plan.job
    ticks, note = 0, ""
    answer: object
    try:
        sent = pickle.dumps(plan)
        payload, note = run_isolated(_WORKER, sent, 1.0 / job.options.rate, stopped)
        answer = _unpacked(payload)
    except EcuError as error:
        answer, ticks = error, error.ticks
    if isinstance(answer, EcuError):  # the ECU could not be created, crashed or hung
        return nothing_of(job, str(answer), ticks)
    if isinstance(answer, LiftgateError):
        raise answer
    assert isinstance(answer, Result)
    return replace(answer, notes=(*answer.notes, *([note] if note else [])))


def _unpacked(payload: bytes) -> object:
    """Return a worker's answer, unpickled. Raises EcuError where the ECU's code has spoiled it."""
    try:
        answer = pickle.loads(payload)
    except Exception as error:  # it may hold an object of the ECU's
        raise EcuError(f"the run's answer cannot be read: {type(error).__name__}: {error}") from error
    if not isinstance(answer, Result | LiftgateError):
        raise EcuError(f"the run's answer is {shown(answer)}")
    return answer
