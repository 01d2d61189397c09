"""Table of a rig's mapping: messages with their protection, quantities with their conversion and range."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, NamedTuple

from liftgate_hil.codec.bus_config import SignalMapping, is_on, multiplexer_values, pages_of, start_value
from liftgate_hil.codec.counter import Counting
from liftgate_hil.codec.frames import BRS, EXTENDED, FD
from liftgate_hil.codec.protection import MessageOptions, signals_made
from liftgate_hil.codec.rocksoft import Covered, Rocksoft
from liftgate_hil.codec.sending import cycle_of, format_of, send_type_of, timeout_of
from liftgate_hil.config.inject import REQUEST, SIGNAL
from liftgate_hil.config.restbus import Press
from liftgate_hil.config.rig import Rig
from liftgate_hil.described_result import Shown
from liftgate_hil.diagnostics.services import RESETS
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS, PANEL
from liftgate_plant.signals import Signal

if TYPE_CHECKING:
    from cantools.database.can import Message

_MOST = 1.7976931348623157e308


# fmt: off
class MappedSignal(NamedTuple):
    """A quantity on the bus with its signal; range and step of the signal are in the quantity's unit."""

    quantity: Annotated[str, Shown("quantity of the [rig file](rig.md)")]
    signal: Annotated[str, Shown("signal in the database")]
    database_unit: Annotated[str, Shown("unit in the database")]
    unit: Annotated[str, Shown("unit of the quantity")]
    conversion: Annotated[str, Shown("conversion between the two, in words; empty: none")]
    low: Annotated[float, Shown("lowest value, in `unit`")]
    high: Annotated[float, Shown("highest value, in `unit`")]
    step: Annotated[float, Shown("step, in `unit`; 0: a floating-point signal")]


_FORMATS = {0: "classic", FD: "CAN FD", FD | BRS: "CAN FD with BRS"}


class MappedMessage(NamedTuple):
    """A message that carries mapped quantities."""

    message: Annotated[str, Shown("name in the database")]
    identifier: Annotated[int, Shown("CAN identifier, as a number")]
    is_extended: Annotated[bool, Shown("whether the identifier has 29 bits")]
    direction: Annotated[str, Shown("`received` or `sent` by the gate")]
    length: Annotated[int, Shown("length [bytes]")]
    format: Annotated[str, Shown("of the frames as the gate sends them: `classic`, `CAN FD`, `CAN FD with BRS`")]
    cycle_ms: Annotated[float, Shown("cycle time [ms]; 0: none")]
    pages: Annotated[int, Shown("number of multiplexer values with which it is sent in turn")]
    timeout_ms: Annotated[float, Shown("timeout [ms]; 0: its values never expire")]
    send_type: Annotated[str, Shown("`cyclic`, `cyclic while active`, `on events`")]
    protection: Annotated[str, Shown("counter and checksum, in words")]
    signals: Annotated[list[MappedSignal], Shown("its mapped signals")]
    unmapped: Annotated[Mapping[str, str], Shown("its other signals: by name the value with which each is sent; "
        "empty: not read")]


# fmt: on
def mapped_messages(rig: Rig) -> list[MappedMessage]:
    """Return the messages that a rig maps, first those that the gate receives."""
    return [*_messages(rig, "received", rig.inputs, BUS_INPUTS), *_messages(rig, "sent", rig.outputs, BUS_OUTPUTS)]


def protected_besides(rig: Rig) -> dict[str, str]:
    """Return the protection of messages without mapped quantities (restbus), by message name."""
    return {
        name: _protection(options)
        for name, options in rig.options.items()
        if name not in rig.mapped and (options.counter or options.checksum)
    }


def asked_by(rig: Rig) -> dict[str, str]:
    """Return as text how each request reaches an ECU on a bus, by request; `reset`: how the ECU is reset."""
    found = {action: _press(press) for action, press in rig.driver.buttons.items()}
    reset = rig.driver.reset
    if reset is not None:
        parts = [_press(reset.press)] if reset.press is not None else []
        parts += [f"sends ECUReset {reset.uds} (11 {RESETS[reset.uds]:02X})"] if reset.uds else []
        parts += [f"runs {' '.join(reset.command)}"] if reset.command else []
        parts.append(f"then waits for {reset.ready or 'its first command'}")
        found["reset"] = ", ".join(parts)
    return found


def injected_by(rig: Rig) -> dict[str, str]:
    """Return as text the test bench's message and signals for each order, by order (a key of inject.ORDERS)."""
    return {
        each.what: f"{each.message} 0x{each.identifier & ~EXTENDED:X}: "
        + ", ".join(f"{key} {signal}" for key, signal in each.signals.items())
        + (f"; {', '.join(each.labels)}" if each.what in (REQUEST, SIGNAL) else "")
        for each in rig.orders
    }


def _press(press: Press) -> str:
    """Return in words the signal of a button, its value while pressed and otherwise."""
    return f"{press.signal} = {press.value:g} for {press.hold:g} s, else {press.rest:g}"


