"""Evaluation of variants one after the other in this process, with little overhead beyond the run itself.

The loop's memory is kept from one variant to the next, scenario and vehicle are made anew only where their values
change, and so is the state after a precondition that variants share.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from liftgate_hil.campaigns.base import Base, ecu_of
from liftgate_hil.campaigns.figures import NO_FIGURES, Figures, FigureSink
from liftgate_hil.campaigns.shared_starts import SharedStarts, reference_copied
from liftgate_hil.campaigns.space import VariedTarget
from liftgate_hil.conditions.evaluator import work_for
from liftgate_hil.config.parameters import BODY_TABLES, DRIVE_TABLES, FreeParameter, keys_of, with_value
from liftgate_hil.config.settings import Setting, settings_of
from liftgate_hil.config.variant import Variant
from liftgate_hil.config.vehicle import VehicleFile, issues_with
from liftgate_hil.drive.run import adapter_of, judge_of
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.node import PORT, REFERENCE, NodeState
from liftgate_hil.errors import ConfigError, LiftgateError, PreconditionError, causes
from liftgate_hil.isolate.isolation import foreign_code
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.table import BLOCK
from liftgate_hil.judging.verdict import ERROR, INCONCLUSIVE, Verdict, worst
from liftgate_hil.loop.episode import FRAMES, ROWS, Episode, LoopStart
from liftgate_hil.loop.observers import Sink
from liftgate_hil.loop.rings import Memory
from liftgate_hil.plan.plan import Plan, plan_of
from liftgate_hil.plan.setup import scenario_of, variant_of
from liftgate_plant.coding import Coding
from liftgate_plant.signals import SIDES
from liftgate_plant.vehicle import Vehicle

GROUP = 32  # variants that are prepared together; with 16 the rest of the time is 2 % of the run's more


class Vehicles:
    """Factory of the variants' vehicles from one vehicle file; the last vehicle is cached for the next variant.

    A number of the body, or one of a drive that the file gives for both drives alike, is put into the loaded
    vehicle; the loader reads the whole content again for everything else, and for what it would refuse.
    """

    def __init__(self, file: VehicleFile, targets: Sequence[VariedTarget]) -> None:
        self._file = file
        self._parameters = _parameters_of(file, targets)
        self._base: tuple[Any, Vehicle] | None = None  # what the base was loaded for, and the base
        self._last: tuple[Any, Vehicle] | None = None

    def vehicle(self, fixed: Sequence[Setting], varied: Sequence[Setting], variant: Variant) -> Vehicle:
        """Return the file's vehicle as this variant, with all settings applied. Raises ConfigError."""
        key = (list(fixed), list(varied), variant)
        if self._last is None or self._last[0] != key:
            self._last = key, self._made(fixed, varied, variant)
        return self._last[1]

    def _parameter_for(self, setting: Setting) -> FreeParameter | None:
        """Return the parameter to set directly in a loaded vehicle; None: the setting needs the loader."""
        parameter = self._parameters.get(setting.key)
        if parameter is None or not isinstance(setting.value, int | float):
            return None
        return parameter if parameter.quantity.allows(setting.value) else None

    def _made(self, fixed: Sequence[Setting], varied: Sequence[Setting], variant: Variant) -> Vehicle:
        found = [self._parameter_for(each) for each in varied]
        if variant.draw is None and all(found):
            key = (list(fixed), variant)
            if self._base is None or self._base[0] != key:
                self._base = key, self._file.vehicle(fixed, variant)
            vehicle = self._base[1]
            for parameter, setting in zip(found, varied, strict=True):
                assert parameter is not None
                vehicle = with_value(vehicle, parameter, float(setting.value))
            if not issues_with(vehicle):
                return vehicle
        return self._file.vehicle([*fixed, *varied], variant)


def _parameters_of(file: VehicleFile, targets: Sequence[VariedTarget]) -> Mapping[str, FreeParameter]:
    """Return the targets' parameters, by key, whose numbers can be set directly in a loaded vehicle."""
    found: dict[str, FreeParameter] = {}
    sides: tuple[str, ...]
    for each in targets:
        names = each.key.split(".")
        if each.quantity is None or each.point is not None or len(names) != 2:
            continue
        table, key = names
        is_own = any(key in _table(file.raw, side, table) for side in SIDES)
        if table in BODY_TABLES:
            field, sides = keys_of(BODY_TABLES[table])[key].field, ()
        elif table in DRIVE_TABLES and not is_own:
            field, sides = keys_of(DRIVE_TABLES[table])[key].field, SIDES
        else:
            continue
        found[each.key] = FreeParameter(each.key, sides, table, field, -1, each.quantity)
    return found


