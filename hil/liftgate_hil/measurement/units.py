"""Units that a file may use, as factor and offset to ours: ours = factor · theirs + offset."""

from __future__ import annotations

import math
from collections.abc import Mapping

Conversion = tuple[float, float]

_SAME: Mapping[str, Conversion] = {"": (1.0, 0.0), "1": (1.0, 0.0), "-": (1.0, 0.0)}
_TURN = 2.0 * math.pi


def _factors(**given: float) -> dict[str, Conversion]:
    return {unit: (factor, 0.0) for unit, factor in given.items()}


_TIME = {**_factors(s=1.0, ms=1e-3, us=1e-6, ns=1e-9, min=60.0), "µs": (1e-6, 0.0)}
_VOLTAGE = _factors(V=1.0, mV=1e-3, kV=1e3)
_CURRENT = {**_factors(A=1.0, mA=1e-3, kA=1e3, uA=1e-6), "µA": (1e-6, 0.0)}
_SPEED = {
    **_factors(rps=1.0, Hz=1.0, rpm=1.0 / 60.0),
    "rev/s": (1.0, 0.0),
    "1/s": (1.0, 0.0),
    "1/min": (1.0 / 60.0, 0.0),
    "rev/min": (1.0 / 60.0, 0.0),
    "rad/s": (1.0 / _TURN, 0.0),
    "deg/s": (1.0 / 360.0, 0.0),
}
_POSITION = {
    **_factors(rev=1.0, turns=1.0, rad=1.0 / _TURN, deg=1.0 / 360.0),
    "°": (1.0 / 360.0, 0.0),
}
_ANGLE = {**_factors(deg=1.0, rad=360.0 / _TURN, mrad=0.36 / _TURN), "°": (1.0, 0.0)}
_COUNT = {**_factors(count=1.0, counts=1.0), **_SAME}
_FORCE = _factors(N=1.0, kN=1e3)
_TORQUE = {**_factors(Nm=1.0, mNm=1e-3), "N m": (1.0, 0.0), "N·m": (1.0, 0.0)}
_PRESSURE = _factors(Pa=1.0, hPa=1e2, kPa=1e3, mbar=1e2)
_MASS = _factors(kg=1.0, g=1e-3)
_TEMPERATURE = {
    "degC": (1.0, 0.0),
    "°C": (1.0, 0.0),
    "C": (1.0, 0.0),
    "K": (1.0, -273.15),
    "degF": (5.0 / 9.0, -160.0 / 9.0),
    "°F": (5.0 / 9.0, -160.0 / 9.0),
}
_SHARE = {**_SAME, "%": (0.01, 0.0)}

# By how a column's name ends; the first that fits.
_ENDINGS: Mapping[str, Mapping[str, Conversion]] = {
    "time_s": _TIME,
    "_duty": _SHARE,
    "_coast": _SAME,
    "released": _SAME,
    "_v": _VOLTAGE,
    "_a": _CURRENT,
    "_rps": _SPEED,
    "_rev": _POSITION,
    "_count": _COUNT,
    "_degc": _TEMPERATURE,
    "_deg": _ANGLE,
    "_n": _FORCE,
    "_nm": _TORQUE,
    "_pa": _PRESSURE,
    "_kg": _MASS,
}


def units_of(column: str) -> Mapping[str, Conversion]:
    """The units that a column of ours may be given in."""
    return next(units for ending, units in _ENDINGS.items() if column.endswith(ending))


def conversion(column: str, unit: str) -> Conversion | None:
    """From a unit to that of our column; None where it measures something else."""
    units = units_of(column)
    named = unit.strip().replace("μ", "µ")  # two characters that look alike
    if named in units:
        return units[named]
    if named in ("", column.rpartition("_")[2]):  # `simulate` writes the column's own ending
        return (1.0, 0.0)
    return None


def allowed_units(column: str) -> str:
    """The same for a message."""
    return ", ".join(unit for unit in units_of(column) if unit) or "none"


def near_miss(name: str, columns: tuple[str, ...]) -> tuple[str, str] | None:
    """Our column and the unit that a header like `left_current_ma` seems to mean."""
    stem, _, ending = name.lower().rpartition("_")
    for column in columns:
        if column.rpartition("_")[0] == stem and stem and column != name:
            for unit in units_of(column):
                if unit and unit.lower().replace("/", "p") == ending:
                    return column, unit
    return None
