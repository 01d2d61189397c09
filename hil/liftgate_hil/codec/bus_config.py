"""Conversion of a database and a signal mapping into the tables that the loop works on.

Each message has one row, each mapped signal one per alternative of its multiplexers' values. The same tables serve
both ends of the bus: the emulator receives a rig's inputs and sends its outputs, an ECU the other way round.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.bits import UNSIGNED, BitPlace, write_number
from liftgate_hil.codec.frames import EXTENDED, MAX_BYTES
from liftgate_hil.codec.protection import MessageOptions, place_of, protection_row
from liftgate_hil.codec.sending import LONGEST_MS, cycle_of, format_of, padded_length, timeout_of
from liftgate_hil.codec.tables import MESSAGE, SIGNAL, BusConfig, TableRows, add_row, row_of
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.signals import PANEL
from liftgate_plant import signals

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

ANY = signals.Signal("", -np.inf, np.inf, "")  # quantity of an unconverted signal


@dataclass(frozen=True)
class SignalMapping:
    """Mapping of a bus signal to a quantity: quantity = scale · physical value + offset, or one value per name.

    `basis` says where the conversion comes from: "unit" (the signal's unit, `unit`), "rig" (the rig's scale and
    offset), "labels" (of the database), "values" (of the rig), or "unknown". With `saturates` the rig states that
    the signal stays at the ends of its range.
    """

    quantity: str
    message: str
    signal: str
    scale: float = 1.0
    offset: float = 0.0
    values: Mapping[str, float | str] | None = None
    basis: str = "rig"
    unit: str = ""
    saturates: bool = False

    def quantity_range(self, signal: Signal) -> tuple[float, float]:
        """Return lowest and highest value of the signal by `physical_range`, in the quantity's unit."""
        ends = [self.scale * end + self.offset for end in physical_range(signal)]
        return min(ends), max(ends)


def mapping_named(name: str) -> SignalMapping:
    """Return the unconverted mapping of a signal (`Message.Signal`) to a quantity of the same name."""
    message, _, signal = name.partition(".")
    return SignalMapping(name, message, signal)


def identifier_of(message: Message) -> int:
    """Return a message's identifier, with SocketCAN's flag EXTENDED if it is extended."""
    return int(message.frame_id | (EXTENDED if message.is_extended_frame else 0))


def raw_range(signal: Signal) -> tuple[float, float]:
    """Return the lowest and the highest raw value that a signal's bits can hold."""
    if signal.is_float:
        top = 3.4028234663852886e38 if signal.length == 32 else 1.7976931348623157e308
        return -top, top
    bits = signal.length - int(signal.is_signed)
    # From 54 bits on the largest value is not a double: take the next one below.
    top = 2.0**bits - 1.0 if bits <= 53 else float(np.nextafter(2.0**bits, 0.0))
    return (-(2.0**bits) if signal.is_signed else 0.0), top


def physical_range(signal: Signal) -> tuple[float, float]:
    """Return a signal's lowest and highest physical value by the database's range, if any, and by its bits."""
    factor, offset = _conversion(signal)
    ends = [factor * raw + offset for raw in raw_range(signal)]
    low, high = min(ends), max(ends)
    least, most = signal.minimum, signal.maximum
    if least is not None and most is not None and least >= most:  # a DBC writes [0|0] for no range
        return low, high
    return low if least is None else max(low, float(least)), high if most is None else min(high, float(most))


def counted_range(signal: Signal) -> tuple[int, int]:
    """Return the lowest and highest raw value of an integer signal by the database's range and its bits."""
    factor, offset = _conversion(signal)
    if factor == 0.0:
        return 0, int(raw_range(signal)[1])
    ends = sorted(round((end - offset) / factor) for end in physical_range(signal))
    return ends[0], ends[1]


