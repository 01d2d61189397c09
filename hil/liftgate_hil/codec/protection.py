"""Protection of messages by counter and checksum: settings in a rig, and columns in the loop's tables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec import checksum
from liftgate_hil.codec.bits import FLOAT32, FLOAT64, SIGNED, UNSIGNED, BitPlace
from liftgate_hil.codec.counter import MOST_VALUES, Counting
from liftgate_hil.codec.rocksoft import Rocksoft
from liftgate_hil.codec.tables import TableRows, add_row
from liftgate_hil.errors import ConfigIssues

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal


BY_ONE = Counting()  # by 1 from 0 on, as wide as its signal


@dataclass(frozen=True)
class EndToEnd:
    """Settings of an AUTOSAR E2E profile; by default its state machine rejects every frame with an error."""

    profile: str  # one of checksum.PROFILES
    data_ids: tuple[int, ...]  # one; in profile 2 sixteen
    data_id_mode: str = "both"  # one of checksum.DATA_ID_MODES
    nibble: str | None = None  # signal that carries the data ID's nibble
    max_delta: int = 1  # largest tolerated step of the counter; 1: no frame may be lost
    sync: int = 0  # frames after a wrong sequence that are not used
    window: int = 1  # frames that the state machine evaluates
    min_ok: tuple[int, int, int] = (1, 1, 1)  # in INIT, VALID, INVALID
    max_error: tuple[int, int, int] = (0, 0, 0)

    def row(self, nibble: int) -> tuple[Any, ...]:
        """Return the settings as a row of tables.END_TO_END; `nibble` is the row of its bit place, or −1."""
        mode = checksum.DATA_ID_MODES[self.data_id_mode]
        ids = (self.data_ids * 16)[:16]
        return ids, mode, nibble, self.max_delta, self.sync, self.window, self.min_ok, self.max_error


@dataclass(frozen=True)
class MessageOptions:
    """A rig's settings for a message; None: cycle and bit rate switch as in the database, others absent."""

    cycle_ms: float | None = None
    timeout_cycles: float = 3.0
    counter: str | None = None
    checksum: str | None = None
    checksum_kind: str = "crc8-sae-j1850"
    e2e: EndToEnd | None = None
    counting: Counting = BY_ONE
    brs: bool | None = None  # bit rate switch of CAN FD frames
    own: Rocksoft | None = None  # replaces `checksum_kind`


