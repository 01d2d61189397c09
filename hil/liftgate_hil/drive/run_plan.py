"""Run of a plan in this process: its ECU, its sinks, the driver of its clock, and its result."""

from __future__ import annotations

import contextlib
import gc
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from liftgate_compiler import GivenUpError
from liftgate_hil.drive.bus_run import BusRun, bus_run_of
from liftgate_hil.drive.compilation import reporting_compilation
from liftgate_hil.drive.driver import Driver
from liftgate_hil.drive.episode_driver import EpisodeDriver
from liftgate_hil.drive.execution import Execution
from liftgate_hil.drive.notes import notes_on, on_the_bus, too_rare, without_contact, without_motion
from liftgate_hil.drive.result import Result, nothing_of, result_of, silence_of, tolerance_of
from liftgate_hil.drive.stepping import StepsAgain, relevant_frames
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.find import adapter_for
from liftgate_hil.ecu.mutants import mutant_ecu
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.ecu.node import PORT
from liftgate_hil.errors import ConfigError, LiftgateError, OverrunError, PreconditionError, causes
from liftgate_hil.isolate.signs_of_life import foreign_code
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.trace_summary import TraceSummarizer
from liftgate_hil.judging.verdict import ERROR, INCONCLUSIVE, PASS, STOPPED
from liftgate_hil.loop.episode import Extremes, Trace
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.operate.attachment.server import RunEnd

if TYPE_CHECKING:
    from liftgate_hil.conditions.evaluator import Work
    from liftgate_hil.loop.observers import Sink
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.plan.plan import Plan


def run_plan(
    plan: Plan,
    sinks: Sequence[Sink] = (),
    stopped: Callable[[], bool] = lambda: False,
    memory: Memory | None = None,
) -> Result:
    """Run a plan in this process; `sinks` get its rows and frames, others may see its loop's `memory`.

    Raises ConfigError.
    """
    try:
        with reporting_compilation(plan.job.listener, stopped), contextlib.ExitStack() as stack:
            seen, adapter = _sinks_of(plan, sinks), adapter_of(plan, memory, stack)
            return _Run(Execution(plan, adapter, seen, stopped, memory)).result(stack)
    except GivenUpError:  # stopped before it began
        return nothing_of(plan.job, "", 0)


def _end_of(result: Result) -> RunEnd:
    """Return how a run with this result has ended, for those who are attached to it."""
    force, time = result.maxima["pinch_force_n"], result.pinch_time_s
    peak = (None, None) if math.isnan(time) else (force, time)
    return RunEnd(result.verdict, result.ending, result.reason, tuple(result.expectations.values()), None, *peak)


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


class _Run:
    """Run of a plan, with the driver of its clock."""

    def __init__(self, execution: Execution) -> None:
        self._execution, self._plan = execution, execution.plan
        self._on_bus: BusRun | None = None
        self._driver: Driver | None = None

    def result(self, stack: contextlib.ExitStack) -> Result:
        """Run to the end, tell attached clients how it ended, and return the result. Raises ConfigError."""
        try:
            result = self._result(stack)
        except ConfigError as error:
            self._tell_end(RunEnd(ERROR, ERROR, "; ".join(error.issues)))
            raise
        except GivenUpError:
            self._tell_end(RunEnd(PASS, PASS, "stopped before it began"))
            raise
        self._tell_end(_end_of(result))
        return result

    def _tell_end(self, end: RunEnd) -> None:
        server = None if self._on_bus is None else self._on_bus.observers.server
        if server is not None:
            is_stopped = self._execution.stopped() and end.verdict != ERROR
            code = self._plan.job.exit_codes.get(STOPPED if is_stopped else end.ending)
            # Expectations that are decided all the same stand.
            if is_stopped and (end.verdict == INCONCLUSIVE or not end.expectations):
                end = end._replace(ending=STOPPED)
            server.ends(end._replace(exit_code=code))

    def _result(self, stack: contextlib.ExitStack) -> Result:
        sinks, adapter = self._execution.sinks, self._execution.adapter
        reason = given_up = ""
        try:
            self._driver = driver = self._driver_of(stack)
            with contextlib.ExitStack() as opened:
                driver.begin(opened)
                try:
                    driver.advance(self._plan.ticks, self._execution.stopped)
                finally:
                    driver.finish()
        except ConfigError:
            raise
        except PreconditionError as error:
            given_up = str(error)
        except LiftgateError as error:
            reason = "; ".join(causes(error))
            if isinstance(error, OverrunError) and self._plan.request.clock == "realtime":
                reason, given_up = "", reason
        summary = self._summary()
        if given_up:
            return self._noted(result_of(sinks, adapter, summary, "", given_up=given_up))
        failures = [] if self._driver is None else self._driver.recording_failures()
        reason = "; ".join([*([reason] if reason else []), *failures])
        not_made = "" if self._on_bus is None else self._on_bus.not_made(bool(reason))
        again = self._steps_again(summary)
        return self._noted(result_of(sinks, adapter, summary, reason, not_made, again))

    def _noted(self, result: Result) -> Result:
        """Return the result with notes on the run before those of its judge."""
        execution = self._execution
        setup, adapter = self._plan.setup, execution.adapter
        notes = [*notes_on(setup, adapter), *too_rare(self._plan.rig, adapter)]
        notes += on_the_bus(self._plan, result.summary)
        notes += without_motion(setup, result)
        whole, step = setup.scenario.duration, 1.0 / self._plan.request.rate
        if whole is None or result.summary.model_time_s > whole - 1.5 * step:  # not of a part
            notes += without_contact(setup, result)
        return replace(result, notes=(*notes, *result.notes)) if notes else result

    def _driver_of(self, stack: contextlib.ExitStack) -> Driver:
        """Return the driver of the plan's clock. Raises as `bus_run_of`."""
        if self._plan.job.is_episode:
            return EpisodeDriver(self._execution)
        self._on_bus = bus_run_of(self._execution, stack)
        if self._plan.request.clock == "realtime":
            from liftgate_hil.drive.realtime_driver import RealtimeDriver

            return RealtimeDriver(self._on_bus)
        from liftgate_hil.drive.python_driver import PythonDriver

        return PythonDriver(self._on_bus)

    def _summary(self) -> Summary:
        if self._driver is None:
            return Summary(clock=self._plan.request.clock)
        summary = self._driver.summary()
        if self._on_bus is not None:
            self._on_bus.observers.note(summary)
        return summary

    def _steps_again(self, summary: Summary) -> StepsAgain | None:
        """Return what steps a real-time gate again; None where more than the ECU's commands acted on it."""
        log = None if self._on_bus is None else self._on_bus.log
        begun = None if self._driver is None else self._driver.begun
        judge = self._execution.judge
        if log is None or judge is None or begun is None:
            return None
        frames = log.frames()
        if frames is None:
            return None
        if summary.injections or summary.commands:
            return None  # they act between two ticks, nobody knows between which
        plan = self._plan
        return StepsAgain(
            begun=begun,
            frames=relevant_frames(plan.rig, frames, judge.expected, begun.stimuli),
            ticks=summary.ticks - 1,
            rig=plan.rig,
            drives=plan.setup.vehicle.drives,
            expected=judge.expected,
            rate=plan.request.rate,
            end=judge.end,
            angles=log.angles(),
            stopped=self._execution.stopped,
        )
