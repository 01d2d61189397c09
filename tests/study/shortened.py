"""The studies shortened, with STUDY=short: two seeds, the first case of each, and no word on spreads."""

from __future__ import annotations

import os

SHORT = os.environ.get("STUDY") == "short"
_FEW = 2


def seeds(count: int) -> range:
    """So many seeds, or a few of them."""
    return range(min(count, _FEW) if SHORT else count)
