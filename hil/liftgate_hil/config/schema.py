"""Schema of the tables in files, defined once: files are validated by it, the documentation is made from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from liftgate_hil.config.kinds import Kind
from liftgate_hil.config.toml import Table, known_keys, number, show
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.stimuli.moments import Instant

LATEST = 1e6  # s


@dataclass(frozen=True)
class When:
    """A time or a condition."""

    allowed: str = f"0 to {LATEST:g} s, or a condition"

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Instant:
        """Return the instant; an issue if it is neither a time nor a condition."""
        if isinstance(value, str) and value.strip():
            return Instant(math.nan, value, key=key, source=issues.source)
        if isinstance(value, bool) or not isinstance(value, int | float):
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return Instant()
        return Instant(number(issues, key, value, 0.0, LATEST, "s, or a condition"))


REQUIRED = object()


@dataclass(frozen=True)
class Key:
    """A key of a table; `told` is its default in words if the value itself does not show it."""

    name: str
    kind: Kind
    meaning: str
    default: Any = REQUIRED
    told: str = ""

    @property
    def default_told(self) -> str:
        """The default in words."""
        if self.default is REQUIRED:
            return "required"
        if self.told or self.default is None or self.default == ():
            return self.told
        return f"{self.default:g}" if isinstance(self.default, float) else str(self.default)


def read_table(issues: ConfigIssues, prefix: str, given: Table, keys: Sequence[Key]) -> dict[str, Any]:
    """Return the values of a table by its keys; issues are noted."""
    known_keys(issues, prefix, given, [key.name for key in keys])
    found: dict[str, Any] = {}
    for key in keys:
        dotted = f"{prefix}.{key.name}" if prefix else key.name
        if key.name in given:
            found[key.name] = key.kind.read(issues, dotted, given[key.name])
        elif key.default is REQUIRED:
            issues.add(dotted, f"missing; allowed: {key.kind.allowed}")
            found[key.name] = None
        else:
            found[key.name] = key.default
    return found