def place_of(signal: Signal) -> BitPlace:
    """Return the BitPlace of a database's signal in its message."""
    kind = SIGNED if signal.is_signed else UNSIGNED
    if signal.is_float:
        kind = FLOAT32 if signal.length == 32 else FLOAT64
    if signal.byte_order == "little_endian":
        return BitPlace(signal.start // 8, signal.start % 8, signal.length, 1, kind)
    # DBC names a Motorola signal's highest bit; count bits from the frame's first to its last.
    lowest = 8 * (signal.start // 8) + 7 - signal.start % 8 + signal.length - 1
    return BitPlace(lowest // 8, 7 - lowest % 8, signal.length, -1, kind)


def own_bits(message: Message, name: str) -> NDArray[np.uint8]:
    """Return the mask (bytes,) of a message's payload bits that a signal occupies."""
    place = place_of(message.get_signal_by_name(name))
    bits = np.zeros(message.length, dtype=np.uint8)
    byte, bit = place.byte, place.shift
    for _ in range(place.length):
        bits[byte] |= 1 << bit
        bit += 1
        if bit == 8:
            byte, bit = byte + place.stride, 0
    return bits


def signals_made(message: Message, options: MessageOptions | None) -> set[str]:
    """Return the names of a message's multiplexers and of its protection's signals, which nobody else sets."""
    own = options or MessageOptions()
    nibble = own.e2e.nibble if own.e2e else None
    multiplexers = [each.name for each in message.signals if each.is_multiplexer]
    return {each for each in (own.counter, own.checksum, nibble, *multiplexers) if each}


def protection_row(
    message: Message, options: MessageOptions, tables: TableRows, issues: ConfigIssues
) -> dict[str, int]:
    """Return a message's columns of tables.MESSAGE for counter and checksum; rows they need go to `tables`.

    The checksum is simple, defined by parameters, or an E2E profile's. What does not fit is noted in `issues`.
    """
    key, e2e = f"messages.{message.name}", options.e2e
    for name in (options.counter, options.checksum, e2e.nibble if e2e else None):
        if name and message.get_signal_by_name(name).multiplexer_signal is not None:
            issues.add(key, f"{name} is in some frames only; allowed: a signal that is in every frame")
    row = _counter_columns(message, options, tables, issues)
    row |= _checksum_columns(message, options, tables, issues)
    row["own"] = -1
    if options.own is not None and options.checksum is not None:
        masks = ~own_bits(message, options.checksum)
        row["own"] = add_row(tables.own_checksums, options.own.row(message.frame_id, masks, row["counter"]))
    row["profile"] = -1
    if e2e is None:
        return row
    for name in ("counter", "checksum"):
        if getattr(options, name) is None:
            issues.add(f"{key}.{name}", f"missing; allowed: the signal of {e2e.profile}")
    nibble = -1
    if e2e.nibble is not None:
        place = place_of(message.get_signal_by_name(e2e.nibble))
        nibble = add_row(tables.places, place)
        if place.length != 4:
            issues.add(f"{key}.data_id_nibble", f"{e2e.nibble}: allowed: a signal of 4 bits")
    row["profile"] = add_row(tables.end_to_end, e2e.row(nibble))
    return row


def _counter_columns(
    message: Message, options: MessageOptions, tables: TableRows, issues: ConfigIssues
) -> dict[str, int]:
    """Return a counter's columns; its bit place goes to `tables`, and what does not fit is noted in `issues`."""
    if options.counter is None:
        return {"counter": -1, **BY_ONE.columns(1)}
    place, counting, e2e = (place_of(message.get_signal_by_name(options.counter)), options.counting, options.e2e)
    key = f"messages.{message.name}.counter"
    if e2e is not None:
        bits = {"e2e-p05": 8}.get(e2e.profile, 4)
        if place.length != bits:
            issues.add(key, f"{options.counter}: allowed: a signal of {bits} bits")
        if e2e.profile == "e2e-p01":
            counting = replace(counting, highest=14)
    values = counting.highest_value(place.length) - counting.lowest + 1
    if values > MOST_VALUES:
        issues.add(
            key,
            f"{options.counter} takes {values} values; allowed: up to 2^48, with a value of highest up to "
            f"{counting.lowest + MOST_VALUES - 1}",
        )
        return {"counter": add_row(tables.places, place), **BY_ONE.columns(1)}
    return {"counter": add_row(tables.places, place), **counting.columns(place.length)}


def _checksum_columns(
    message: Message, options: MessageOptions, tables: TableRows, issues: ConfigIssues
) -> dict[str, int]:
    """Return a checksum's columns; its bit place goes to `tables`, and what does not fit is noted in `issues`."""
    if options.checksum is None:
        return {"kind": checksum.NONE, "checksum": -1, "checksum_byte": -1}
    place, e2e = place_of(message.get_signal_by_name(options.checksum)), options.e2e
    columns = {"checksum": add_row(tables.places, place), "checksum_byte": place.byte}
    if options.own is not None:
        return {"kind": checksum.OWN, **columns}
    kind = checksum.PROFILES[e2e.profile] if e2e else checksum.KINDS[options.checksum_kind]
    size = 2 if kind == checksum.E2E_P05 else 1
    if place.length != 8 * size or place.shift != 0 or (size == 2 and place.stride < 0):
        issues.add(
            f"messages.{message.name}.checksum",
            f"{options.checksum}: allowed: a signal that fills "
            + ("two bytes, Intel byte order" if size == 2 else "one byte")
            + ("" if e2e else "; for another width: checksum = { signal, width, polynomial, … }"),
        )
    return {"kind": kind, **columns}
