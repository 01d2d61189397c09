"""Trial of one gate with the reference ECU.

The gate learns, opens and closes undisturbed, then closes onto rods, one per gap.
"""

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
from liftgate_hil.ecu.events import BLOCKED_CLOSING, BLOCKED_OPENING, TRAPPED_CLOSING, TRAPPED_OPENING, Event
from liftgate_hil.loop.episode import Episode, LoopStart
from liftgate_hil.loop.tick import constants_in
from liftgate_hil.plan.plan import loop_config_of, start_of
from liftgate_hil.plan.setup import rig_of, setup_of
from liftgate_hil.signals import COLUMN_PLACE
from liftgate_hil.stimuli.stimulus_plan import stimulus_plan_of

RATE = 1000.0  # Hz, ticks of the loop
PERIOD, CLOSE = (26.0, 12.0)  # s, period with an opening and a closing; time in it at which closing is requested
DISTANCE = 1.0  # m, distance of the gate's edge from the hinge
LEARNING = 2  # openings and closings before anything is judged
_FALSE = {BLOCKED_CLOSING, BLOCKED_OPENING, TRAPPED_CLOSING, TRAPPED_OPENING}
_COLUMNS = ("time_s", "pinch_force_n", "gate_angle_deg", "left_speed_rps")


class Car(NamedTuple):
    """Car of a trial: its vehicle, settings of its surroundings, and its draw from the production."""

    vehicle: str
    settings: tuple[str, ...] = ()
    draw: int | None = None
    seed: int = 0


class Trial(NamedTuple):
    """Motions of a trial: undisturbed ones, then one closing onto a rod for each gap."""

    free: int = 0  # undisturbed openings, and as many closings, that are judged
    gaps: tuple[float, ...] = ()  # deg, angles at which the gate meets a rod, one closing each
    rod: float = 1e4  # N/m, stiffness


class Outcome(NamedTuple):
    """Outcome of a trial."""

    false: int  # undisturbed openings and closings that were broken off
    peaks: tuple[float, ...]  # N, largest force at each gap; NaN: no touch
    missed: int  # gaps without a touch, because the closing was broken off before
    speeds: tuple[float, ...]  # m/s, speed of the edge at the first touch of each rod; NaN: no touch
    ratio: float  # motor revolutions per radian of the gate, in the middle of the travel
    opening: float  # s, duration of the last opening for learning; NaN: not completed
    closing: float  # s, duration of the closing after it; NaN: not completed


class _Kept:
    """Sink of a run that keeps the columns _COLUMNS."""

    def __init__(self) -> None:
        self._places = [COLUMN_PLACE[name] for name in _COLUMNS]
        self._parts: list[NDArray[np.float64]] = []

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Keep _COLUMNS of rows (n, ROW_WIDTH); `frames` are ignored."""
        self._parts.append(rows[:, self._places].copy())

    def rows(self) -> NDArray[np.float64]:
        """Return all kept rows (n, 4), as _COLUMNS."""
        return np.concatenate(self._parts)


@functools.cache
def _rig() -> Rig:
    return rig_of(None)


def _scenario(trial: Trial) -> tuple[Scenario, int]:
    """Return the scenario with the trial's requests and rods, and its number of periods."""
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
    """Run one trial and return its outcome. Raises ConfigError for an unknown vehicle."""
    scenario, periods = _scenario(trial)
    setup = setup_of(
        scenario, vehicle=car.vehicle, settings=car.settings, seed=car.seed, variant=Variant(draw=car.draw)
    )
    config = loop_config_of(setup.vehicle, _rig(), RATE, setup.seed)
    kept = _Kept()
    own = coded(calibration, setup.vehicle.coding)
    with ReferenceEcu(_rig(), setup.vehicle.drives, calibration=own) as ecu:
        state = start_of(config, setup.start_angle)
        stimuli = stimulus_plan_of(constants_in(config), scenario.stimuli, scenario.requests)
        episode = Episode(LoopStart(config, state, stimuli), ecu, [kept], is_recorded=False)
        events: list[list[Event]] = []
        for k in range(periods):
            episode.run(round(PERIOD * (k + 1) * RATE))
            events.append([each for each in ecu.events() if each.time > PERIOD * k])
        episode.close()
    return _outcome(trial, events, kept.rows())


def _outcome(trial: Trial, events: Sequence[Sequence[Event]], rows: NDArray[np.float64]) -> Outcome:
    free = events[LEARNING : LEARNING + trial.free]
    touches = [
        _touch(rows, PERIOD * k) for k in range(LEARNING + trial.free, LEARNING + trial.free + len(trial.gaps))
    ]
    met = [each for each in touches if each is not None]
    last = _durations(events[LEARNING - 1])
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
    """Return (largest force [N], edge's speed at the first touch [m/s]) of a period's closing; None: no touch.

    `begin` [s] is the start of the period.
    """
    time, force, angle, _ = rows[(rows[:, 0] > begin + CLOSE) & (rows[:, 0] <= begin + PERIOD)].T
    if not (force > 0.0).any():
        return None
    first = max(int(np.argmax(force > 0.0)), 20)
    passed = np.radians(angle[first - 20] - angle[first])
    return float(force.max()), float(DISTANCE * passed / (time[first] - time[first - 20]))


def _ratio(rows: NDArray[np.float64]) -> float:
    """Return the motor revolutions per radian of the gate where it first opens through 40 degrees."""
    place = int(np.argmax(rows[:, 2] > 40.0))
    before, after = rows[place - 20], rows[place]
    turned = np.radians(after[2] - before[2]) / (after[0] - before[0])
    return float(after[3] / turned)


def _durations(events: Sequence[Event]) -> dict[str, float]:
    """Return the duration [s] of each completed motion of a period, by the events that the ECU reported."""
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
