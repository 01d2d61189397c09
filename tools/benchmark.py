"""What a step, a tick, a simulation and a start cost: `make bench`, or python -m tools.benchmark [--json].

Every figure is the median of several rounds in one run; absolute times are this machine's at this moment, the
ratios hold further. Nothing here passes or fails.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hil import build
from hil.codec.frames import empty_frames
from hil.loop.tick import Bench, LoopState, initial_loop, tick
from hil.transport.can_bus import CanTransport
from plant import integrate
from plant.bridge import DriveInput
from plant.compiler import compilable, compiled
from plant.dynamics import Inputs, Plant, State, initial_state
from plant.vehicle import load_of, plant_of

ROUNDS = 7


@compilable
def many_steps(plant: Plant, state: State, inputs: Inputs, step: float, count: int) -> State:
    """`count` plant steps in one call."""
    for _ in range(count):
        state = integrate.step(plant, state, inputs, step)
    return state


@compilable
def many_ticks(bench: Bench, state: LoopState, count: int) -> LoopState:
    """`count` whole ticks (receive, step, sense, encode) in one call, without system calls."""
    frames = empty(1)
    for _ in range(count):
        state, _, _ = tick(bench, state, frames, 1, False)
    return state


@compilable
def empty(capacity: int):  # type: ignore[no-untyped-def]
    """No frames, made where compiled code needs them."""
    return frames_type(
        0,
        np.zeros(capacity, dtype=np.int64),
        np.zeros(capacity, dtype=np.int64),
        np.zeros((capacity, 64), dtype=np.uint8),
    )


frames_type = type(empty_frames(1))


def per_call(action: Callable[[], object], count: int) -> float:
    """Median seconds per unit of an action that does `count` of them."""
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        action()
        times.append((time.perf_counter() - start) / count)
    return statistics.median(times)


def whole_process(*arguments: str) -> float:
    """Median seconds of a command from start to exit."""

    def action() -> None:
        subprocess.run(
            [sys.executable, "-m", "hil", *arguments], check=True, capture_output=True, timeout=120
        )

    action()  # the cache is warm from here on
    return per_call(action, 1)


def measure() -> dict[str, float]:
    """All figures, in seconds unless the name says otherwise."""
    vehicle = build.vehicle_from("suv")
    rig = build.rig_from("liftgate")
    plant = plant_of(vehicle)
    state = initial_state(plant)
    load = load_of(vehicle)._replace(latch_released=1.0)
    drive = DriveInput(0.6, 0.0, 0.0)
    inputs = Inputs(drive, drive, load)
    figures: dict[str, float] = {}

    steps = compiled(many_steps)
    steps(plant, state, inputs, 0.001, 1)
    figures["step, compiled, in a loop"] = per_call(
        lambda: steps(plant, state, inputs, 0.001, 200_000), 200_000
    )
    figures["step, plain Python"] = per_call(
        lambda: many_steps(plant, state, inputs, 0.001, 200), 200
    )

    scenario = build.scenario_from(None)
    bench = build.bench_of(vehicle, rig, scenario.program, 1000.0, 0)
    loop_state = initial_loop(bench, initial_state(plant, 0.0, latched=True))
    ticks = compiled(many_ticks)
    ticks(bench, loop_state, 1)
    figures["tick, compiled, in a loop"] = per_call(
        lambda: ticks(bench, loop_state, 50_000), 50_000
    )
    one_tick = compiled(tick)
    frames = empty_frames(1)
    one_tick(bench, loop_state, frames, 1, False)

    def called() -> None:
        for _ in range(5000):
            one_tick(bench, loop_state, frames, 1, False)

    figures["tick, compiled, called from Python"] = per_call(called, 5000)

    with_bus = portable_tick(one_tick, bench, loop_state)
    figures["tick with python-can's virtual bus"] = per_call(lambda: with_bus(5000), 5000)

    with tempfile.TemporaryDirectory() as folder:
        target = str(Path(folder) / "out.csv")
        arguments = ("simulate", "--voltage", "12", "--output", target)
        short = whole_process(*arguments, "--duration", "0.001")
        long = whole_process(*arguments, "--duration", "60")
    figures["simulate, 60 s at 1 ms with CSV, times real time"] = 60.0 / (long - short)
    figures["simulate, start to exit"] = short
    figures["--help, start to exit"] = whole_process("--help")
    figures["emulator, start to exit with one tick"] = whole_process(
        "--bus", "virtual:bench", "--duration", "0.001", "--quiet"
    )
    return figures


def portable_tick(
    one_tick: Callable[..., tuple[LoopState, object, object]], bench: Bench, state: LoopState
) -> Callable[[int], None]:
    """The portable loop's work without waiting: receive, tick, send."""
    transport = CanTransport({"interface": "virtual", "channel": "benchmark"})

    def run(count: int) -> None:
        current = state
        for _ in range(count):
            current, replies, _ = one_tick(bench, current, transport.receive(), 1, False)
            transport.send(replies)  # type: ignore[arg-type]

    return run


def machine() -> str:
    """What this was measured on."""
    model = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = names[0].partition(":")[2].strip() if names else model
    return f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}"


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    figures = measure()
    if args.json:
        print(json.dumps({"machine": machine(), "figures": figures}))
        return
    print(machine())
    for name, value in figures.items():
        if "times real time" in name:
            print(f"{name:<52} {value:12.0f} x")
            continue
        exponent = min(3, max(0, -math.floor(math.log10(value) / 3.0)))
        unit = ("s", "ms", "µs", "ns")[exponent]
        print(f"{name:<52} {value * 1000.0**exponent:12.1f} {unit}")
    ratio = figures["step, plain Python"] / figures["step, compiled, in a loop"]
    print(f"{'compiled step against plain Python':<52} {ratio:12.0f} x faster")


if __name__ == "__main__":
    main()
