"""Checksums over a frame: the simple kinds that a DBC with a one-byte checksum signal uses.

All go over the identifier's low 16 bits (low byte first) and then the payload without the checksum's byte,
so that a frame sent under another identifier does not pass.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plant.compiler import compilable

NONE, CRC8_SAE_J1850, XOR8, SUM8 = 0, 1, 2, 3
KINDS = {"none": NONE, "crc8-sae-j1850": CRC8_SAE_J1850, "xor8": XOR8, "sum8": SUM8}


def _crc8_table(polynomial: int) -> NDArray[np.uint8]:
    table = np.zeros(256, dtype=np.uint8)
    for index in range(256):
        crc = index
        for _ in range(8):
            crc = ((crc << 1) ^ polynomial if crc & 0x80 else crc << 1) & 0xFF
        table[index] = crc
    return table


# SAE J1850: polynomial 0x1D, initial value and final XOR 0xFF, not reflected (check value 0x4B).
_J1850 = _crc8_table(0x1D)


@compilable
def crc8_byte(crc: int, byte: int) -> int:
    """CRC-8 SAE J1850 after one more byte."""
    return int(np.int64(_J1850[crc ^ byte]))


@compilable
def checksum(
    kind: int, identifier: int, data: NDArray[np.uint8], row: int, length: int, skip: int
) -> int:
    """The checksum of a frame whose checksum lies in byte `skip`."""
    low, high = identifier & 0xFF, (identifier >> 8) & 0xFF
    if kind == CRC8_SAE_J1850:
        crc = crc8_byte(crc8_byte(0xFF, low), high)
        for i in range(length):
            if i != skip:
                crc = crc8_byte(crc, int(np.int64(data[row, i])))
        return crc ^ 0xFF
    total = low ^ high if kind == XOR8 else low + high
    for i in range(length):
        if i != skip:
            if kind == XOR8:
                total ^= int(np.int64(data[row, i]))
            else:
                total += int(np.int64(data[row, i]))
    return total & 0xFF
