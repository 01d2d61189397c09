"""Closed loops for tests: short scenarios, a Python ECU with given frames, and all results of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import can
import numpy as np
from hil_support import loop_config, start_of, stimulus_plan

import liftgate_hil as lh
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.settings import settings_of
from liftgate_hil.drive.run import run_plan
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.loop.episode import Episode, LoopStart
from liftgate_hil.plan.plan import plan_of
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.stimulus_plan import TimedStimuli
from liftgate_hil.stimuli.timeline import Profile, TimedObstacle
from liftgate_plant.obstacle import Obstacle

NOISE = (
    "sensors.current_noise=0.05", "sensors.angle_noise_deg=0.1", "sensors.voltage_noise=0.02",
    "sensors.ripple=0.05",
)  # fmt: skip
ROD = Obstacle(np.radians(36.0), 1.0, 20_000.0, 0.0, 0.0, 1.0)
CYCLE = 10  # ticks of a command


class Keeper:
    """A recorder that keeps all rows and frames in memory, and the sizes of their blocks."""

    def __init__(self) -> None:
        self.blocks: list[tuple[int, int]] = []
        self._rows: list[np.ndarray] = []
        self._frames: list[np.ndarray] = []

    def take(self, rows: np.ndarray, frames: Any) -> None:
        self.blocks.append((len(rows), len(frames)))
        self._rows.append(rows.copy())
        self._frames.append(np.array(frames))

    @property
    def rows(self) -> np.ndarray:
        return np.concatenate(self._rows)

    @property
    def frames(self) -> np.ndarray:
        return np.concatenate(self._frames)

    def bits(self) -> tuple[bytes, bytes]:
        """Return the bytes of all rows, and of all frames with zeros after each payload."""
        frames = self.frames
        # What lies behind a payload in the ring is an older one's.
        frames["payload"][np.arange(64) >= frames["length"][:, np.newaxis]] = 0
        return self.rows.tobytes(), frames.tobytes()

    def wires(self, is_sent: bool) -> list[tuple[float, int, bytes]]:
        """Return (time [ms], identifier, payload) of one direction."""
        return [
            (row["time_ns"] / 1e6, int(row["identifier"]), row["payload"][: row["length"]].tobytes())
            for row in self.frames
            if row["is_sent"] == is_sent
        ]


@dataclass
class ScriptedEcu:
    """An ECU that sends the frames of `says(turn)` in each turn, and keeps the frames that it hears."""

    says: Callable[[int], list[can.Message]]
    period_s: float | None = None
    heard: list[tuple[float, list[can.Message]]] = field(default_factory=list)

    def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
        self.heard.append((now_s, frames))
        return self.says(len(self.heard) - 1)


def message(identifier: int, data: bytes = b"", **more: Any) -> can.Message:
    """Return a message of python-can with an 11-bit identifier."""
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False, **more)


def reversing(seed: int = 1) -> Scenario:
    """A scenario of closing onto a rod: detected at 0.73 s, then the gate reverses."""
    return Scenario(
        TimedStimuli({}, [TimedObstacle(ROD)]),
        (Request(Instant(0.02), "close"),),
        1.1,
        initial=39.0,
        seed=seed,
        settings=tuple(settings_of(NOISE)),
    )


def releasing(seed: int = 1) -> Scenario:
    """A scenario out of the latch with a sagging supply and a hand pushing."""
    profiles = {
        "supply_voltage_v": Profile([(0.0, 12.0), (0.3, 10.5), (0.5, 13.0)]),
        "hand_force_n": Profile([(0.1, 5.0), (0.4, -20.0)], is_linear=False),
    }
    return Scenario(
        TimedStimuli(profiles),
        (Request(Instant(0.05), "open"),),
        0.6,
        seed=seed,
        settings=tuple(settings_of(NOISE)),
    )


def run_kept(scenario: Scenario, ecu: Any = "reference", **more: Any) -> tuple[lh.Result, Keeper]:
    """Run a scenario; return its result, and a Keeper with all its rows and frames."""
    keeper = Keeper()
    request = RunRequest(scenario, ecu, record=more.pop("records", ()), **more)
    return run_plan(plan_of(Job(request)), sinks=[keeper]), keeper


def episode_of(sinks: Sequence[Any], adapter: Adapter, **more: Any) -> Episode:
    """Return the episode of the reversing scenario, to be stepped by hand."""
    config = loop_config(settings=NOISE, seed=1)
    state = start_of(config, np.radians(39.0), latched=False)
    scenario = reversing()
    around = stimulus_plan(config, scenario.stimuli, scenario.requests)
    return Episode(LoopStart(config, state, around), adapter, sinks, **more)
