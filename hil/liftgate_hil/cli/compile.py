"""Makes the machine code of all loops ahead of time, and says where it is: for container images and CI caches.

Whatever is there already is left as it is. It is made for this processor, this version and its numba.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.cli.command import Call, add_printed
from liftgate_hil.errors import LiftgateError
from liftgate_hil.judging.verdict import ERROR
from liftgate_hil.loop.listener import Listener

if TYPE_CHECKING:
    from collections.abc import Callable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `compile` to its parser."""
    add_printed(parser)


def run(call: Call) -> int:
    """Run the subcommand `compile` (fill the cache with all machine code) and return its exit code."""
    import liftgate_compiler as compiler
    from liftgate_hil.cli.stopping import StopSignals
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.drive.compilation import ENTRY_POINTS, reporting_compilation

    stopped, teller = StopSignals(), Teller(call.is_quiet)
    listener = _Compiling(teller, sum(not compiler.is_cached(function_of(name)) for name in ENTRY_POINTS))
    if not compiler.enabled():
        raise LiftgateError("the compiler is switched off (LIFTGATE_COMPILE=0); allowed: LIFTGATE_COMPILE not set")
    try:
        with reporting_compilation(listener, stopped), compiler.sharing():
            _compile_loops(listener, stopped)
            _compile_others()
    except compiler.GivenUpError:
        return stopped.exit_code
    finally:
        teller.clear()
    if stopped():
        return stopped.exit_code
    files = list(compiler.cache_folder().rglob("*.code"))
    for name, (what, _) in ENTRY_POINTS.items():
        if not compiler.is_cached(function_of(name)):  # files of other versions may be there
            raise LiftgateError(f"machine code of the {what} could not be saved; see the message above")
    if not call.is_quiet:
        size = sum(file.stat().st_size for file in files) / 1e6
        print(f"{compiler.cache_folder()}: {len(files)} files, {size:.1f} MB", file=sys.stdout)
    return 0


def function_of(name: str) -> Callable[..., Any]:
    """Return the function to be compiled that ENTRY_POINTS lists by this name."""
    from liftgate_hil.drive.compilation import ENTRY_POINTS

    function: Callable[..., Any] = getattr(importlib.import_module(ENTRY_POINTS[name][1]), name)
    return function


_SCENARIO = """\
[[expect]]
name = "begins"
always = "time_s >= 0"
"""


class _Compiling(Listener):
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


def _compile_loops(teller: Listener, stopped: Callable[[], bool]) -> None:
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


def _compile_others() -> None:
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
