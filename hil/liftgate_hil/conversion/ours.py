"""Our columns in a bus log: which of the decoded signals a rig maps to which of them, in our units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.setup import rig_from
from liftgate_hil.signals import OUTPUT_COLUMNS

if TYPE_CHECKING:
    from liftgate_hil.codec.bus_config import SignalMapping

# The output that a rig must map for each column.
OUTPUT_OF = {column: output for output, column in OUTPUT_COLUMNS.items()}


def mappings_of(rig: str) -> dict[str, SignalMapping]:
    """Return a rig's signal mappings by our column that each carries; none for a database."""
    try:
        outputs = rig_from(rig).outputs
    except ConfigError:
        return {}
    return {OUTPUT_COLUMNS[each.quantity]: each for each in outputs if each.quantity in OUTPUT_COLUMNS}


def ours_in(rig: str, names: Sequence[str]) -> dict[str, str]:
    """Return which decoded signals (`names`) stand for which of our columns, by a rig's file."""
    wired = {column: f"{wire.message}.{wire.signal}" for column, wire in mappings_of(rig).items()}
    return {column: name for column, name in wired.items() if name in names}
