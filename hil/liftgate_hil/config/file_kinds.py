"""Kinds of our TOML files, told apart by their keys: a file of another kind than expected gets one message."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from liftgate_hil.config.toml import Table
from liftgate_hil.errors import ConfigError

# Some keys of each kind, which no other kind has.
MARKS = {
    "rig": ("dbc", "inputs", "outputs"),
    "vehicle": ("drives", "motor", "gear", "spindle"),
    "scenario": ("expect", "request", "obstacle", "profile", "fault", "precondition"),
    "campaign": ("part",),
}
_SHARED = {"description"}  # keys of several kinds


def check_kind(path: Path, content: Table, kind: str, known: Collection[str]) -> None:
    """Raise ConfigError where a file has none of the `known` keys of its kind, and keys of another kind."""
    if not content.keys().isdisjoint({*known} - _SHARED):
        return
    for other, marks in MARKS.items():
        if other != kind and not content.keys().isdisjoint(marks):
            raise ConfigError(
                f"{path}: a {other} file, not a {kind}; allowed: a {kind} with {', '.join(MARKS[kind])}, …"
            )
