"""Evaluation of variants in this process, one after the other: what a run costs and little else.

The loop's memory is kept from one variant to the next, scenario and vehicle are made anew only where their values
change, and so is the state after a precondition that variants share.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from liftgate_hil.campaign.base import Base
from liftgate_hil.campaign.figures import NO_FIGURES, Figures, FigureSink
from liftgate_hil.campaign.vehicles import Vehicles
from liftgate_hil.config.arguments import seed_of
from liftgate_hil.config.settings import settings_of
from liftgate_hil.config.vehicle import VehicleFile
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.node import REFERENCE, NodeState
from liftgate_hil.errors import ConfigError, LiftgateError, PreconditionError, causes
from liftgate_hil.judging.verdict import ERROR, INCONCLUSIVE, Verdict, worst
from liftgate_hil.loop.closed_loop import FRAMES, ROWS, Episode
from liftgate_hil.loop.observers import Sink
from liftgate_hil.loop.rings import Memory
from liftgate_hil.loop.tick import copied
from liftgate_hil.running.compilation import reporting_compilation
from liftgate_hil.running.episode_driver import EpisodeDriver
from liftgate_hil.running.execution import Execution
from liftgate_hil.running.plan import Plan, plan_of
from liftgate_hil.running.run_plan import adapter_of, judge_of
from liftgate_hil.running.setup import angle_from, scenario_of
from liftgate_hil.running.shared_starts import SharedStarts
from liftgate_plant.coding import Coding


class Row(NamedTuple):
    """Result of a variant."""

    verdict: str
    margins: tuple[float, ...]  # of each expectation, in its unit; NaN: undecided, or it has none
    figures: Figures
    wall_s: float
    error: str  # why there is no result; "": there is one


def error_row(base: Base, error: str, wall_s: float = math.nan) -> Row:
    """Return the row of a variant without a result."""
    return Row(ERROR, (math.nan,) * len(base.expectations), NO_FIGURES, wall_s, error)


class _Ecu(NamedTuple):
    """The reference ECU for a vehicle's coding, and its state when it is switched on."""

    adapter: Adapter
    coding: Coding
    state: NodeState


class Evaluator:
    """Evaluates the variants of a base. Raises ConfigError where the base itself cannot be run."""

    def __init__(self, base: Base, memory: Memory | None = None) -> None:
        self.base = base
        self.memory = memory or Memory(ROWS, FRAMES, others_write=True)
        self._plan = plan_of(base.job)
        self._starts = SharedStarts()
        assert isinstance(base.job.vehicle, VehicleFile)
        self._vehicles = Vehicles(base.job.vehicle, base.targets)
        self._settings = settings_of(base.job.settings)
        self._ecu: _Ecu | None = None

    def load(self) -> None:
        """Load the machine code that all variants run, before processes are forked from this one."""
        plan = self._plan
        adapter = Adapter(plan.rig, plan.setup.vehicle.drives)
        stimuli, state = Execution(plan, adapter, (), lambda: False, None).start()
        Episode(plan.config, state, stimuli, adapter, (), memory=self.memory).begin()
        judge_of(plan)

    def close(self) -> None:
        """Release the loop's memory."""
        self.memory.close()

    def row(self, values: Sequence[float], stopped: Callable[[], bool] = lambda: False) -> Row:
        """Return the result of the variant with these values; an error is its row's."""
        began = time.perf_counter()
        try:
            plan = self.plan(values)
            verdicts, figures, error = self._run(plan, stopped)
        except LiftgateError as failure:
            return error_row(self.base, "; ".join(causes(failure)), time.perf_counter() - began)
        if error:
            return error_row(self.base, error, time.perf_counter() - began)
        found = {each.name: each for each in verdicts}
        margins = tuple(_margin(found.get(name)) for name in self.base.expectations)
        verdict = worst(each.verdict for each in verdicts)
        return Row(verdict, margins, figures, time.perf_counter() - began, "")

    def plan(self, values: Sequence[float]) -> Plan:
        """Return the plan of the variant with these values. Raises ConfigError."""
        job = self.base.job_of(values)
        scenario = scenario_of(job.scenario, job.parameters)
        fixed = [*scenario.settings, *self._settings]
        vehicle = self._vehicles.vehicle(fixed, settings_of(job.settings[len(self._settings) :]), job.variant)
        initial = scenario.initial if job.initial is None else job.initial
        setup = replace(
            self._plan.setup,
            scenario=scenario,
            vehicle=vehicle,
            seed=seed_of(scenario.seed if job.seed is None else job.seed),
            start_angle=angle_from(initial, vehicle.gate.open_angle),
        )
        self._plan = self._plan.varied(job, setup)
        return self._plan

    def _run(self, plan: Plan, stopped: Callable[[], bool]) -> tuple[Sequence[Verdict], Figures, str]:
        """Return verdicts and figures of a run, or why it did not reach its end; as `run_plan` does."""
        figures, judge = FigureSink(), judge_of(plan)
        sinks: list[Sink] = [figures] if judge is None else [figures, judge]
        self.reset()
        given_up = error = ""
        with contextlib.ExitStack() as stack:
            stack.enter_context(reporting_compilation(plan.job.listener, stopped))
            adapter = self._adapter_of(plan, stack)
            driver = EpisodeDriver(Execution(plan, adapter, sinks, stopped, self.memory, self._starts))
            try:
                driver.begin(stack)
                try:
                    driver.advance(plan.ticks, stopped)
                finally:
                    driver.finish()
            except ConfigError:
                raise
            except PreconditionError as failure:
                given_up = str(failure)
            except LiftgateError as failure:
                error = "; ".join(causes(failure))
        if stopped():
            error = "stopped"
        if judge is None:
            verdicts = [Verdict("", INCONCLUSIVE, reason=given_up)] if given_up else []
        else:
            verdicts = judge.verdicts(error, given_up)
        return verdicts, figures.figures(), error

    def _adapter_of(self, plan: Plan, stack: contextlib.ExitStack) -> Adapter:
        """Return the adapter of the ECU as it is switched on; that of our own ECU is kept for the next variant."""
        coding = plan.setup.vehicle.coding
        if self._ecu is None or self._ecu.coding != coding:
            adapter = adapter_of(plan, self.memory, stack)
            if adapter.kind != REFERENCE:
                return adapter
            self._ecu = _Ecu(adapter, coding, copied(adapter.state))
        kept = self._ecu
        kept.adapter.state = copied(kept.state)
        kept.adapter.begins_anew(0.0)
        return kept.adapter

    def reset(self) -> None:
        """Empty the loop's memory for the next run."""
        control = self.memory.shared.control[0]
        control.rows = control.frames = control.bits = control.sent = control.tick = control.foreign = 0


def _margin(verdict: Verdict | None) -> float:
    """Return the margin of a verdict; NaN where it has none."""
    if verdict is None or verdict.margin is None or verdict.verdict == INCONCLUSIVE:
        return math.nan
    return float(verdict.margin)
