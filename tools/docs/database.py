"""Page docs/database.md: messages and signals of the shipped database, and what the shipped rig maps to them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from liftgate_hil.config.rig import load_rig
from liftgate_hil.config.shipped import find_config
from tools.docs.markdown import code, number, page, table

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

    from liftgate_hil.config.rig import Rig

_INTRO = """\
`dbc/liftgate.dbc`, with the quantities that the rig `liftgate` maps to its signals ([rig file](rig.md)). With
[your own DBC](own-dbc.md) all of this is yours."""


def database_page() -> str:
    """Return the text of the page."""
    rig = load_rig(find_config("rigs", "liftgate"))
    quantities = {f"{each.message}.{each.signal}": each.quantity for each in (*rig.inputs, *rig.outputs)}
    messages = sorted(rig.messages.values(), key=lambda each: each.frame_id)
    return page(
        "The shipped database", _INTRO, *(part for each in messages for part in _message(each, rig, quantities))
    )


def _message(message: Message, rig: Rig, quantities: dict[str, str]) -> Iterator[str]:
    """Yield the section of a message."""
    cycle = rig.cycle_ms(message.name) if message.name in rig.mapped else 0.0
    facts = [
        f"identifier 0x{message.frame_id:X}",
        f"{message.length} byte{'s' * (message.length > 1)}",
        f"sent by {', '.join(message.senders)}",
    ]
    facts += [f"every {number(cycle)} ms"] if cycle else []
    yield f"## {code(message.name)}"
    yield "; ".join(facts) + (f". {message.comment}" if message.comment else ".")
    rows = [_signal(message, each, quantities) for each in message.signals]
    yield table(["signal", "bits", "factor, offset", "unit", "range", "quantity", "labels"], rows)


def _signal(message: Message, signal: Signal, quantities: dict[str, str]) -> tuple[str, ...]:
    order = "Intel" if signal.byte_order == "little_endian" else "Motorola"
    known = [each for each in (signal.minimum, signal.maximum) if each is not None]
    labels = ", ".join(f"{raw} {name}" for raw, name in (signal.choices or {}).items())
    return (
        code(signal.name),
        f"{signal.start}, {signal.length}, {order}, {'signed' if signal.is_signed else 'unsigned'}",
        f"{number(signal.scale)}, {number(signal.offset)}",
        signal.unit or "",
        " to ".join(number(each) for each in known) if len(known) == 2 else "",
        code(quantities.get(f"{message.name}.{signal.name}", "")),
        labels,
    )
