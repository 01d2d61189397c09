"""Which car of a vehicle file: as the file has it, one of its `[spread]`, or one without imperfections.

Either is values put over the file, as by KEY=VALUE, and such values put over it hold.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

from liftgate_hil.config.settings import Setting, applied
from liftgate_hil.config.spread import drawn, spreads_of
from liftgate_hil.config.toml import Table
from liftgate_hil.config.vehicle_keys import BODY_TABLES, DRIVE_TABLES, SIDES, keys_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.issues import ConfigIssues
from liftgate_plant.quantity import Points

# What says how the sensors are built, and not how they err.
_BUILD = (
    "hall_counts",
    "hall_sample_period",
    "acceleration_distance",
    "current_limit",
    "current_window",
    "shunt_low_side",
    "shunt_sampled_on",
    "commutator_segments",
    "commutator_brushes",
)
_LAW = ("static_ratio", "stribeck_speed", "viscous")  # of friction over speed
_TABLES = {**DRIVE_TABLES, **BODY_TABLES}
IDEAL = {
    "friction": tuple(key for key in keys_of(DRIVE_TABLES["friction"]) if key not in _LAW),
    "thermal": ("enabled",),
    "clutch": ("torque",),
    "cutout": ("resistance",),
    "bridge": ("pwm_frequency", "freewheeling"),
    "sensors": tuple(key for key in keys_of(BODY_TABLES["sensors"]) if key not in _BUILD),
    "gate": ("torsional_stiffness", "torsional_damping", "torsional_inertia"),
    "supply": ("internal_resistance",),
}


class Variant(NamedTuple):
    """Which car."""

    draw: int | None = None  # the seed of one of the production
    is_ideal: bool = (
        False  # the thesis's plant: no errors of sensors, torsion, source resistance, wear
    )

    def check(self) -> None:
        """Raises ConfigError where both are asked for."""
        if self.draw is not None and self.is_ideal:
            raise ConfigError(f"`draw` {self.draw}: allowed without `ideal`, which has no spread")


AS_FILED = Variant()


def settings_for(
    raw: Table, variant: Variant, settings: Sequence[Setting], source: str
) -> list[Setting]:
    """The values of that car and then `settings`, to be put over a file's content `raw`. Raises ConfigError."""
    variant.check()
    if variant.is_ideal:
        own = _ideal(raw)
    elif variant.draw is not None:
        own = _drawn(raw, variant.draw, settings, source)
    else:
        own = []
    return [*own, *settings]


def _ideal(raw: Table) -> list[Setting]:
    """The defaults, which are ideal, in place of the file's values."""
    result = []
    for path in [*((name,) for name in IDEAL), *itertools.product(SIDES, IDEAL)]:
        given: Any = raw
        for name in path:
            given = given.get(name) if isinstance(given, dict) else None
        if not isinstance(given, dict):
            continue
        for key, about in keys_of(_TABLES[path[-1]]).items():
            if key in IDEAL[path[-1]] and key in given:
                value = about.default
                if about.kind is Points:
                    value = []
                elif about.kind is float:
                    value /= about.quantity.scale
                result.append(Setting((*path, key), value, "`ideal` "))
    return result


def _drawn(raw: Table, seed: int, settings: Sequence[Setting], source: str) -> list[Setting]:
    nominal = copy.deepcopy(raw)
    issues = ConfigIssues(source, applied(nominal, settings))
    spreads = spreads_of(issues, nominal)
    issues.raise_if_any()
    if not spreads:
        raise ConfigError(f"`draw` {seed}: {source} has no table [spread]; allowed: with one")
    kept = {setting.names for setting in settings}
    return [
        Setting(names, value, f"`draw` {seed}: ")
        for names, value in drawn(nominal, spreads, seed).items()
        if names not in kept and names[-2:] not in kept
    ]