def build_bus_config(
    messages: Mapping[str, Message],
    mappings: Sequence[SignalMapping],
    options: Mapping[str, MessageOptions],
    quantities: Mapping[str, signals.Signal],
    issues: ConfigIssues,
    sending: bool,
) -> BusConfig:
    """Return the tables for these signal mappings; what cannot be laid out is noted in `issues`.

    `messages` are the database's by name, `options` the rig's by message. `quantities` are all that
    can be mapped, in the order of the values that the tables refer to. `sending`: the loop sends the messages
    rather than receives them.
    """
    tables = TableRows()
    places = {quantity: place for place, quantity in enumerate(quantities)}
    wires: dict[str, list[SignalMapping]] = {}
    for wire in mappings:
        wires.setdefault(wire.message, []).append(wire)
    for name, own in wires.items():
        message = messages[name]
        if message.length > MAX_BYTES:
            issues.add(name, f"{message.length} bytes; allowed: a message of one frame, up to {MAX_BYTES}")
            continue
        first = len(tables.signals)
        pages = pages_of(message, [wire.signal for wire in own])
        if len(pages) > MAX_PAGES:
            issues.add(name, f"{len(pages)} multiplexer values are mapped; allowed: up to {MAX_PAGES}")
            continue
        for wire in own:
            signal = message.get_signal_by_name(wire.signal)
            quantity = quantities[wire.quantity]
            if not _is_usable(wire, signal, issues):
                continue
            pairs = _enumeration(wire, signal, quantity)
            row = _signal_row(wire, signal, quantity)
            if sending and quantity is ANY:  # its values are checked, and a label may be beyond the range
                row["raw_low"], row["raw_high"] = raw_range(signal)
            row["quantity"] = places[wire.quantity]
            row["place"] = add_row(tables.places, place_of(signal))
            chains = multiplexer_values(message, wire.signal)
            row["pages"] = sum(is_on(page, chains) << k for k, page in enumerate(pages))
            row |= {"names_first": len(tables.names), "names_count": len(pairs)}
            tables.names += pairs
            for chain in _selectors(message, signal):
                row |= {"selectors_first": len(tables.selectors), "selectors_count": len(chain)}
                tables.selectors += [(add_row(tables.places, place), value) for place, value in chain]
                tables.signals.append(row_of(SIGNAL, row))
        options_of = options.get(name, MessageOptions())
        head = _message_row(message, options_of, tables, issues)
        if all(wire.quantity in PANEL for wire in own):
            head["timeout_ns"] = 0  # a panel sends only when something changes
        head |= {"first": first, "count": len(tables.signals) - first}
        _check_overlap(name, own, options_of, pages[0], issues, sending)
        head |= {"pages": len(pages), "start": len(tables.start)}
        tables.messages.append(row_of(MESSAGE, head))
        tables.start += [start_payload(message, page) for page in pages]
    return tables.bus()


@functools.cache
def _no_tables() -> BusConfig:
    """Return empty tables, of no signals, in which nothing is ever written."""
    return TableRows().bus()


def tables_named(
    messages: Mapping[str, Message],
    names: Sequence[str],
    options: Mapping[str, MessageOptions],
    issues: ConfigIssues,
    sending: bool,
) -> BusConfig:
    """Return the tables of named signals (`Message.Signal`), unconverted, in the database's units.

    Their values have the same places as in `names`.
    """
    if not names:
        return _no_tables()
    mappings = list(map(mapping_named, names))
    return build_bus_config(messages, mappings, options, dict.fromkeys(names, ANY), issues, sending)


def _conversion(signal: Signal) -> tuple[float, float]:
    """Return factor and offset of a signal: physical value = factor · raw value + offset."""
    return float(signal.scale), float(signal.offset)


