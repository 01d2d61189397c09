"""Benchmark of episodes: the closed loop in machine code against the plant's own step, in the same run.

The plant's step with sensors is measured under the very inputs of each episode, read row by row from its
recording, so that both go through the same phases: moving, stalled, at rest.
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, compiled, fill
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.ecu.adapter import Adapter, ReferenceEcu
from liftgate_hil.ecu.library import LibraryEcu
from liftgate_hil.ecu.python_object import PythonEcu
from liftgate_hil.loop.episode import FRAMES, ROWS, Episode, LoopStart
from liftgate_hil.loop.observers import Sink, Trace
from liftgate_hil.loop.rings import Memory
from liftgate_hil.loop.tick import LoopConfig, constants_in
from liftgate_hil.plan.plan import loop_config_of, start_of
from liftgate_hil.plan.request import ticks_of
from liftgate_hil.plan.setup import rig_from, scenario_from, vehicle_from
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan, stimulus_plan_of
from liftgate_hil.stimuli.timeline import NOT_ARMED, armed, obstacle_at
from liftgate_plant import dynamics, integrate, sensors
from liftgate_plant.bridge import DriveInput
from liftgate_plant.dynamics import NO_OBSTACLE, Inputs, State
from liftgate_plant.friction_profile import frictions_in
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.rows import overlaid
from liftgate_plant.sensors import SensorState
from liftgate_plant.signals import NO_PROFILE_VALUES, Sensed

ROUNDS = 15
RATE = 1000.0
ECU_SOURCES = Path(__file__).resolve().parent.parent / "ecu"


class IdleEcu:
    """Python ECU that does nothing."""

    def step(self, now_s: float, frames: Sequence[Any]) -> list[Any]:
        """Ignore the frames and return none."""
        return []


class Case(NamedTuple):
    """ECU of the table: its name, the function that makes it, and whether its episode is recorded."""

    name: str
    make: Callable[[Rig, int], Adapter]
    is_recorded: bool = False


class Figures(NamedTuple):
    """CPU seconds of a tick: medians and minima of the rounds. `ratio` is the median of the rounds' ratios."""

    episode: float
    plant: float
    ratio: float
    least_episode: float
    least_plant: float

    @property
    def least_ratio(self) -> float:
        """Ratio of the minimum of the episode to the minimum of the plant."""
        return self.least_episode / self.least_plant


class Replay(NamedTuple):
    """Recorded inputs of the plant, one row per tick, and the obstacle."""

    rows: NDArray[np.float64]  # (ticks, 6): duties, coasting, latch released, obstacle in the way
    obstacle: Obstacle


class Bench(NamedTuple):
    """Common parts of all episodes. They share the rings, so that no episode is the first to touch a page."""

    config: LoopConfig
    rig: Rig
    scenario: Scenario
    drives: int
    ticks: int
    memory: Memory

    def stimulus_plan(self) -> StimulusPlan:
        """Return the plan of all that acts from outside, as it is before the first tick."""
        return stimulus_plan_of(constants_in(self.config), self.scenario.stimuli, self.scenario.requests)


@compilable
def plant_steps(
    config: LoopConfig, plant: State, memory: SensorState, replay: Replay, seen: NDArray[np.float64]
) -> State:
    """Return the plant's state after its steps with sensors under recorded inputs.

    `seen` (2, columns of Sensed) receives the sensors' values, so that the compiler does not remove them.
    """
    rows = replay.rows
    for k in range(len(rows)):
        body = replay.obstacle if rows[k, 5] > 0.0 else NO_OBSTACLE
        load = overlaid(config.load, NO_PROFILE_VALUES, 0.0, rows[k, 4], 0.0, body)
        inputs = Inputs(
            DriveInput(rows[k, 0], 0.0, rows[k, 2]),
            DriveInput(rows[k, 1], 0.0, rows[k, 3]),
            load,
            frictions_in(config.friction, config.plant, plant, config.step),
        )
        plant, flow = integrate.advance(config.plant, plant, inputs, config.step)
        shown = dynamics.outputs(config.plant, plant, inputs)
        view = sensors.View(plant, inputs, shown, flow)
        when = sensors.tick_of(config.sensors, config.seed, k + 1, config.step)
        memory, sensed = sensors.sense(config.sensors, config.faults, config.plant, view, memory, when)
        fill(seen[k % 2], 0, sensed)
    return plant


