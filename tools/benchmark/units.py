"""Times with their units, and paragraphs, as the report shows them."""

from __future__ import annotations

import math

STEPS = {"s": 1.0, "ms": 1e3, "µs": 1e6, "ns": 1e9}


def shown(seconds: float) -> str:
    """Return a time [s] as text with its unit."""
    unit = list(STEPS)[min(3, max(0, -math.floor(math.log10(seconds) / 3.0)))]
    return f"{seconds * STEPS[unit]:.1f} {unit}"


def paragraph(text: str) -> str:
    """Return a text as one line, with single blanks between its words."""
    return " ".join(text.split())
