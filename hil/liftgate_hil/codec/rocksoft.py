"""Manufacturer-specific CRCs defined by Rocksoft parameters, and the bytes that they cover.

The model is that of R. N. Williams, "A painless guide to CRC error detection algorithms", 1993.

One algorithm serves all CRCs: bits enter lowest first, and the register's highest power is its lowest bit. A CRC
that takes bytes highest bit first equals that of mirrored bytes, with the register mirrored at the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.codec.bits import extract_long, joined, place_at
from liftgate_hil.codec.tables import MOST_COVERED

PAYLOAD, IDENTIFIER, COUNTER, DATA_ID = range(4)
PARTS = {"payload": PAYLOAD, "identifier": IDENTIFIER, "counter": COUNTER, "data_id": DATA_ID}

MOST_DATA_IDS = 16

_ALL_BITS = (1 << 64) - 1
_HIGH_56 = 0x00FFFFFFFFFFFFFF  # bits that remain of 64 after a right shift by a byte
_MIRRORED = np.array([int(f"{byte:08b}"[::-1], 2) for byte in range(256)], dtype=np.int64)


@dataclass(frozen=True)
class Covered:
    """Bytes of one part of a message that a checksum covers, `first` to `last` inclusive, possibly descending.

    Bytes of the payload are numbered from the start of the frame, those of a number from its least significant
    byte.
    """

    part: str  # one of PARTS
    first: int
    last: int

    def numbers(self) -> range:
        """Return the indices of the covered bytes in the order in which the checksum takes them."""
        way = 1 if self.last >= self.first else -1
        return range(self.first, self.last + way, way)


@dataclass(frozen=True)
class Rocksoft:
    """Checksum defined by Rocksoft parameters; the polynomial is given without its highest term."""

    width: int  # bits, 1 to 64
    polynomial: int
    start: int = 0
    reflect_in: bool = False
    reflect_out: bool = False
    final_xor: int = 0
    covers: tuple[Covered, ...] = ()
    data_ids: tuple[int, ...] = ()  # one, or one per value of the counter, modulo their number

    def row(self, identifier: int, masks: NDArray[np.uint8], counter: int) -> tuple[Any, ...]:
        """Return the checksum's parameters as a row of tables.OWN_CHECKSUM.

        `masks` (bytes of the payload,) selects the bits that are not the checksum's own; `counter` is the row of
        the counter's place, or −1.
        """
        source = np.zeros(MOST_COVERED, dtype=np.uint8)
        number, bits = np.zeros_like(source), np.zeros_like(source)
        covered = [(PARTS[each.part], byte) for each in self.covers for byte in each.numbers()]
        for place, (part, byte) in enumerate(covered):
            source[place], number[place] = part, byte
            if part == PAYLOAD:
                bits[place] = masks[byte]
            elif part == IDENTIFIER:
                bits[place] = (identifier >> 8 * byte) & 0xFF
        data_ids = [*self.data_ids, *[0] * MOST_DATA_IDS][:MOST_DATA_IDS]
        return (
            64 - self.width,
            _signed((1 << self.width) - 1),
            _signed(_mirrored(self.start, self.width)),
            _signed(self.final_xor),
            int(self.reflect_in),
            int(self.reflect_out),
            counter,
            len(self.data_ids),
            data_ids,
            len(covered),
            source,
            number,
            bits,
            _table(_mirrored(self.polynomial, self.width)),
        )


def _mirrored(value: int, width: int) -> int:
    """Return a number of `width` bits with the order of its bits reversed."""
    return int(f"{value:0{width}b}"[::-1], 2)


def _signed(value: int) -> int:
    """Return an unsigned 64-bit number as two's complement."""
    return value - (1 << 64) if value >> 63 else value


def _table(polynomial: int) -> NDArray[np.int64]:
    """Return the lookup table (256,) of a CRC, lowest bit first, by its mirrored polynomial; two's complement."""
    table = np.zeros(256, dtype=np.int64)
    for index in range(256):
        crc = index
        for _ in range(8):
            crc = (crc >> 1) ^ (polynomial if crc & 1 else 0)
        table[index] = _signed(crc & _ALL_BITS)
    return table


@outlined
def rocksoft(own: Any, places: Any, data: NDArray[np.uint8], row: int) -> int:
    """Return the correct checksum of a frame (row of `data`) that already has its counter.

    `own` is the checksum's row of tables.OWN_CHECKSUM. A checksum of 64 bits is returned as two's complement.
    """
    counter = 0
    if own.counter >= 0:
        counter = extract_long(data, row, place_at(places, own.counter))
    data_id = 0
    if own.id_count > 0:
        data_id = int(own.data_ids[counter % own.id_count])
    register = int(own.start)
    for i in range(own.count):
        source, number = int(np.int64(own.source[i])), int(np.int64(own.number[i]))
        byte = int(np.int64(own.bits[i]))
        if source == PAYLOAD:
            byte &= int(np.int64(data[row, number]))
        elif source == COUNTER:
            byte = (counter >> (8 * number)) & 0xFF
        elif source == DATA_ID:
            byte = (data_id >> (8 * number)) & 0xFF
        if own.reflect_in == 0:
            byte = int(_MIRRORED[byte])
        register = ((register >> 8) & _HIGH_56) ^ int(own.table[(register ^ byte) & 0xFF])
    if own.reflect_out == 0:
        register = (mirrored(register) >> int(own.unused)) & int(own.mask)
    return register ^ int(own.final_xor)


@compilable
def mirrored(value: int) -> int:
    """Return a 64-bit number, given and returned as two's complement, with the order of its bits reversed."""
    high, low = 0, 0
    for byte in range(4):
        high = (high << 8) | int(_MIRRORED[(value >> (8 * byte)) & 0xFF])
        low = (low << 8) | int(_MIRRORED[(value >> (8 * byte + 32)) & 0xFF])
    return joined(high, low)
