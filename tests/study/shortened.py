"""Shortened studies, with STUDY=short: two seeds, the first case of each, no check of spreads."""

from __future__ import annotations

import os

SHORT = os.environ.get("STUDY") == "short"
_FEW = 2


def seeds(count: int) -> range:
    """Range of this many seeds, or of two with STUDY=short."""
    return range(min(count, _FEW) if SHORT else count)