def _table(raw: Mapping[str, object], side: str, table: str) -> Mapping[str, object]:
    own = raw.get(side)
    inner = own.get(table) if isinstance(own, dict) else None
    return inner if isinstance(inner, dict) else {}


class Row(NamedTuple):
    """Result of one variant: a row of the campaign's result table."""

    verdict: str
    margins: tuple[float, ...]  # of each expectation, in its unit; NaN: undecided, or it has none
    figures: Figures
    wall_s: float
    error: str  # why there is no result; "": there is one
    verdicts: tuple[str, ...]  # on each expectation


def error_row(base: Base, error: str, wall_s: float = math.nan) -> Row:
    """Return the result row of a variant that could not be evaluated, with the error."""
    count = len(base.expectations)
    return Row(ERROR, (math.nan,) * count, NO_FIGURES, wall_s, error, (ERROR,) * count)


class _Ecu(NamedTuple):
    """Reference ECU for a vehicle's coding, with its power-on state."""

    adapter: Adapter
    coding: Coding
    state: NodeState


class _Ready(NamedTuple):
    """Variant that is ready to run: its plan, its ECU's adapter and the states at time 0."""

    plan: Plan
    adapter: Adapter
    start: LoopStart  # at time 0, as is the state of the ECU
    node: NodeState


@dataclass
class _Trial:
    """Variant under evaluation, from its preparation to its result row."""

    began: float
    judge: Judge | None = None
    ready: _Ready | None = None  # None: it is over
    figures: Figures = NO_FIGURES
    stack: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)  # closes a user's ECU
    given_up: str = ""
    error: str = ""
    spent: float = 0.0  # s


