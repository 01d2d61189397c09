"""Check that an undriven gate gains no energy; such a gain shows that the solver diverges."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.signals import COLUMNS
from liftgate_plant.constants import Constants
from liftgate_plant.energy import DriveMotion, Potential, SampledMotion, energy, potential
from liftgate_plant.rows import AT
from liftgate_plant.torsion import is_rigid

Floats = NDArray[np.float64]

MOST = 0.01  # share of its available energy that a gate may gain
_AT = {name: place for place, name in enumerate(COLUMNS)}
_NOTHING = 1e-3  # J, errors of quadrature and rounding
_STILL = ("road_slope_deg", "ambient_temperature_degc", "snow_mass_kg")
_ABSENT = ("hand_force_n", "wind_pressure_pa", "external_torque_nm", "pinch_force_n")


class EnergyWatch:
    """Checks that a run's gate gains no energy, by its rows, in stretches without any drive or push from outside.

    The available energy of a gate is that at the stretch's start above the least that it could have at rest. A
    gate that twists, has a latch with positions, or has faults is not checked.
    """

    def __init__(self, constants: Constants, has_faults: bool) -> None:
        plant = constants.plant
        self._constants = constants
        self._is_able = is_rigid(plant.torsion) and plant.latch.half == 0.0 and not has_faults
        self._over: tuple[tuple[float, ...], Potential] | None = None
        self._least = self._start = math.nan  # J, of the stretch that the last block has left unfinished

    def gain(self, rows: Floats, given: Floats) -> int | None:
        """Return the index of the first row (n, columns) by which the gate gained too much energy; None: no row.

        `given` (n, INPUT_COLUMNS) is what drives the motors from each row on, NaN where nothing is given.
        """
        if not self._is_able or len(rows) == 0:
            return None
        idle = np.ones(len(rows), bool)
        for name in ("left_duty", "right_duty", "left_voltage_v", "right_voltage_v"):
            idle &= np.nan_to_num(given[:, getattr(AT, name)]) == 0.0
        for name in _ABSENT:
            idle &= rows[:, _AT[name]] == 0.0
        if not idle.any():
            self._least = self._start = math.nan
            return None
        around = rows[:, [_AT[name] for name in _STILL]]
        changed = np.ones(len(rows), bool)
        changed[1:] = (around[1:] != around[:-1]).any(axis=1) | ~idle[1:] | ~idle[:-1]
        is_last = self._over is not None and self._over[0] == tuple(around[0].tolist())
        changed[0] = math.isnan(self._least) or not idle[0] or not is_last
        starts = np.flatnonzero(changed)
        if not changed[0]:
            starts = np.concatenate([[0], starts])
        for begin, end in zip(starts, [*starts[1:], len(rows)], strict=True):
            if changed[begin]:
                self._least = self._start = math.nan
            if idle[begin]:
                found = self._in_stretch(rows[begin:end], around[begin])
                if found is not None:
                    return int(begin) + found
        return None

    def _in_stretch(self, rows: Floats, around: Floats) -> int | None:
        """Return the index of the row at which an undriven stretch first gains too much energy; None: no row."""
        key = tuple(around.tolist())
        load = self._constants.load._replace(
            road_slope=math.radians(key[0]), ambient_temperature=key[1], snow_mass=key[2]
        )
        if self._over is None or self._over[0] != key:
            self._over = key, potential(self._constants.plant, load)
        over = self._over[1]
        levels = energy(self._constants.plant, load, over, motion_of(rows))
        if math.isnan(self._least):
            self._least = self._start = float(levels[0])
        least = np.minimum.accumulate(np.concatenate([[self._least], levels]))[:-1]
        allowed = MOST * max(self._start - over.least, 0.0) + _NOTHING
        self._least = float(min(least[-1], levels[-1]))
        beyond = ~(levels - least <= allowed)
        return int(np.argmax(beyond)) if beyond.any() else None


def motion_of(rows: Floats) -> SampledMotion:
    """Return the gate's sampled motion from rows (n, columns) of a run."""

    def column(name: str) -> Floats:
        values: Floats = rows[:, _AT[name]]
        return values

    def drive(side: str) -> DriveMotion:
        names = ("current_a", "speed_rps", "position_rev", "clutch_slip_m")
        return DriveMotion(*(column(f"{side}_{name}") for name in names))

    return SampledMotion(
        np.radians(column("gate_angle_deg")), np.radians(column("gate_rate_degps")), drive("left"), drive("right")
    )
