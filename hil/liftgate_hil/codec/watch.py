"""Current values of watched bus signals, each from the last frame of its message, whoever sent it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.codec.bus_config import tables_named
from liftgate_hil.codec.frames import ERROR, FD_FLAGS, REMOTE
from liftgate_hil.codec.receive import find_message, is_whole, physical_of, selected
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.errors import ConfigIssues

if TYPE_CHECKING:
    from cantools.database.can import Message


def watched(messages: Mapping[str, Message], names: Sequence[str], issues: ConfigIssues) -> BusConfig:
    """Return the tables of watched signals (`Message.Signal`), which must exist; values are ordered as `names`."""
    return tables_named(messages, names, {}, issues, False)


def signal_unit(messages: Mapping[str, Message], name: str) -> str | None:
    """Return the unit of a signal `Message.Signal`, "" if it has none; None: there is no such signal."""
    message, _, signal = name.partition(".")
    if message not in messages:
        return None
    found = [each for each in messages[message].signals if each.name == signal]
    return (found[0].unit or "") if found else None


def near_signals(messages: Mapping[str, Message], name: str) -> list[str]:
    """Return up to three signals (`Message.Signal`) whose names are most similar to an unknown one."""
    from difflib import get_close_matches

    own = [messages[name.partition(".")[0]]] if name.partition(".")[0] in messages else []
    known = [f"{each.name}.{one.name}" for each in own or messages.values() for one in each.signals]
    return get_close_matches(name, known, 3, 0.0 if own else 0.6)


@compilable
def watch(
    bus: BusConfig, values: NDArray[np.float64], identifier: int, length: int, data: NDArray[np.uint8], frame: int
) -> None:
    """Write the values of watched signals in a frame (row of `data`) to `values` (n,), in the database's units.

    A frame whose length differs from that of its message is ignored.
    """
    message = -1
    if identifier & (ERROR | REMOTE) == 0:
        message = find_message(bus, identifier & ~FD_FLAGS)
    if message >= 0 and is_whole(bus.messages[message], length):
        first = bus.messages[message].first
        for row in range(first, first + bus.messages[message].count):
            if selected(bus, row, data, frame):
                values[bus.signals[row].quantity] = physical_of(bus, row, data, frame)
