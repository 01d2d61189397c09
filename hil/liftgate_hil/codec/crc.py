"""Cyclic redundancy checks, computed a byte at a time by table lookup."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable


def _crc8_table(polynomial: int) -> NDArray[np.uint8]:
    table = np.zeros(256, dtype=np.uint8)
    for index in range(256):
        crc = index
        for _ in range(8):
            crc = ((crc << 1) ^ polynomial if crc & 0x80 else crc << 1) & 0xFF
        table[index] = crc
    return table


def _crc16_table(polynomial: int) -> NDArray[np.uint16]:
    table = np.zeros(256, dtype=np.uint16)
    for index in range(256):
        crc = index << 8
        for _ in range(8):
            crc = ((crc << 1) ^ polynomial if crc & 0x8000 else crc << 1) & 0xFFFF
        table[index] = crc
    return table


_J1850 = _crc8_table(0x1D)  # SAE J1850
_H2F = _crc8_table(0x2F)  # AUTOSAR CRC8H2F
_CCITT = _crc16_table(0x1021)  # CRC-16/CCITT-FALSE


@compilable
def crc8_byte(crc: int, byte: int) -> int:
    """Return the CRC-8 SAE J1850 after one more byte."""
    return int(np.int64(_J1850[crc ^ byte]))


@compilable
def crc8h2f_byte(crc: int, byte: int) -> int:
    """Return the CRC-8 with the polynomial 0x2F after one more byte."""
    return int(np.int64(_H2F[crc ^ byte]))


@compilable
def crc16_byte(crc: int, byte: int) -> int:
    """Return the CRC-16/CCITT-FALSE after one more byte."""
    return ((crc << 8) & 0xFF00) ^ int(np.int64(_CCITT[(crc >> 8) ^ byte]))
