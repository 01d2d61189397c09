"""Whom orders are for, whoever gives them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

from liftgate_hil.config.scenario import Fault


class Target(Protocol):
    """Whom the orders are for."""

    def inject(self, faults: Sequence[Fault]) -> None:
        """These are in force from the next tick on, of all that can be ordered, the later ones on top. Raises
        ConfigError, and changes nothing then.
        """

    def set_signals(
        self, values: Mapping[str, float], instead_of: float = math.nan, rest: float = math.nan
    ) -> None:
        """Give signals that can be set values [the database's unit], where they have that one (NaN: any). NaN is
        none any more: they have that of the scenario, else `rest`. Raises ConfigError, and changes nothing then.
        """

    def reset(self) -> None:
        """Restart the ECU by what the rig has but a signal. Raises ConfigError where that cannot be."""
