"""A run of a scenario against an ECU: `liftgate_hil.run`.

import liftgate_hil as lh
result = lh.run("demo", ecu="reference", clock="free")
result.maxima["pinch_force_n"]
"""

from __future__ import annotations

import contextlib
import gc
import math
import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from liftgate_compiler import GivenUpError
from liftgate_hil.config.described import command
from liftgate_hil.config.rig_fit import notes_on_fit
from liftgate_hil.config.scenario import stimuli_after
from liftgate_hil.drive.compilation import reporting_compilation
from liftgate_hil.drive.driver import Driver
from liftgate_hil.drive.episode_driver import EpisodeDriver
from liftgate_hil.drive.notes import notes_on, on_the_bus, too_rare, without_contact, without_motion
from liftgate_hil.drive.result import Result, nothing_of, result_of, silence_of, tolerance_of
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.find import adapter_for, is_library
from liftgate_hil.ecu.mutants import mutant_ecu
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.ecu.node import PORT
from liftgate_hil.errors import (
    ConfigError,
    EcuError,
    LiftgateError,
    OverrunError,
    PreconditionError,
    causes,
    shown,
)
from liftgate_hil.isolate.isolation import foreign_code
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.trace_summary import TraceSummarizer
from liftgate_hil.judging.verdict import ERROR, PASS
from liftgate_hil.loop.observers import Extremes, Trace
from liftgate_hil.operate.attachment.server import RunEnd
from liftgate_hil.plan.plan import Plan, plan_of
from liftgate_hil.plan.provenance import provenance_of
from liftgate_hil.plan.request import Job, RunRequest

if TYPE_CHECKING:
    from liftgate_hil.conditions.evaluator import Work
    from liftgate_hil.loop.observers import Sink
    from liftgate_hil.loop.rings import Memory

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
    result = execute(plan_of(Job(request, request if request.is_given else None, trace=int(request.trace))))
    return replace(result, provenance=provenance_of(repr(request), result.sources))


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


def run_plan(
    plan: Plan,
    sinks: Sequence[Sink] = (),
    stopped: Callable[[], bool] = lambda: False,
    memory: Memory | None = None,
) -> Result:
    """Run a plan in this process; `sinks` get its rows and frames, another process may watch its loop's `memory`.

    Attached clients are told how it ended. Raises ConfigError.
    """
    try:
        with reporting_compilation(plan.job.listener, stopped), contextlib.ExitStack() as stack:
            adapter = adapter_of(plan, memory, stack)
            driver = _driver_class(plan)(plan, adapter, _sinks_of(plan, sinks), stopped, memory)
            try:
                result = _result_of(driver, stack)
            except ConfigError as error:
                driver.tell_end(RunEnd(ERROR, ERROR, "; ".join(error.issues)))
                raise
            except GivenUpError:
                driver.tell_end(RunEnd(PASS, PASS, "stopped before it began"))
                raise
            force, time = result.maxima["pinch_force_n"], result.pinch_time_s
            peak = (None, None) if math.isnan(time) else (force, time)
            verdicts = tuple(result.expectations.values())
            driver.tell_end(RunEnd(result.verdict, result.ending, result.reason, verdicts, None, *peak))
            return result
    except GivenUpError:  # stopped before it began
        return nothing_of(plan.job, "", 0)


def _driver_class(plan: Plan) -> type[Driver]:
    """Return the driver class for the plan's clock and for where its ECU runs: in this process or on a bus."""
    if plan.job.is_episode:
        return EpisodeDriver
    if plan.request.clock == "realtime":
        from liftgate_hil.drive.realtime_driver import RealtimeDriver

        return RealtimeDriver
    from liftgate_hil.drive.python_driver import PythonDriver

    return PythonDriver


def _result_of(driver: Driver, stack: contextlib.ExitStack) -> Result:
    """Run a driver's plan to its end, and return the result. Raises ConfigError, GivenUpError."""
    plan, sinks, adapter = driver.plan, driver.sinks, driver.adapter
    reason = given_up = ""
    try:
        driver.prepare(stack)
        with contextlib.ExitStack() as opened:
            driver.begin(opened)
            try:
                driver.advance(plan.ticks)
            finally:
                driver.finish()
    except ConfigError:
        raise
    except PreconditionError as error:
        given_up = str(error)
    except LiftgateError as error:
        reason = "; ".join(causes(error))
        if isinstance(error, OverrunError) and plan.request.clock == "realtime":
            reason, given_up = "", reason
    summary = driver.summary()
    if given_up:
        return _noted(driver, result_of(sinks, adapter, summary, "", given_up=given_up))
    reason = "; ".join([*([reason] if reason else []), *driver.recording_failures()])
    not_made, again = driver.not_made(bool(reason)), driver.steps_again(summary)
    return _noted(driver, result_of(sinks, adapter, summary, reason, not_made, again))


def _noted(driver: Driver, result: Result) -> Result:
    """Return the result, with notes on the run in front of those of its judge."""
    plan, setup, adapter = driver.plan, driver.plan.setup, driver.adapter
    notes = [*notes_on(setup, adapter), *too_rare(plan.rig, adapter)]
    notes += on_the_bus(plan, result.summary)
    notes += without_motion(setup, result)
    whole, step = setup.scenario.duration, 1.0 / plan.request.rate
    if whole is None or result.summary.model_time_s > whole - 1.5 * step:  # not of a part
        notes += without_contact(setup, result)
    return replace(result, notes=(*notes, *result.notes)) if notes else result


def _sinks_of(plan: Plan, others: Sequence[Sink]) -> list[Sink]:
    """Return the sinks that collect the result of a run, with `others` among them."""
    found: list[Sink] = [Extremes(), *others]
    judge = judge_of(plan)
    if judge is not None:
        found.append(judge)
        if plan.job.is_summarized:
            found.append(TraceSummarizer(judge, plan.request.rate))
    if plan.job.trace:
        found.append(Trace(plan.job.trace))
    return found


def judge_of(plan: Plan, work: Work | None = None) -> Judge | None:
    """Return the judge of the run; None: there is nothing to judge, expectations or a precondition.

    Judges that judge one after the other may share their `work` memory.
    """
    scenario, request = plan.setup.scenario, plan.request
    if not scenario.expectations and plan.expected.precondition_end is None:
        return None
    end = math.inf if plan.duration is None else plan.duration
    if request.clock == "free":
        return Judge(plan.expected, request.rate, end, work=work)
    tolerance, silence = tolerance_of(scenario, plan.rig), silence_of(scenario, plan.rig)
    return Judge(plan.expected, request.rate, end, tolerance, silence, work)


def adapter_of(plan: Plan, memory: Memory | None, stack: contextlib.ExitStack) -> Adapter:
    """Return the adapter of the ECU in this process, closed with the stack; an empty one for an ECU on a bus."""
    job, rig, car = plan.job, plan.rig, plan.setup.vehicle
    if job.request.ecu == ON_A_BUS:
        return Adapter(rig, car.drives)
    with foreign_code(memory):
        if job.mutant:
            adapter = mutant_ecu(job.mutant, rig, car.drives, car.coding)
        else:
            adapter = adapter_for(job.request.ecu, rig, car.drives, coding=car.coding)
    stack.callback(_close, adapter, memory)
    return adapter


def _close(adapter: Adapter, memory: Memory | None) -> None:
    with foreign_code(memory):
        adapter.close()
        if memory is not None and adapter.kind == PORT:  # so that who watches it also sees a destructor that hangs
            gc.collect()
