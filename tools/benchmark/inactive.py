"""Benchmark of inactive faults and expectations: the cost of those that a scenario contains and that do nothing.

The demo's episode with them is measured against the same without, in turns.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from liftgate_hil.config.shipped import find_config
from liftgate_hil.ecu.adapter import ReferenceEcu
from liftgate_hil.judging.judge import Judge
from liftgate_hil.loop.episode import FRAMES, ROWS, Episode
from liftgate_hil.loop.observers import Extremes, Sink
from liftgate_hil.loop.rings import Memory
from liftgate_hil.plan.plan import expected_in, loop_start_of
from liftgate_hil.plan.request import ticks_of
from liftgate_hil.plan.setup import rig_of, setup_of

ROUNDS = 21
_RATE = 1000.0
_FAULTS = """
[[fault]]
kind = "spring_weak"
where = "left"
factor = 0.5
start = {start}
[[fault]]
kind = "hall_a_stuck"
where = "right"
value = 0
start = {start}
[[fault]]
kind = "parameter"
key = "motor.resistance"
value = 1.5
start = {start}
[[fault]]
kind = "frame_lost"
where = "LeftDrive"
direction = "sent"
probability = 0.5
start = {start}
[[fault]]
kind = "wrong_checksum"
where = "DriveCommand"
direction = "received"
start = {start}
"""
_EXPECTED = """
[[expect]]
name = "reverses"
eventually = "gate_rate_degps > 1"
after = "pinch_force_n > 5000"
within_s = 0.3
[[expect]]
name = "soft"
always = "pinch_force_n < 400"
"""
_LATE, _NEVER = "1000.0", '"gate_angle_deg > 500"'
PLAIN = "as it is"
CASES = {
    PLAIN: "",
    "3 faults of the gate and 2 on its bus, after the end": _FAULTS.format(start=_LATE),
    "the same 5, each waiting for a condition that never comes": _FAULTS.format(start=_NEVER),
    "2 expectations": _EXPECTED,
    "5 faults after the end and 2 expectations": _FAULTS.format(start=_LATE) + _EXPECTED,
    "5 faults that wait, and 2 expectations": _FAULTS.format(start=_NEVER) + _EXPECTED,
}


class Figures(NamedTuple):
    """CPU seconds of a tick: median and minimum of the rounds, and the ratios to the plain demo."""

    tick: float
    least: float
    ratio: float  # the median of the rounds' ratios
    least_ratio: float  # ratio of the minima


def tick_of(path: Path, memory: Memory, ticks: int | None = None) -> float:
    """Run one episode of a scenario; return its CPU seconds per tick, including its judge and the extremes."""
    setup, rig = setup_of(path), rig_of(None)
    count = ticks or ticks_of(setup.scenario.duration, _RATE)
    assert count is not None
    sinks: list[Sink] = [Extremes()]
    if setup.scenario.expectations:
        sinks.append(Judge(expected_in(setup, rig), _RATE, count / _RATE))
    control = memory.shared.control[0]
    control.rows = control.frames = control.bits = 0
    with ReferenceEcu(rig, setup.vehicle.drives) as adapter:
        episode = Episode(loop_start_of(setup, rig, _RATE), adapter, sinks, False, memory)
        episode.begin()
        if setup.scenario.expectations:  # compiles the judge, too
            sinks[-1].take(np.zeros((0, memory.shared.rows.shape[1])), memory.shared.frames[:0])
        start = time.thread_time()
        episode.run(count)
        return (time.thread_time() - start) / count


def measure(rounds: int = ROUNDS, ticks: int | None = None) -> Mapping[str, Figures]:
    """Return the figures by case; an additional first round warms up."""
    memory = Memory(ROWS, FRAMES)
    times: dict[str, list[float]] = {name: [] for name in CASES}
    demo = find_config("scenarios", "demo").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: Path(folder) / f"{k}.toml" for k, name in enumerate(CASES)}
        for name, path in paths.items():
            path.write_text(demo + CASES[name], encoding="utf-8")
        for number in range(rounds + 1):
            for name in list(paths)[:: -1 if number % 2 else 1]:
                taken = tick_of(paths[name], memory, ticks)
                if number:
                    times[name].append(taken)
    memory.close()
    plain = times[PLAIN]
    return {
        name: Figures(
            statistics.median(own),
            min(own),
            statistics.median(a / b for a, b in zip(own, plain, strict=True)),
            min(own) / min(plain),
        )
        for name, own in times.items()
    }


def table(found: Mapping[str, Figures]) -> list[str]:
    """Return the lines of a table of the figures."""
    lines = ["| the demo | tick | to that as it is | ratio of the minima |", "|---|---|---|---|"]
    for name, each in found.items():
        lines.append(f"| {name} | {1e9 * each.tick:.1f} ns | **{each.ratio:.3f}** | {each.least_ratio:.3f} |")
    return lines
