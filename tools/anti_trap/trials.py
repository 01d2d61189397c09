"""One gate with the reference ECU: it learns, opens and closes undisturbed, then closes onto rods, one per gap."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario, load_scenario
from liftgate_hil.config.variant import Variant
from liftgate_hil.ecu.adapter import ReferenceEcu
from liftgate_hil.ecu.calibration import Calibration, coded
from liftgate_hil.ecu.events import (
    BLOCKED_CLOSING,
    BLOCKED_OPENING,
    TRAPPED_CLOSING,
    TRAPPED_OPENING,
    Event,
)
from liftgate_hil.loop.closed_loop import Episode
from liftgate_hil.loop.tick import constants_in
from liftgate_hil.running.setup import loop_config_of, rig_of, setup_of, start_of
from liftgate_hil.signals import COLUMN_PLACE
from liftgate_hil.stimuli.stimulus_plan import stimulus_plan_of

RATE = 1000.0  # Hz
PERIOD, CLOSE = 26.0, 12.0  # s: of an opening and a closing, and when the latter begins in it
DISTANCE = 1.0  # m from the hinge: the gate's edge
LEARNING = 2  # openings and closings before anything is judged
_FALSE = {BLOCKED_CLOSING, BLOCKED_OPENING, TRAPPED_CLOSING, TRAPPED_OPENING}
_COLUMNS = ("time_s", "pinch_force_n", "gate_angle_deg", "left_speed_rps")


class Car(NamedTuple):
    """A gate, what is around it, and which one of its production."""

    vehicle: str
    settings: tuple[str, ...] = ()
    draw: int | None = None
    seed: int = 0


class Trial(NamedTuple):
    """What is asked of it."""

    free: int = 0  # openings and closings that are judged
    gaps: tuple[float, ...] = ()  # deg at which it meets a rod, one closing each
    rod: float = 1e4  # N/m


class Outcome(NamedTuple):
    """What it did."""

    false: int  # of the free openings and closings, those that were broken off
    peaks: tuple[float, ...]  # N, of each gap
    missed: int  # gaps that it did not come to, because it was broken off before
    speeds: tuple[float, ...]  # m/s of the edge when it met the rod
    ratio: float  # motor revolutions per radian of the gate, in the middle of the travel
    opening: float  # s it took to open, after learning; NaN: it did not
    closing: float


class _Kept:
    """Keeps some columns."""

    def __init__(self) -> None:
        self._places = [COLUMN_PLACE[name] for name in _COLUMNS]
        self._parts: list[NDArray[np.float64]] = []

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """See Sink."""
        self._parts.append(rows[:, self._places].copy())

    def rows(self) -> NDArray[np.float64]:
        """(n, 4) of _COLUMNS."""
        return np.concatenate(self._parts)


@functools.cache
def _rig() -> Rig:
    return rig_of(None)


def _scenario(trial: Trial) -> tuple[Scenario, int]:
    """The trial's requests and rods, and how many periods they are."""
    before = LEARNING + trial.free
    periods = before + len(trial.gaps)
    lines = [f"duration = {PERIOD * periods}"]
    for k in range(periods):
        for time, action in ((0.5, "open"), (CLOSE, "close")):
            lines.append(f'[[request]]\ntime = {PERIOD * k + time}\naction = "{action}"')
    for k, angle in enumerate(trial.gaps, before):
        begin, end = PERIOD * k + CLOSE - 0.5, PERIOD * (k + 1) - 0.1
        lines.append(
            f"[[obstacle]]\nstart = {begin}\nend = {end}\nangle_deg = {angle}\n"
            f"distance = {DISTANCE}\nstiffness = {trial.rod}"
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trial.toml"
        path.write_text("\n".join(lines))
        return load_scenario(path), periods


def run(car: Car, trial: Trial, calibration: Calibration) -> Outcome:
    """One trial. Raises ConfigError for a vehicle that there is not."""
    scenario, periods = _scenario(trial)
    setup = setup_of(
        scenario,
        vehicle=car.vehicle,
        settings=car.settings,
        seed=car.seed,
        variant=Variant(draw=car.draw),
    )
    config = loop_config_of(setup.vehicle, _rig(), RATE, setup.seed)
    kept = _Kept()
    own = coded(calibration, setup.vehicle.coding)
    with ReferenceEcu(_rig(), setup.vehicle.drives, calibration=own) as ecu:
        start = start_of(config, setup.start_angle)
        stimuli = stimulus_plan_of(constants_in(config), scenario.stimuli, scenario.requests)
        episode = Episode(config, start, stimuli, ecu, [kept], is_recorded=False)
        told: list[list[Event]] = []
        for k in range(periods):
            episode.run(round(PERIOD * (k + 1) * RATE))
            told.append([each for each in ecu.events() if each.time > PERIOD * k])
        episode.close()
    return _outcome(trial, told, kept.rows())


def _outcome(trial: Trial, told: Sequence[Sequence[Event]], rows: NDArray[np.float64]) -> Outcome:
    free = told[LEARNING : LEARNING + trial.free]
    touches = [
        _touch(rows, PERIOD * k)
        for k in range(LEARNING + trial.free, LEARNING + trial.free + len(trial.gaps))
    ]
    met = [each for each in touches if each is not None]
    last = _durations(told[LEARNING - 1])
    return Outcome(
        false=sum(each.code in _FALSE for period in free for each in period),
        peaks=tuple(np.nan if each is None else each[0] for each in touches),
        missed=len(touches) - len(met),
        speeds=tuple(np.nan if each is None else each[1] for each in touches),
        ratio=_ratio(rows),
        opening=last.get("opening", np.nan),
        closing=last.get("closing", np.nan),
    )


def _touch(rows: NDArray[np.float64], begin: float) -> tuple[float, float] | None:
    """(largest force [N], edge's speed at the first touch [m/s]) of a period; None: no touch."""
    time, force, angle, _ = rows[(rows[:, 0] > begin + CLOSE) & (rows[:, 0] <= begin + PERIOD)].T
    if not (force > 0.0).any():
        return None
    first = max(int(np.argmax(force > 0.0)), 20)
    passed = np.radians(angle[first - 20] - angle[first])
    return float(force.max()), float(DISTANCE * passed / (time[first] - time[first - 20]))


def _ratio(rows: NDArray[np.float64]) -> float:
    """Motor revolutions per radian where the gate first opens through 40 degrees."""
    place = int(np.argmax(rows[:, 2] > 40.0))
    before, after = rows[place - 20], rows[place]
    turned = np.radians(after[2] - before[2]) / (after[0] - before[0])
    return float(after[3] / turned)


def _durations(events: Sequence[Event]) -> dict[str, float]:
    """How long each motion of a period took that came to its end [s], by what the ECU told."""
    took: dict[str, float] = {}
    begun: Event | None = None
    for each in events:
        if each.text in ("opening", "closing"):
            begun = each
        elif begun is not None and each.code not in _FALSE:
            took[begun.text] = each.time - begun.time
            begun = None
        else:
            begun = None
    return took
