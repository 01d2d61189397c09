"""A job, run in this process."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from liftgate_hil.compiling import told_of_compiling
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.find import ON_A_BUS, adapter_for
from liftgate_hil.ecu.mutants import mutant_ecu
from liftgate_hil.loop.recorder import Taker
from liftgate_hil.runs.free import run_free
from liftgate_hil.runs.job import Job, Parts, resolve
from liftgate_hil.runs.on_bus import run_on_bus
from liftgate_hil.runs.result import Result, nothing_of, takers_of
from liftgate_hil.runs.signs_of_life import foreign_code
from liftgate_plant.compiler import GivenUpError

if TYPE_CHECKING:
    from liftgate_hil.loop.rings import Memory


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
        return nothing_of(job, "", 0)


def _run(
    job: Job,
    takers: Sequence[Taker],
    stopped: Callable[[], bool],
    memory: Memory | None,
    parts: Parts,
) -> Result:
    seen = takers_of(job, parts, takers)
    if job.ecu == ON_A_BUS:
        nobody = Adapter(parts.rig, parts.setup.vehicle.drives)
        return run_on_bus(job, parts, nobody, seen, stopped, memory)
    with contextlib.ExitStack() as stack:
        with foreign_code(memory):
            car = parts.setup.vehicle
            if job.mutant:
                adapter = mutant_ecu(job.mutant, parts.rig, car.drives, car.coding)
            else:
                adapter = adapter_for(job.ecu, parts.rig, car.drives, coding=car.coding)
        stack.callback(_close, adapter, memory)
        if job.options.clock == "free":
            return run_free(job, parts, adapter, seen, stopped, memory)
        return run_on_bus(job, parts, adapter, seen, stopped, memory)


def _close(adapter: Adapter, memory: Memory | None) -> None:
    with foreign_code(memory):
        adapter.close()
        if memory is not None:  # whoever looks at it also sees a destructor that hangs
            gc.collect()
