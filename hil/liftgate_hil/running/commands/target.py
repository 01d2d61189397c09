"""Target of commands, whether a program, a test bench or an operator gives them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

from liftgate_hil.config.scenario_tables import Fault


class Target(Protocol):
    """Interface of what executes commands on a run or a gate."""

    def hold(self, values: Mapping[str, float]) -> None:
        """Hold values, by their names in held_values.NAMES, from the next tick on; NaN: hold it no longer.

        Raises ConfigError where there is no room for so many, and changes nothing then.
        """

    def inject(self, faults: Sequence[Fault]) -> None:
        """Put these faults in force from the next tick on, in place of all that were injected before.

        Where several act on the same thing, they act in their order. Raises ConfigError, and changes nothing then.
        """

    def set_signals(
        self, values: Mapping[str, float], instead_of: float = math.nan, rest: float = math.nan
    ) -> None:
        """Set signals [the database's unit], but only those with the value `instead_of` (NaN: any).

        The value NaN clears a signal, which then has the scenario's value, else `rest`. Raises ConfigError, and
        changes nothing then.
        """

    def reset(self) -> None:
        """Reset the ECU in the rig's way other than a signal. Raises ConfigError where that is not possible."""