def _is_usable(wire: SignalMapping, signal: Signal, issues: ConfigIssues) -> bool:
    """Whether a signal can carry a quantity's number at all; if not, the reason is noted in `issues`."""
    name = f"{wire.message}.{wire.signal}"
    if signal.is_float and signal.length not in (32, 64):
        issues.add(wire.quantity, f"{name}: a float of {signal.length} bits; allowed: 32 or 64")
        return False
    if signal.length > 64:
        issues.add(wire.quantity, f"{name}: {signal.length} bits; allowed: up to 64")
        return False
    low, high = physical_range(signal)
    if low > high:
        issues.add(wire.quantity, f"{name}: its range in the database is beyond what its bits can hold")
        return False
    if float(signal.scale) == 0.0:
        issues.add(wire.quantity, f"{name}: factor 0 in the database; allowed: anything else")
        return False
    return True


def _check_overlap(
    name: str,
    mappings: Sequence[SignalMapping],
    own: MessageOptions,
    multiplexers: Iterable[str],
    issues: ConfigIssues,
    sending: bool,
) -> None:
    """Note an issue where a signal has two uses, save one received for several quantities or as multiplexer."""
    taken: dict[str, str] = dict.fromkeys(multiplexers, "the multiplexer") if sending else {}
    for signal, what in (
        (own.counter, "the counter"),
        (own.checksum, "the checksum"),
        (own.e2e.nibble if own.e2e is not None else None, "the data ID's nibble"),
    ):
        if signal in taken:
            issues.add(f"messages.{name}", f"{signal} is {taken[signal]} and {what}; allowed: one use per signal")
        if signal is not None:
            taken[signal] = what
    for wire in mappings:
        if wire.signal in taken:
            issues.add(
                f"{'outputs' if sending else 'inputs'}.{wire.quantity}",
                f"{name}.{wire.signal} carries {taken[wire.signal]} too; allowed: one use per signal",
            )
        if sending:
            taken[wire.signal] = wire.quantity


def _signal_row(wire: SignalMapping, signal: Signal, quantity: signals.Signal) -> dict[str, float]:
    """Return the columns of tables.SIGNAL for a signal's conversion and ranges, by column name."""
    factor, offset = _conversion(signal)
    low, high = physical_range(signal)
    raw = sorted(((low - offset) / factor, (high - offset) / factor))
    bits = raw_range(signal)
    # Tolerance for rounding in both directions; for long signals less than a quantum.
    slack = [min(1e-9 * max(1.0, abs(end)), 0.25) for end in raw]
    return {
        "factor": factor,
        "offset": offset,
        "scale": wire.scale,
        "bias": wire.offset,
        # Half a quantum of slack: a limit need not be a multiple of the factor.
        "low": low - 0.5 * abs(factor) * (not signal.is_float),
        "high": high + 0.5 * abs(factor) * (not signal.is_float),
        # A double's range times a factor may be infinite, but the bits cannot hold more than their range.
        "raw_low": max(raw[0] if signal.is_float else np.ceil(raw[0] - slack[0]), bits[0]),
        "raw_high": min(raw[1] if signal.is_float else np.floor(raw[1] + slack[1]), bits[1]),
        "quantity_low": quantity.low,
        "quantity_high": quantity.high,
    }


def _enumeration(wire: SignalMapping, signal: Signal, quantity: signals.Signal) -> list[tuple[float, float]]:
    """Return pairs (quantity's value, physical value) for each name in the mapping's `values`."""
    factor, offset = _conversion(signal)
    pairs = []
    for name, value in (wire.values or {}).items():
        if name not in quantity.values:
            continue
        # Several raw values may have one label: all are received, and of the pairs the last one is sent.
        raws = [float(raw) for raw, label in (signal.choices or {}).items() if str(label) == value]
        physical = [factor * raw + offset for raw in reversed(raws)] if isinstance(value, str) else [float(value)]
        pairs += [(float(quantity.values.index(name)), each) for each in physical]
    return pairs


def _selectors(message: Message, signal: Signal) -> list[tuple[tuple[BitPlace, int], ...]]:
    """Return the alternatives of `multiplexer_values` with bit places in place of multiplexer names."""
    return [
        tuple((place_of(message.get_signal_by_name(name)), value) for name, value in chain.items())
        for chain in multiplexer_values(message, signal.name)
    ]


