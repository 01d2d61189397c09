"""Tables that the loop works on: layout of all received, or of all sent, messages and signals.

The tables are arrays of records. There are few of them, so that passing a layout to compiled code costs little.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.bits import BitPlace
from liftgate_hil.codec.frames import MAX_BYTES

Row = TypeVar("Row")

# Position of a signal's bits; the fields of `Place`.
PLACE = np.dtype([("byte", "i8"), ("shift", "i8"), ("length", "i8"), ("stride", "i8"), ("kind", "i8")])

# A mapped signal, for one value of each multiplexer above it.
SIGNAL = np.dtype(
    [
        ("quantity", "i8"),  # index into the quantities
        ("place", "i8"),  # row in `places`
        ("selectors_first", "i8"),  # rows in `selectors`, all of which must hold
        ("selectors_count", "i8"),
        ("pages", "i8"),  # pages of a sent message that contain it: one bit each
        ("names_first", "i8"),  # rows in `names`
        ("names_count", "i8"),
        ("factor", "f8"),  # physical = factor · raw + offset
        ("offset", "f8"),
        ("scale", "f8"),  # quantity = scale · physical + bias
        ("bias", "f8"),
        ("low", "f8"),  # allowed physical values
        ("high", "f8"),
        ("raw_low", "f8"),  # raw values that fit into the bits and the range
        ("raw_high", "f8"),
        ("quantity_low", "f8"),  # allowed values of the quantity
        ("quantity_high", "f8"),
    ]
)

# A multiplexer's value under which a signal is in the frame.
SELECTOR = np.dtype([("place", "i8"), ("value", "f8")])

# A value of a quantity's enumeration (ours), and the physical value for it (theirs).
NAME = np.dtype([("ours", "f8"), ("theirs", "f8")])

MESSAGE = np.dtype(
    [
        ("identifier", "i8"),  # with the EXTENDED flag
        ("format", "i8"),  # FD, and BRS where the bit rate switches; 0: classic CAN
        ("length", "i8"),  # bytes
        ("padded", "i8"),  # bytes of its frames: CAN FD has not every length
        ("pages", "i8"),  # sent in turn, one per set of multiplexer values
        ("start", "i8"),  # row in `start` of the first page
        ("first", "i8"),  # rows in `signals`
        ("count", "i8"),
        ("cycle_ns", "i8"),  # 0: not cyclic
        ("timeout_ns", "i8"),  # 0: never goes stale
        ("counter", "i8"),  # row in `places` of the alive counter; -1: none
        # How it counts, see counter.Counting.
        ("modulus", "i8"),  # turns until it repeats
        ("lowest", "i8"),
        ("span", "i8"),  # number of values from `lowest` on
        ("offset", "i8"),  # start value − lowest
        ("step", "i8"),  # step modulo `span`
        ("grain", "i8"),  # greatest common divisor of step and span
        ("inverse", "i8"),  # inverse of step / grain modulo `modulus`
        ("kind", "i8"),  # kind of protection, see checksum.KINDS
        ("checksum", "i8"),  # row in `places` of the checksum; -1: none
        ("checksum_byte", "i8"),  # first byte of the checksum; -1: none
        ("own", "i8"),  # row in `own_checksums`; -1: none
        ("profile", "i8"),  # row in `end_to_end`; -1: none
    ]
)

MOST_COVERED = 128  # bytes that a checksum of OWN_CHECKSUM may cover

# A checksum defined by parameters, see rocksoft.py.
OWN_CHECKSUM = np.dtype(
    [
        ("unused", "i8"),  # 64 − width of the checksum
        ("mask", "i8"),  # mask of the checksum's bits
        ("start", "i8"),  # initial value of the register, mirrored
        ("final_xor", "i8"),
        ("reflect_in", "i8"),  # 1 or 0
        ("reflect_out", "i8"),
        ("counter", "i8"),  # row in `places` of the counter; -1: none
        ("id_count", "i8"),
        ("data_ids", "i8", (16,)),
        ("count", "i8"),  # number of covered bytes, and in their order:
        ("source", "u1", (MOST_COVERED,)),  # kind of byte, see rocksoft.PARTS
        ("number", "u1", (MOST_COVERED,)),  # number of the byte in its part
        ("bits", "u1", (MOST_COVERED,)),  # payload: mask of the bits that count; identifier: the byte itself
        ("table", "i8", (256,)),  # CRC lookup table by byte
    ]
)

# An AUTOSAR E2E profile of a message.
END_TO_END = np.dtype(
    [
        ("data_ids", "i8", (16,)),  # the data ID; in profile 2 the data ID list
        ("data_id_mode", "i8"),  # of profile 1, see checksum.DATA_ID_MODES
        ("nibble", "i8"),  # row in `places` of the data ID's nibble; -1: none
        # Parameters of the check and its state machine, see check_state.py.
        ("max_delta", "i8"),
        ("sync", "i8"),
        ("window", "i8"),
        ("min_ok", "i8", (3,)),  # in the states INIT, VALID and INVALID
        ("max_error", "i8", (3,)),
    ]
)


class BusConfig(NamedTuple):
    """Tables of all that is received, or all that is sent: m messages, n signals, ordered by message."""

    messages: Any  # (m,) MESSAGE
    signals: Any  # (n,) SIGNAL
    places: Any  # PLACE
    selectors: Any  # SELECTOR
    names: Any  # NAME
    start: NDArray[np.uint8]  # (pages of all messages, 64) payloads with start values
    own_checksums: Any  # OWN_CHECKSUM
    end_to_end: Any  # END_TO_END


@dataclass
class TableRows:
    """Rows of the tables of a BusConfig during their construction."""

    messages: list[tuple[float, ...]] = field(default_factory=list)
    signals: list[tuple[float, ...]] = field(default_factory=list)
    places: list[BitPlace] = field(default_factory=list)
    selectors: list[tuple[float, ...]] = field(default_factory=list)
    names: list[tuple[float, float]] = field(default_factory=list)
    start: list[NDArray[np.uint8]] = field(default_factory=list)
    own_checksums: list[tuple[Any, ...]] = field(default_factory=list)
    end_to_end: list[tuple[Any, ...]] = field(default_factory=list)

    def bus(self) -> BusConfig:
        """Return the BusConfig of the rows, as arrays."""

        def table(rows: Sequence[tuple[float, ...]], kind: np.dtype[Any]) -> Any:
            return np.array(rows, dtype=kind).view(np.recarray)

        return BusConfig(
            table(self.messages, MESSAGE),
            table(self.signals, SIGNAL),
            table(self.places, PLACE),
            table(self.selectors, SELECTOR),
            table(self.names, NAME),
            np.array(self.start, dtype=np.uint8).reshape(-1, MAX_BYTES),
            table(self.own_checksums, OWN_CHECKSUM),
            table(self.end_to_end, END_TO_END),
        )


def add_row(rows: list[Row], row: Row) -> int:
    """Add a row to a table, and return its index."""
    rows.append(row)
    return len(rows) - 1


def row_of(kind: np.dtype[Any], columns: Mapping[str, float]) -> tuple[float, ...]:
    """Return the row of a table, as a tuple, given its columns by name."""
    return tuple(columns[name] for name in kind.fields or ())