class Commands:
    """Sink that keeps the frames of one identifier, each as (time [ns], payload)."""

    def __init__(self, identifier: int) -> None:
        self._identifier = identifier
        self.frames: list[tuple[int, bytes]] = []

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Keep the frames of the identifier that a block contains."""
        for each in frames[frames["identifier"] == self._identifier]:
            payload = bytes(each["payload"][: each["length"]])
            self.frames.append((int(each["time_ns"]), payload))


def bench_of(name: str = "demo") -> Bench:
    """Return the bench of the shipped SUV and rig, with a scenario that has no profiles."""
    vehicle, rig = vehicle_from("suv"), rig_from("liftgate")
    scenario = scenario_from(name)
    config = loop_config_of(vehicle, rig, RATE, 0)
    ticks = ticks_of(scenario.duration, RATE)
    assert ticks is not None
    return Bench(config, rig, scenario, vehicle.drives, ticks, Memory(ROWS, FRAMES))


def run_episode(bench: Bench, case: Case, sinks: Sequence[Sink] = ()) -> tuple[float, State]:
    """Run one episode, and return its CPU seconds and the plant's final state."""
    control = bench.memory.shared.control[0]
    control.rows = control.frames = control.bits = 0
    with case.make(bench.rig, bench.drives) as adapter:
        episode = Episode(
            LoopStart(bench.config, start_of(bench.config), bench.stimulus_plan()), adapter,
            sinks, case.is_recorded or bool(sinks), bench.memory,
        )  # fmt: skip
        start = time.thread_time()
        episode.run(bench.ticks)
        return time.thread_time() - start, episode.state.plant


def replay_of(bench: Bench, case: Case) -> Replay:
    """Return the inputs of the plant in an episode: duties and coasting, latch commands, the scenario's obstacle.

    Raises AssertionError if their replay ends in another state than the episode.
    """
    trace, commands = Trace(), Commands(bench.rig.command_identifier())
    _, end = run_episode(bench, case, [trace, commands])
    columns = trace.columns()
    message = bench.rig.messages["DriveCommand"]
    rows = np.zeros((bench.ticks, 6))
    for place, name in enumerate(("left_duty", "right_duty", "left_coast", "right_coast")):
        rows[:, place] = columns[name]
    for stamp, payload in commands.frames:
        values = message.decode(payload, decode_choices=False)
        rows[round(stamp / bench.config.step_ns) - 1 :, 4] = values["LatchRelease"]
    angles = np.radians(np.concatenate([[0.0], columns["gate_angle_deg"][:-1]]))
    arming, met, stimuli = NOT_ARMED, NO_OBSTACLE, bench.stimulus_plan()
    for tick, angle in enumerate(angles):
        there = obstacle_at(stimuli.timeline, stimuli.moments, tick * bench.config.step)
        arming, body = armed(arming, there, angle)
        rows[tick, 5] = body.stiffness > 0.0
        met = body if body.stiffness > 0.0 else met
    replay = Replay(rows, met)
    if replayed(bench, replay)[1] != end:
        raise AssertionError("the replay of an episode ends elsewhere")
    return replay


def replayed(bench: Bench, replay: Replay) -> tuple[float, State]:
    """Run the plant and its sensors alone, and return their CPU seconds and the plant's final state."""
    run = compiled(plant_steps)
    state = start_of(bench.config)
    seen = np.empty((2, len(Sensed._fields)))
    start = time.thread_time()
    end = run(bench.config, state.plant, state.sensors, replay, seen)
    return time.thread_time() - start, end


def built_library(folder: Path) -> Path | None:
    """Build the C ECU of tools/ecu with its Makefile; return the library, None without make or a compiler."""
    if shutil.which("make") is None or shutil.which("cc") is None:
        return None
    command = ["make", "-C", str(ECU_SOURCES), f"OUT={folder}", f"PYTHON={sys.executable}"]
    library = folder / "liftgate-ecu.so"
    subprocess.run([*command, str(library)], check=True, capture_output=True, timeout=120)
    return library


def cases(library: Path | None) -> list[Case]:
    """Return the ECUs of the table; the C ECU only if there is a library of it."""
    found = [
        Case("reference ECU", ReferenceEcu),
        Case("reference ECU, frames kept for a recording", ReferenceEcu, True),
        Case("Python ECU that does nothing", lambda rig, drives: PythonEcu(IdleEcu(), rig, drives)),
        Case("no ECU", Adapter),
    ]
    if library is not None:
        found.insert(2, Case("C ECU of tools/ecu", lambda rig, drives: LibraryEcu(library, rig, drives)))
    return found


def measure_case(bench: Bench, case: Case, rounds: int) -> Figures:
    """Return the figures of an ECU: its episode and the plant alone, measured in turns."""
    replay = replay_of(bench, case)
    episodes, plants = [], []
    for number in range(rounds):
        for is_plant in (True, False) if number % 2 else (False, True):
            seconds = replayed(bench, replay)[0] if is_plant else run_episode(bench, case)[0]
            (plants if is_plant else episodes).append(seconds / bench.ticks)
    return Figures(
        statistics.median(episodes),
        statistics.median(plants),
        statistics.median(a / b for a, b in zip(episodes, plants, strict=True)),
        min(episodes),
        min(plants),
    )


def measure(rounds: int = ROUNDS, ticks: int | None = None) -> dict[str, Figures]:
    """Return the figures by ECU, for `ticks` of the demo, or for all of it."""
    bench = bench_of()
    if ticks is not None:
        bench = bench._replace(ticks=ticks)
    with tempfile.TemporaryDirectory() as folder:
        library = built_library(Path(folder))
        found = {each.name: measure_case(bench, each, rounds) for each in cases(library)}
    bench.memory.close()
    return found
