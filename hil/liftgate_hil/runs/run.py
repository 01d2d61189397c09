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

from liftgate_hil import session
from liftgate_hil.config.arguments import numbers_of, paths_of, size_of, text_or_none, texts_of
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.rig_fit import notes_on_fit
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.ecu.find import check_ecu, is_library
from liftgate_hil.errors import ConfigError, EcuError, LiftgateError, shown
from liftgate_hil.runs.in_process import run_job
from liftgate_hil.runs.job import Job, Parts, resolve
from liftgate_hil.runs.result import Result, nothing_of
from liftgate_hil.transport.can_arguments import WireChoice
from liftgate_plant.vehicle import Vehicle

_WORKER = "liftgate_hil.worker"  # that runs a job in a process of its own


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
    ticks, note = 0, ""
    answer: object
    try:
        sent = pickle.dumps(job)
        payload, note = run_isolated(_WORKER, sent, 1.0 / job.options.rate, stopped)
        answer = _unpacked(payload)
    except EcuError as error:
        answer, ticks = error, error.ticks
    if isinstance(answer, EcuError):  # it could not be made, crashed or hung
        return nothing_of(job, str(answer), ticks)
    if isinstance(answer, LiftgateError):
        raise answer
    assert isinstance(answer, Result)
    if note:
        job.listener.say(note)
    return replace(answer, notes=(*answer.notes, *([note] if note else [])))


def _unpacked(payload: bytes) -> object:
    """A worker's answer. Raises EcuError where the ECU's code has made something else of it."""
    try:
        answer = pickle.loads(payload)
    except Exception as error:  # an object of the ECU's may be in it
        raise EcuError(
            f"the run's answer cannot be read: {type(error).__name__}: {error}"
        ) from error
    if not isinstance(answer, Result | LiftgateError):
        raise EcuError(f"the run's answer is {shown(answer)}")
    return answer
