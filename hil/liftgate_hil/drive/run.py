"""A run of a scenario against an ECU: `liftgate_hil.run`.

import liftgate_hil as lh
result = lh.run("demo", ecu="reference", clock="free")
result.maxima["pinch_force_n"]
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace

from liftgate_hil.config.described import command
from liftgate_hil.config.rig_fit import notes_on_fit
from liftgate_hil.config.scenario import stimuli_after
from liftgate_hil.drive.result import Result, nothing_of
from liftgate_hil.drive.run_plan import run_plan
from liftgate_hil.ecu.find import is_library
from liftgate_hil.errors import EcuError, LiftgateError, shown
from liftgate_hil.plan.plan import Plan, plan_of
from liftgate_hil.plan.request import Job, RunRequest

_WORKER = "liftgate_hil.drive.worker"  # module that runs a job in a process of its own


@command(RunRequest)
def run(request: RunRequest) -> Result:
    """Run a scenario (a shipped name, a file, or a loaded one) against an ECU.

    `ecu` is "reference", the path of a C library, "module:Class" of a Python object, an object, or "bus" for one
    on `bus` (INTERFACE:CHANNEL). On the clock `free`, which is as fast as possible, there is no real bus. A C
    library runs in a process of its own. `realtime`: in real time, request FIFO scheduling, locked memory, a CPU
    and no deep sleep; None: the first two, where they are granted.

    Raises ConfigError for invalid arguments. What goes wrong in the run itself is the result's verdict.
    """
    return execute(plan_of(Job(request, request if request.is_given else None, trace=int(request.trace))))


def execute(plan: Plan, stopped: Callable[[], bool] = lambda: False) -> Result:
    """Run a plan until its end or `stopped()`, in another process if its ECU may crash. Raises ConfigError."""
    job = plan.job
    fit = notes_on_fit(plan.rig, plan.setup.vehicle, plan.request.rate)
    for note in fit:
        job.listener.say(f"note: {note}")
    if job.is_isolated or is_library(job.request.ecu):
        result = _isolated(plan, stopped)
    else:
        result = run_plan(plan, (), stopped)
    late = [] if plan.duration is None else stimuli_after(plan.setup.scenario, plan.duration)
    return replace(result, sources=plan.sources, notes=(*fit, *result.notes, *late))


def _isolated(plan: Plan, stopped: Callable[[], bool]) -> Result:
    """Run a plan in its own process; verdict `error` if the ECU's code crashes or hangs. Raises ConfigError."""
    from liftgate_hil.isolate.isolation import run_isolated

    job = plan.job
    ticks, note = 0, ""
    answer: object
    try:
        sent = pickle.dumps(plan)
        payload, note = run_isolated(_WORKER, sent, 1.0 / job.request.rate, stopped)
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
    """Return a worker's answer, unpickled. Raises EcuError where the ECU's code has corrupted it."""
    try:
        answer = pickle.loads(payload)
    except Exception as error:  # it may hold an object of the ECU's
        raise EcuError(f"the run's answer cannot be read: {type(error).__name__}: {error}") from error
    if not isinstance(answer, Result | LiftgateError):
        raise EcuError(f"the run's answer is {shown(answer)}")
    return answer