class Evaluator:
    """Evaluator of a campaign's variants in this process. Raises ConfigError where the base cannot be run."""

    def __init__(self, base: Base, memory: Memory | None = None) -> None:
        self.base = base
        self.memory = memory or Memory(ROWS, FRAMES, others_write=True)
        self._plan = plan_of(base.job)
        if ecu_of(self._plan) != base.ecu:
            raise ConfigError(
                f"`ecu` {base.job.request.ecu}: not the campaign's file here; allowed: the same content"
            )
        self._starts = SharedStarts()
        self._work = work_for(BLOCK)  # of the judges, which judge one after the other
        assert isinstance(base.job.request.vehicle, VehicleFile)
        self._vehicles = Vehicles(base.job.request.vehicle, base.targets)
        self._settings = settings_of(base.job.request.settings)
        self._figures = FigureSink()
        self._ecu: _Ecu | None = None

    def load(self) -> None:
        """Load the machine code that all variants run, before processes are forked from this one."""
        plan = self._plan
        adapter = Adapter(plan.rig, plan.setup.vehicle.drives)
        Episode(plan.start.with_own_arrays(), adapter, memory=self.memory).begin()
        judge_of(plan)

    def close(self) -> None:
        """Release the loop's memory."""
        self.memory.close()

    def row(self, values: Sequence[float], stopped: Callable[[], bool] = lambda: False) -> Row:
        """Evaluate the variant with these values, and return its result row; an error is stated in the row."""
        return next(self.rows([values], stopped))

    def rows(
        self, variants: Iterable[Sequence[float]], stopped: Callable[[], bool] = lambda: False
    ) -> Iterator[Row]:
        """Evaluate variants: prepare all, run all, judge all; yield their result rows in order.

        All are prepared, then all run, then all judged: each of these is twice as fast with its code and data in
        the processor's caches, from which a run of machine code drives them out.
        """
        trials = [self._prepared(values, stopped) for values in variants]
        for trial in trials:
            self._run(trial, stopped)
        for trial in trials:
            yield self._judged(trial)

    def plan(self, values: Sequence[float]) -> Plan:
        """Return the plan of the variant with these values. Raises ConfigError."""
        job = self.base.job_of(values)
        request = job.request
        scenario = scenario_of(request.scenario, request.parameters)
        fixed, own = [*scenario.settings, *self._settings], settings_of(request.settings[len(self._settings) :])
        vehicle = self._vehicles.vehicle(fixed, own, variant_of(request.draw, request.ideal))
        setup = self._plan.setup.varied(scenario, vehicle, initial=request.initial, seed=request.seed)
        self._plan = self._plan.varied(job, setup)
        return self._plan

    def _prepared(self, values: Sequence[float], stopped: Callable[[], bool]) -> _Trial:
        """Prepare a variant up to its first tick; where that fails, the trial holds the error."""
        trial = _Trial(began=time.perf_counter())
        try:
            plan = self.plan(values)
            trial.judge = judge_of(plan, self._work)
            adapter = self.adapter_of(plan, trial.stack)
            # This plan is run once: its start needs no copy.
            start = self._starts.started(plan, adapter, plan.start, stopped, self.memory)
            trial.ready = _Ready(plan, adapter, start, adapter.state)
        except PreconditionError as failure:
            trial.given_up = str(failure)
        except LiftgateError as failure:
            trial.error = "; ".join(causes(failure))
        trial.spent = time.perf_counter() - trial.began
        return trial

    def _run(self, trial: _Trial, stopped: Callable[[], bool]) -> None:
        """Run a prepared variant as `EpisodeDriver` does, without recordings; `trial` gets figures or an error."""
        if trial.ready is None:
            return
        began, judge = time.perf_counter(), trial.judge
        plan, adapter, start, node = trial.ready
        assert plan.ticks is not None
        sinks: list[Sink] = [self._figures] if judge is None else [self._figures, judge]
        self._figures.begins_anew()
        self.reset()
        adapter.state = node
        is_recorded = judge is not None and judge.reads_the_bus
        try:
            with trial.stack:
                if adapter.kind == PORT:
                    trial.stack.enter_context(foreign_code(self.memory))
                episode = Episode(start, adapter, sinks, is_recorded, self.memory)
                episode.complete(plan.ticks, stopped)
        except LiftgateError as failure:
            trial.error = "; ".join(causes(failure))
        if stopped():
            trial.error = "stopped"
        trial.figures = self._figures.figures()
        trial.spent += time.perf_counter() - began

    def _judged(self, trial: _Trial) -> Row:
        """Judge a trial; return its result row: an error row on an error, inconclusive if it was given up."""
        began, judge = time.perf_counter(), trial.judge
        verdicts: Sequence[Verdict] = ()
        if judge is not None:
            verdicts = judge.verdicts(trial.error, trial.given_up)
        elif trial.given_up:
            verdicts = [Verdict("", INCONCLUSIVE, reason=trial.given_up)]
        if trial.error:
            return error_row(self.base, trial.error, trial.spent)
        found = {each.name: each for each in verdicts}
        margins = tuple(_margin(found.get(name)) for name in self.base.expectations)
        wall_s = trial.spent + time.perf_counter() - began
        own = tuple(found[name].verdict if name in found else INCONCLUSIVE for name in self.base.expectations)
        return Row(worst(each.verdict for each in verdicts), margins, trial.figures, wall_s, "", own)

    def adapter_of(self, plan: Plan, stack: contextlib.ExitStack) -> Adapter:
        """Return the ECU's adapter at power-on: the reference ECU's is cached, `stack` closes a user's."""
        coding = plan.setup.vehicle.coding
        if self._ecu is None or self._ecu.coding != coding:
            adapter = adapter_of(plan, self.memory, stack)
            if adapter.kind != REFERENCE:
                return adapter
            self._ecu = _Ecu(adapter, coding, reference_copied(adapter.state))
        kept = self._ecu
        kept.adapter.state = reference_copied(kept.state)
        kept.adapter.begins_anew(0.0, 0)
        return kept.adapter

    def reset(self) -> None:
        """Set the counters in the loop's memory to zero before the next run."""
        control = self.memory.shared.control[0]
        control.rows = control.frames = control.bits = control.sent = control.tick = control.foreign = 0


def _margin(verdict: Verdict | None) -> float:
    """Return a verdict's margin; NaN: no verdict, an inconclusive one, or one without a margin."""
    if verdict is None or verdict.margin is None or verdict.verdict == INCONCLUSIVE:
        return math.nan
    return float(verdict.margin)
