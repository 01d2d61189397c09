"""Variants of a vehicle file: the car as in the file, one drawn from its `[spread]`, or one without imperfections.

The latter two are values that override the file, as KEY=VALUE does; KEY=VALUE overrides them in turn.
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
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_plant.quantity import Points

# Keys that say how the sensors are built, not what errors they have.
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
_LAW = ("static_ratio", "stribeck_speed", "viscous")  # keys of friction over speed
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
    """A variant of a vehicle file."""

    draw: int | None = None  # seed of a car drawn from the production; None: none is drawn
    is_ideal: bool = False  # the thesis's plant: no sensor errors, torsion, source resistance or wear

    def check(self) -> None:
        """Raise ConfigError if both a draw and the ideal car are requested."""
        if self.draw is not None and self.is_ideal:
            raise ConfigError(f"`draw` {self.draw}: allowed without `ideal`, which has no spread")


AS_FILED = Variant()


def settings_for(raw: Table, variant: Variant, settings: Sequence[Setting], source: str) -> list[Setting]:
    """Return the settings that turn the content `raw` into a variant, then `settings`. Raises ConfigError."""
    variant.check()
    if variant.is_ideal:
        own = _ideal(raw)
    elif variant.draw is not None:
        own = _drawn(raw, variant.draw, settings, source)
    else:
        own = []
    return [*own, *settings]


def _ideal(raw: Table) -> list[Setting]:
    """Return settings that replace values of the file by the defaults, which are ideal."""
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
        raise ConfigError(f"`draw` {seed}: {source} has no table [spread]; allowed: a vehicle with one")
    kept = {setting.names for setting in settings}
    return [
        Setting(names, value, f"`draw` {seed}: ")
        for names, value in drawn(nominal, spreads, seed).items()
        if names not in kept and names[-2:] not in kept
    ]