def _messages(
    rig: Rig, direction: str, wires: Sequence[SignalMapping], quantities: Mapping[str, Signal]
) -> Iterator[MappedMessage]:
    """Yield the messages with these signals, which are all `received` or all `sent` (`direction`)."""
    for name in dict.fromkeys(wire.message for wire in wires):
        message, options = rig.messages[name], rig.options.get(name, MessageOptions())
        own = [wire for wire in wires if wire.message == name]
        cycle = max(0.0, cycle_of(message, options))
        is_stale = direction == "received" and any(wire.quantity not in PANEL for wire in own)
        yield MappedMessage(
            message=name,
            identifier=message.frame_id,
            is_extended=bool(message.is_extended_frame),
            direction=direction,
            length=message.length,
            format=_FORMATS[format_of(message, options)],
            cycle_ms=cycle,
            pages=len(pages_of(message, [wire.signal for wire in own])) if direction == "sent" else 1,
            timeout_ms=timeout_of(message, options) if is_stale else 0.0,
            send_type=send_type_of(message, options).value,
            protection=_protection(options),
            signals=[_signal(rig, wire, quantities[wire.quantity]) for wire in own],
            unmapped=_unmapped(message, options, own, direction == "sent"),
        )


def _unmapped(
    message: Message, options: MessageOptions, own: Sequence[SignalMapping], is_sent: bool
) -> dict[str, str]:
    """Return the signals that neither quantity, protection nor multiplexer sets; values: as sent, "": received."""
    used = {wire.signal for wire in own} | signals_made(message, options)
    others = [each for each in message.signals if each.name not in used]
    if is_sent:  # only the pages with a quantity
        pages = pages_of(message, [wire.signal for wire in own])
        chains = {each.name: multiplexer_values(message, each.name) for each in others}
        others = [each for each in others if any(is_on(page, chains[each.name]) for page in pages)]
    return {
        each.name: f"{start_value(each):.15g} {each.unit or ''}".rstrip() if is_sent else "" for each in others
    }


def _signal(rig: Rig, wire: SignalMapping, quantity: Signal) -> MappedSignal:
    signal = rig.messages[wire.message].get_signal_by_name(wire.signal)
    # A double times a factor may exceed the range of a double.
    low, high = (min(max(end, -_MOST), _MOST) for end in wire.quantity_range(signal))
    return MappedSignal(
        quantity=wire.quantity,
        signal=wire.signal,
        database_unit=signal.unit or "",
        unit=quantity.unit,
        conversion=_conversion(wire, quantity),
        low=low,
        high=high,
        step=0.0 if signal.is_float else abs(wire.scale * float(signal.scale)),
    )


def _conversion(wire: SignalMapping, quantity: Signal) -> str:
    """Return in words how a signal is converted to its quantity, and by what; "": unchanged, "?": unknown."""
    if wire.basis == "unknown":
        return "?"
    if wire.values is not None:
        pairs = ", ".join(f"{name} = {value}" for name, value in wire.values.items())
        return f"{pairs} (by {'the rig' if wire.basis == 'values' else 'label'})"
    if wire.basis == "unit" and (wire.scale, wire.offset) == (1.0, 0.0):
        return ""
    if wire.basis == "labels":
        return "labels as in the database"
    scale = "" if wire.scale == 1.0 else f"{wire.scale:.6g} × "
    offset = "" if wire.offset == 0.0 else f" {wire.offset:+.6g}"
    who = " (by the rig)" if wire.basis == "rig" else ""
    return f"value in {quantity.unit} = {scale}value in {wire.unit}{offset}{who}"


def _protection(options: MessageOptions) -> str:
    """Return the counter and checksum of a message in words."""
    parts = []
    if options.e2e is not None:
        parts.append(options.e2e.profile)
    if options.counter is not None:
        parts.append(f"counter {options.counter}{_counted(options.counting)}")
    if options.checksum is not None:
        kind = f" ({options.checksum_kind})" if options.e2e is None else ""
        if options.own is not None:
            kind = f" ({_parameters(options.own)})"
        parts.append(f"checksum {options.checksum}{kind}")
    return ", ".join(parts) or "none"


def _counted(counting: Counting) -> str:
    """Return in words how a counter counts; "" if the rig has no table for it: by one from 0 over all its bits."""
    if counting.highest is None:
        return ""
    span = f"{counting.lowest} to {counting.highest}"
    return f" ({span}, from {counting.start_value()} in steps of {counting.step})"


def _parameters(own: Rocksoft) -> str:
    """Return the parameters of a checksum in words."""
    digits = (own.width + 3) // 4
    parts = [f"CRC of {own.width} bits, polynomial 0x{own.polynomial:0{digits}X}"]
    parts.append(f"start 0x{own.start:0{digits}X}")
    parts += ["reflected in"] if own.reflect_in else []
    parts += ["reflected out"] if own.reflect_out else []
    parts.append(f"final XOR 0x{own.final_xor:0{digits}X}")
    parts.append("over " + " + ".join(map(_covered, own.covers)))
    if own.data_ids:
        ids = " ".join(f"0x{each:X}" for each in own.data_ids)
        parts.append(f"data ID {ids}" + (" by the counter" if len(own.data_ids) > 1 else ""))
    return ", ".join(parts)


def _covered(covered: Covered) -> str:
    span = "" if covered.first == covered.last else f" to {covered.last}"
    return f"{covered.part} {covered.first}{span}"
