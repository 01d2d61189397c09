"""Bus faults: a scenario's faults on messages and the bus, resolved with a rig into affected frames."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING

from liftgate_hil.codec.frames import EXTENDED
from liftgate_hil.codec.protection import MessageOptions
from liftgate_hil.config.fault_kinds import BUS, FAULT_KINDS, MESSAGE
from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.stimuli.bus_fault_tables import DIRECTIONS, EVERY, KINDS, RECEIVED, SENT, BusFault

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.config.scenario_tables import Fault

_STANDARD = 0x7FF  # the largest identifier of 11 bits

# The protection signal that a message needs for these kinds of faults.
_NEEDED = {"wrong_counter": "counter", "wrong_checksum": "checksum"}


def located(fault: Fault, rig: Rig) -> Fault:
    """Return a message fault with its `where` as message name, also from a quantity; other faults unchanged."""
    if FAULT_KINDS[fault.kind].of != MESSAGE or fault.where is None:
        return fault
    direction = _direction_of(fault)
    return replace(fault, where=rig.message_at(fault.where, direction & SENT > 0, direction & RECEIVED > 0))


def _direction_of(fault: Fault) -> int:
    """Return the direction of a fault as bits SENT and RECEIVED; both if it states none."""
    return DIRECTIONS.get(fault.values.get("direction", ""), SENT | RECEIVED)


def bus_faults_in(
    fault: Fault, rig: Rig | None, restbus: Collection[str], issues: ConfigIssues
) -> tuple[BusFault, ...]:
    """Return a scenario fault's bus fault in a tuple; empty if its kind is not one on the bus, or without a rig.

    `restbus` are the messages of the restbus, which are sent too. Without a rig an issue is noted.
    """
    if FAULT_KINDS[fault.kind].of not in (MESSAGE, BUS):
        return ()
    if rig is None:
        issues.take([f"{fault.called('kind')}: {fault.kind}: there is no bus; allowed: in a run with a bus"])
        return ()
    values, direction = fault.values, _direction_of(fault)
    return (
        BusFault(
            kind=KINDS.index(fault.kind),
            direction=direction,
            identifier=_identifier(fault, rig, restbus, direction, issues),
            probability=float(values.get("probability", 1.0)),
            delay=float(values.get("delay_s") or 0.0),
            rate=float(values.get("rate") or 0.0),
            seed=int(values["seed"]),
        ),
    )


def _identifier(fault: Fault, rig: Rig, restbus: Collection[str], direction: int, issues: ConfigIssues) -> int:
    """Return the identifier that a fault affects or a babbler sends; EVERY: all, or none fits (an issue)."""
    if fault.kind == "babbling":
        identifier = int(fault.values["id"] or 0)
        return identifier | (EXTENDED if identifier > _STANDARD else 0)
    mappings = rig.outputs if direction == SENT else rig.inputs
    own = [each.message for each in mappings]
    names = list(dict.fromkeys([*own, *(restbus if direction == SENT else ())]))
    needed = _NEEDED.get(fault.kind)
    if needed:
        own_options = {each: rig.options.get(each, MessageOptions()) for each in names}
        names = [each for each in names if getattr(own_options[each], needed) is not None]
    if fault.where is None and names:
        return EVERY
    message = located(fault, rig).where
    if message is None or message not in names:
        allowed = ", ".join(names) or "none"
        which = f"a message with a {needed}" if needed else "a message"
        way = {SENT: "or its restbus sends" if restbus else "sends"}.get(direction, "receives")
        carrier = f" ({message})" if message != fault.where else ""
        text = f"{show(fault.where)}{carrier}: not {which} that the gate {way}"
        issues.take([f"{fault.called('where')}: {text}; allowed: {allowed}, or a quantity in one of them"])
        return EVERY
    return rig.identifier(message)
