"""A database and a mapping, laid out as tables of numbers that the loop can work through.

One row a mapped signal, one row a message. The same tables serve either end of the bus: the emulator receives
a rig's inputs and sends its outputs, an ECU the other way round.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.codec import checksum
from hil.codec.bits import FLOAT32, FLOAT64, SIGNED, UNSIGNED, Place, write_number
from hil.codec.frames import EXTENDED, FD, MAX_BYTES
from hil.codec.quantities import PANEL, BusQuantity
from hil.config.toml import Faults

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Wire:
    """One mapped signal: quantity = scale · physical value + offset, or a value each by name."""

    quantity: str
    message: str
    signal: str
    scale: float = 1.0
    offset: float = 0.0
    values: Mapping[str, float | str] | None = None


@dataclass(frozen=True)
class MessageOptions:
    """What a rig says about a message besides its signals; None: as the database says."""

    cycle_ms: float | None = None
    timeout_cycles: float = 3.0
    counter: str | None = None
    checksum: str | None = None
    checksum_kind: str = "crc8-sae-j1850"


class Signals(NamedTuple):
    """Rows of mapped signals; n of them, ordered by message."""

    quantity: Ints  # (n,) index into the quantities
    place: Ints  # (n, 5) Place
    select: Ints  # (n, 10) Places of the multiplexer and of that one's own, length 0: none
    select_value: Ints  # (n, 2)
    factor: Floats  # (n,) physical = factor raw + offset
    offset: Floats
    scale: Floats  # (n,) quantity = scale physical + bias
    bias: Floats
    low: Floats  # (n,) allowed physical values
    high: Floats
    raw_low: Floats  # (n,) what fits into the bits and the range
    raw_high: Floats
    quantity_low: Floats  # (n,) allowed values of the quantity
    quantity_high: Floats
    names_first: Ints  # (n,) rows in `ours` and `theirs`, none: -1
    names_count: Ints
    ours: Floats  # enumeration values of ours, and their physical values
    theirs: Floats


class Messages(NamedTuple):
    """Rows of messages; m of them."""

    identifier: Ints  # (m,) with the EXTENDED flag
    fd: Ints  # (m,) FD or 0
    length: Ints  # (m,) bytes
    first: Ints  # (m,) rows in Signals
    count: Ints  # type: ignore[assignment]  # shadows tuple.count
    cycle_ns: Ints  # (m,) 0: not cyclic
    timeout_ns: Ints  # (m,) 0: never goes stale
    counter: Ints  # (m, 5) Place of the alive counter, length 0: none
    checksum_kind: Ints  # (m,)
    checksum_byte: Ints  # (m,)
    start: NDArray[np.uint8]  # (m, 64) payload with start values


class Layout(NamedTuple):
    """All that is received, or all that is sent."""

    messages: Messages
    signals: Signals


def place_of(signal: Signal) -> Place:
    """Where a signal's bits lie."""
    kind = SIGNED if signal.is_signed else UNSIGNED
    if signal.is_float:
        kind = FLOAT32 if signal.length == 32 else FLOAT64
    if signal.byte_order == "little_endian":
        return Place(signal.start // 8, signal.start % 8, signal.length, 1, kind)
    # DBC names a Motorola signal's highest bit; count bits from the frame's first to its last.
    lowest = 8 * (signal.start // 8) + 7 - signal.start % 8 + signal.length - 1
    return Place(lowest // 8, 7 - lowest % 8, signal.length, -1, kind)


def raw_range(signal: Signal) -> tuple[float, float]:
    """What the signal's bits can hold."""
    if signal.is_float:
        top = 3.4028234663852886e38 if signal.length == 32 else 1.7976931348623157e308
        return -top, top
    bits = signal.length - int(signal.is_signed)
    # From 54 bits on the largest value is no double: the next one below it.
    top = 2.0**bits - 1.0 if bits <= 53 else float(np.nextafter(2.0**bits, 0.0))
    return (-(2.0**bits) if signal.is_signed else 0.0), top


def physical_range(signal: Signal) -> tuple[float, float]:
    """The database's range, or what the bits can hold where it has none."""
    factor, offset = _conversion(signal)
    ends = [factor * raw + offset for raw in raw_range(signal)]
    low, high = min(ends), max(ends)
    # [0|0] is how a DBC says that it has no range.
    if (
        signal.minimum is not None
        and signal.maximum is not None
        and signal.minimum < signal.maximum
    ):
        low, high = max(low, float(signal.minimum)), min(high, float(signal.maximum))
    return low, high


def build_layout(
    messages: Mapping[str, Message],
    wires: Sequence[Wire],
    options: Mapping[str, MessageOptions],
    quantities: Mapping[str, BusQuantity],
    faults: Faults,
    sending: bool,
) -> Layout:
    """The tables for these wires; what cannot be laid out is noted in `faults`."""
    names = list(quantities)
    rows: list[dict[str, Any]] = []
    ours: list[float] = []
    theirs: list[float] = []
    order = list(dict.fromkeys(wire.message for wire in wires))
    heads: list[dict[str, Any]] = []
    for name in order:
        message = messages[name]
        first = len(rows)
        for wire in (wire for wire in wires if wire.message == name):
            signal = message.get_signal_by_name(wire.signal)
            if not _is_usable(wire, signal, faults):
                continue
            pairs = _enumeration(wire, signal, quantities[wire.quantity], faults, sending)
            row = _signal_row(wire, signal, quantities[wire.quantity], names.index(wire.quantity))
            row |= {"names_first": len(ours) if pairs else -1, "names_count": len(pairs)}
            ours += [pair[0] for pair in pairs]
            theirs += [pair[1] for pair in pairs]
            for selectors in _selectors(message, signal):
                rows.append(row | {"selectors": selectors})
        head = _message_row(message, options.get(name, MessageOptions()), faults)
        if all(wire.quantity in PANEL for wire in wires if wire.message == name):
            head["timeout_ns"] = 0  # a panel speaks when something changes
        head |= {"first": first, "count": len(rows) - first}
        if sending:
            _check_overlap(name, [wire for wire in wires if wire.message == name], options, faults)
        _put_selectors(head["start"], rows[first:], name, faults if sending else None)
        heads.append(head)
    _fill_selectors(rows, faults)
    return Layout(
        Messages(**{field: _column(heads, field, Messages) for field in Messages._fields}),
        Signals(
            **{field: _column(rows, field, Signals) for field in Signals._fields[:-2]},
            ours=np.array(ours, dtype=np.float64),
            theirs=np.array(theirs, dtype=np.float64),
        ),
    )


def _conversion(signal: Signal) -> tuple[float, float]:
    return float(signal.scale), float(signal.offset)


def _is_usable(wire: Wire, signal: Signal, faults: Faults) -> bool:
    """Whether the signal can carry a number at all."""
    name = f"{wire.message}.{wire.signal}"
    if signal.is_float and signal.length not in (32, 64):
        faults.add(wire.quantity, f"{name}: a float of {signal.length} bits; allowed: 32 or 64")
        return False
    if float(signal.scale) == 0.0:
        faults.add(wire.quantity, f"{name}: factor 0 in the database; allowed: anything else")
        return False
    return True


def _check_overlap(
    name: str, wires: Sequence[Wire], options: Mapping[str, MessageOptions], faults: Faults
) -> None:
    """No two quantities, and no quantity and protection, may be sent in one signal."""
    own = options.get(name, MessageOptions())
    taken = {own.counter: "the counter", own.checksum: "the checksum"}
    for wire in wires:
        if wire.signal in taken:
            faults.add(
                wire.quantity,
                f"{name}.{wire.signal} carries {taken[wire.signal]} too; allowed: one per signal",
            )
        taken[wire.signal] = wire.quantity


def _signal_row(wire: Wire, signal: Signal, quantity: BusQuantity, index: int) -> dict[str, Any]:
    factor, offset = _conversion(signal)
    low, high = physical_range(signal)
    raw = sorted(((low - offset) / factor, (high - offset) / factor))
    bits = raw_range(signal)
    slack = [1e-9 * max(1.0, abs(end)) for end in raw]  # of the way there and back
    return {
        "quantity": index,
        "place": place_of(signal),
        "factor": factor,
        "offset": offset,
        "scale": wire.scale,
        "bias": wire.offset,
        # Half a quantum of slack: a limit need not be a multiple of the factor.
        "low": low - 0.5 * abs(factor) * (not signal.is_float),
        "high": high + 0.5 * abs(factor) * (not signal.is_float),
        "raw_low": raw[0] if signal.is_float else max(np.ceil(raw[0] - slack[0]), bits[0]),
        "raw_high": raw[1] if signal.is_float else min(np.floor(raw[1] + slack[1]), bits[1]),
        "quantity_low": quantity.low,
        "quantity_high": quantity.high,
    }


def _enumeration(
    wire: Wire, signal: Signal, quantity: BusQuantity, faults: Faults, sending: bool
) -> list[tuple[float, float]]:
    """Pairs of our value and their physical value, where the wire names them."""
    if wire.values is None:
        return []
    key = f"{wire.quantity}.values"
    pairs = []
    labels = {str(label): float(raw) for raw, label in (signal.choices or {}).items()}
    factor, offset = _conversion(signal)
    for name, value in wire.values.items():
        if name not in quantity.names:
            allowed = ", ".join(quantity.names) or "none, this is no enumeration"
            faults.add(key, f"{name}: allowed: {allowed}")
        elif isinstance(value, str) and value not in labels:
            allowed = ", ".join(labels) or "numbers, the signal has no value table"
            faults.add(key, f"{name} = {value!r}: allowed: {allowed}")
        elif isinstance(value, str) or abs(value) <= 1e15:
            physical = factor * labels[value] + offset if isinstance(value, str) else float(value)
            pairs.append((float(quantity.names.index(name)), physical))
    missing = [name for name in quantity.names if name not in wire.values]
    if sending and missing:
        faults.add(key, f"{', '.join(missing)} missing; allowed: all that is sent has a value")
    return pairs


_NOWHERE = Place(0, 0, 0, 1, 0)
Selector = tuple[Place, int]


def _selectors(message: Message, signal: Signal) -> list[tuple[Selector, ...]]:
    """Under which values of which multiplexers the signal is in the frame: alternatives, each a chain."""
    if signal.multiplexer_signal is None or not signal.multiplexer_ids:
        return [()]
    multiplexer = message.get_signal_by_name(signal.multiplexer_signal)
    place = place_of(multiplexer)
    return [
        ((place, int(value)), *above)
        for value in signal.multiplexer_ids
        for above in _selectors(message, multiplexer)
    ]


def _message_row(message: Message, options: MessageOptions, faults: Faults) -> dict[str, Any]:
    cycle_ms = options.cycle_ms if options.cycle_ms is not None else message.cycle_time or 0
    counter = _NOWHERE
    kind, checksum_byte = checksum.NONE, -1
    if options.counter is not None:
        counter = place_of(message.get_signal_by_name(options.counter))
        if counter.length > 32:
            faults.add(f"messages.{message.name}.counter", "allowed: a signal of up to 32 bits")
    if options.checksum is not None:
        place = place_of(message.get_signal_by_name(options.checksum))
        kind, checksum_byte = checksum.KINDS[options.checksum_kind], place.byte
        if place.length != 8 or place.shift != 0:
            faults.add(
                f"messages.{message.name}.checksum",
                f"{options.checksum}: allowed: a signal that fills one byte",
            )
    identifier = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
    return {
        "identifier": identifier,
        "fd": FD if message.is_fd else 0,
        "length": message.length,
        "cycle_ns": round(cycle_ms * 1e6),
        "timeout_ns": round(options.timeout_cycles * cycle_ms * 1e6),
        "counter": counter,
        "checksum_kind": kind,
        "checksum_byte": checksum_byte,
        "start": start_payload(message),
    }


def start_payload(message: Message) -> NDArray[np.uint8]:
    """The message with every signal at its start value (GenSigStartValue), 0 where it has none."""
    data = np.zeros((1, MAX_BYTES), dtype=np.uint8)
    for signal in message.signals:
        raw = signal.raw_initial
        if raw is not None and not isinstance(raw, str) and signal.multiplexer_signal is None:
            low, high = raw_range(signal)
            write_number(data, 0, place_of(signal), min(max(float(raw), low), high))
    payload: NDArray[np.uint8] = data[0]
    return payload


def _put_selectors(
    start: NDArray[np.uint8], rows: Sequence[dict[str, Any]], name: str, faults: Faults | None
) -> None:
    """Write the multiplexer's value into a sent message; it can have only one."""
    chosen = {selector for row in rows for selector in row["selectors"]}
    for place, value in chosen:
        write_number(start.reshape(1, MAX_BYTES), 0, place, float(value))
    if faults is not None and len({place for place, _ in chosen}) < len(chosen):
        faults.add(f"outputs in {name}", "allowed: signals of one multiplexer value only")


def _fill_selectors(rows: Sequence[dict[str, Any]], faults: Faults) -> None:
    """The chains of selectors as columns of two."""
    for row in rows:
        chain = row["selectors"]
        if len(chain) > 2:
            faults.add("multiplexing", "three levels deep; allowed: two")
        padded = [*chain, (_NOWHERE, 0), (_NOWHERE, 0)][:2]
        row["select"] = [number for place, _ in padded for number in place]
        row["select_value"] = [value for _, value in padded]


def _column(rows: Sequence[Mapping[str, Any]], field: str, table: type) -> Any:
    kinds = {"identifier": np.int64, "start": np.uint8}
    floats = {
        "factor", "offset", "scale", "bias", "low", "high",
        "raw_low", "raw_high", "quantity_low", "quantity_high",
    }  # fmt: skip
    dtype = kinds.get(field, np.float64 if field in floats else np.int64)
    widths = {"place": 5, "select": 10, "select_value": 2, "counter": 5, "start": MAX_BYTES}
    column = np.array([row[field] for row in rows], dtype=dtype)
    if field in widths:
        column = column.reshape(len(rows), widths[field])
    return column
