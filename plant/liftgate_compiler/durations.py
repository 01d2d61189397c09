"""Durations of the last compilations on this machine, so that a wait can be announced in advance."""

from __future__ import annotations

import contextlib
import json
import math

from liftgate_compiler import storage
from liftgate_compiler.files import write_whole

_NAME = "durations.json"
_LONGEST = 24 * 3600.0  # s; longer values are ignored as implausible


def expected_s(name: str) -> float | None:
    """Return how long an entry point took to compile the last time [s]; None: unknown."""
    value = _known().get(name)
    return value if value is not None and 0.0 < value < _LONGEST else None


def note(name: str, seconds: float) -> None:
    """Store how long the entry point `name` took to compile [s]; a failure to store it is ignored."""
    found = {**_known(), name: round(seconds, 1)}
    with contextlib.suppress(OSError):
        storage.check_ours(storage.root())
        write_whole(storage.root() / _NAME, json.dumps(found).encode(), mode=0o600)


def _known() -> dict[str, float]:
    try:
        found = json.loads((storage.root() / _NAME).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    if not isinstance(found, dict):
        return {}
    return {
        str(name): float(value)
        for name, value in found.items()
        if isinstance(value, int | float) and math.isfinite(value)
    }
