"""Which car of a vehicle file: as the file has it, one of its `[spread]`, or one without imperfections.

Either is values put over the file, as by KEY=VALUE, and such values put over it hold.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import NamedTuple

from liftgate_hil.config.settings import Setting, applied
from liftgate_hil.config.spread import drawn, spreads_of
from liftgate_hil.config.toml import Table
from liftgate_hil.config.vehicle_keys import BODY_TABLES, keys_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.issues import ConfigIssues

# What says how the sensors are built, and not how they err.
_BUILD = ("hall_counts", "hall_sample_period", "acceleration_distance", "current_limit")
IDEAL = {
    "sensors": tuple(key for key in keys_of(BODY_TABLES["sensors"]) if key not in _BUILD),
    "gate": ("torsional_stiffness", "torsional_damping", "torsional_inertia"),
    "supply": ("internal_resistance",),
}


class Variant(NamedTuple):
    """Which car."""

    draw: int | None = None  # the seed of one of the production
    is_ideal: bool = False  # without errors of sensors, torsion, source resistance

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
    for name, keys in IDEAL.items():
        given = raw.get(name, {})
        for key, about in keys_of(BODY_TABLES[name]).items():
            if key in keys and isinstance(given, dict) and key in given:
                value = about.default / about.quantity.scale
                result.append(Setting((name, key), value, "`ideal` "))
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
