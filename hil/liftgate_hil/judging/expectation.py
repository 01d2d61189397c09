"""Expectations on a run, as defined in a scenario."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from liftgate_hil.conditions.parser import with_numbers

KINDS = ("always", "eventually", "never", "dtc")
PRESENT, ABSENT = STATES = ("present", "absent")  # of a trouble code


@dataclass(frozen=True)
class Expectation:
    """A condition that must hold always, eventually or never in a time window, or a trouble code.

    The ECU reports a trouble code (`condition`) in a response in the window, or in none (`state`). `after` opens
    the window: a time [s], or the first time that a condition is true; `within` [s] is its length, to the run's
    end where it is infinite. `hold` [s] is the hold time: how long a condition must hold without interruption.
    """

    name: str
    kind: str  # one of KINDS
    condition: str
    after: float | str = 0.0
    within: float = math.inf
    hold: float = 0.0
    key: str = ""  # its key in the file, such as expect[0]
    state: str = ""  # of a trouble code: one of STATES
    source: str = field(default="", compare=False)  # the file; "": the scenario's

    @property
    def is_always(self) -> bool:
        """Whether a single tick can violate the expectation, but not fulfil it."""
        return self.kind in ("always", "never") or self.state == ABSENT

    @property
    def formula(self) -> str:
        """Text of the expectation: kind, condition and hold time; of a trouble code: kind, code and state."""
        if self.kind == "dtc":
            return f"dtc {self.condition} {self.state}"
        held = f" for {self.hold:g} s without interruption" if self.hold else ""
        return f"{self.kind} {self.condition}{held}"

    def with_numbers(self, parameters: Mapping[str, float]) -> Expectation:
        """Return the expectation with the scenario's parameters in its texts replaced by numbers."""
        after = with_numbers(self.after, parameters) if isinstance(self.after, str) else self.after
        return replace(self, condition=with_numbers(self.condition, parameters), after=after)