def _message_row(
    message: Message, options: MessageOptions, tables: TableRows, issues: ConfigIssues
) -> dict[str, int]:
    """Return a message's columns of tables.MESSAGE except pages and signals; places they need go to `tables`."""
    cycle_ms = min(max(cycle_of(message, options), 0.0), LONGEST_MS)
    return {
        "identifier": identifier_of(message),
        "format": format_of(message, options),
        "length": message.length,
        "padded": padded_length(message),
        "cycle_ns": round(cycle_ms * 1e6),
        "timeout_ns": round(min(timeout_of(message, options), options.timeout_cycles * cycle_ms) * 1e6),
        **protection_row(message, options, tables, issues),
    }


def start_payload(message: Message, page: Mapping[str, int]) -> NDArray[np.uint8]:
    """Return the payload of a multiplexer page with all its signals at their start values, see `raw_start`.

    `page` has the values of the multiplexers, by name.
    """
    data = np.zeros((1, MAX_BYTES), dtype=np.uint8)
    for signal in message.signals:
        if signal.raw_initial is not None and is_on(page, multiplexer_values(message, signal.name)):
            place, raw = place_of(signal), raw_start(signal)
            if signal.is_float and signal.length == 16:
                place, raw = place._replace(kind=UNSIGNED), float(np.float16(raw).view(np.uint16))
            write_number(data, 0, place, raw)
    for name, value in page.items():
        write_number(data, 0, place_of(message.get_signal_by_name(name)), float(value))
    payload: NDArray[np.uint8] = data[0]
    return payload


def raw_start(signal: Signal) -> float:
    """Return a signal's raw start value (GenSigStartValue), limited to its bits; 0 if the database has none."""
    raw = signal.raw_initial
    if raw is None or isinstance(raw, str):
        return 0.0
    low, high = raw_range(signal)
    return min(max(float(raw) if signal.is_float else float(int(raw)), low), high)


def start_value(signal: Signal) -> float:
    """Return a signal's physical start value [the database's unit]."""
    return float(signal.scale) * raw_start(signal) + float(signal.offset)


MAX_PAGES = 62  # bits used of SIGNAL's `pages`


def multiplexer_values(message: Message, signal: str) -> list[dict[str, int]]:
    """Return the sets of values, by multiplexer, with which a signal is in the frame; [{}]: it always is."""
    found = message.get_signal_by_name(signal)
    if found.multiplexer_signal is None or not found.multiplexer_ids:
        return [{}]
    return [
        {found.multiplexer_signal: int(value), **above}
        for value in found.multiplexer_ids
        for above in multiplexer_values(message, found.multiplexer_signal)
    ]


def pages_of(message: Message, mapped: Iterable[str]) -> list[dict[str, int]]:
    """Return a message's pages, sent in turn: sets of values by multiplexer; [{}] if nothing is multiplexed.

    Each mapped signal is on at least one page.
    """
    pages: list[dict[str, int]] = []
    places = [multiplexer_values(message, signal) for signal in mapped]
    for chains in sorted(places, key=len):  # signals with the fewest alternatives come first
        if any(is_on(page, chains) for page in pages):
            continue
        free = [
            (page, chain)
            for chain in chains
            for page in pages
            if all(page.get(name, value) == value for name, value in chain.items())
        ]
        if free:
            page, chain = free[0]
            page |= chain
        else:
            pages.append(dict(chains[0]))
    return sorted(pages, key=lambda page: sorted(page.items())) or [{}]


def is_on(page: Mapping[str, int], chains: Iterable[Mapping[str, int]]) -> bool:
    """Whether a signal with the alternatives `chains` of multiplexer values is on a page."""
    return any(page.items() >= chain.items() for chain in chains)
