"""Machine code of all loops, made ahead of time, by short runs and calls of all that is compiled."""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from liftgate_hil.errors import LiftgateError
from liftgate_hil.judging.verdict import ERROR
from liftgate_hil.loop.listener import Listener

_SCENARIO = """\
[[expect]]
name = "begins"
always = "time_s >= 0"
"""


def function_of(name: str) -> Callable[..., Any]:
    """Return the function to be compiled that ENTRY_POINTS lists by this name."""
    from liftgate_hil.drive.compilation import ENTRY_POINTS

    function: Callable[..., Any] = getattr(importlib.import_module(ENTRY_POINTS[name][1]), name)
    return function


class CompilationListener(Listener):
    """Listener that forwards messages and numbered compilations (of `total`), but no progress of runs."""

    def __init__(self, teller: Listener, total: int) -> None:
        self._teller, self._total, self._ready = teller, total, 0
        self.say = teller.say  # type: ignore[method-assign]

    def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
        """Forward the progress of a compilation, with its number in the name."""
        self._teller.compiles(f"{name} ({self._ready + 1} of {self._total})", seconds, expected)

    def compiled(self, name: str, seconds: float) -> None:
        """Count a compilation that has ended, and forward its end."""
        self._ready += 1
        self._teller.compiled(name, seconds)


def compile_loops(teller: Listener, stopped: Callable[[], bool]) -> None:
    """Compile the loops by short runs: each clock, with an ECU in the process, a judge, a triggered recording."""
    from liftgate_hil.drive.run import execute
    from liftgate_hil.plan.plan import plan_of
    from liftgate_hil.plan.request import CLOCKS, Job, RunRequest

    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / "scenario.toml"
        scenario.write_text(_SCENARIO, encoding="utf-8")
        for clock in CLOCKS:
            records, when = (Path(folder) / f"{clock}.csv",), ("time_s > 0",)
            request = RunRequest(scenario, clock=clock, duration=0.001, record=records, record_when=when)
            result = execute(plan_of(Job(request, listener=teller)), stopped)
            if result.verdict == ERROR:
                raise LiftgateError(result.reason)


def compile_others() -> None:
    """Compile the machine code that `simulate`, `identify`, `judge`, `doctor` and `replay` use."""
    import numpy as np

    from liftgate_hil.codec.frames import empty_frames
    from liftgate_hil.identification.trajectory import REST, trajectory
    from liftgate_hil.loop.simulation import blocks_of, constant_voltage
    from liftgate_hil.loop.wakeups import measure_wakeups
    from liftgate_hil.measurement.walk import events_in
    from liftgate_hil.plan.setup import rig_of, setup_of
    from liftgate_hil.plan.stimulation import offline_of
    from liftgate_hil.playback.player import machine_code
    from liftgate_hil.signals import BUS_OUTPUTS
    from liftgate_plant.initial import initial_state
    from liftgate_plant.rows import INPUT_COLUMNS
    from liftgate_plant.vehicle import load_of, plant_of

    setup = setup_of(None)
    vehicle, plant, load = setup.vehicle, plant_of(setup.vehicle), load_of(setup.vehicle)
    list(blocks_of(offline_of(setup, 1e-3), initial_state(plant, 0.0), constant_voltage(0.0), 1))
    rows = np.full((2, len(INPUT_COLUMNS)), np.nan)
    trajectory(plant, vehicle.sensors, load, REST, 0, np.array([0.0, 1e-3]), rows, 1e-3)
    layout = rig_of(None, setup.scenario).output_config(sending=False)
    events_in(layout, empty_frames(0), np.zeros(0, dtype=np.int64), len(BUS_OUTPUTS), True)
    measure_wakeups(1_000_000, 1)
    machine_code()
