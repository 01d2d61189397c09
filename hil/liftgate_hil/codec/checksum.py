"""Checksums over a frame: the simple kinds that a DBC with a one-byte checksum signal uses, and those of the
AUTOSAR E2E profiles 1, 2 and 5 (AUTOSAR_PRS_E2EProtocol, R21-11).

The simple kinds go over the identifier's low 16 bits (low byte first) and then the payload without the
checksum's byte, so that a frame sent under another identifier does not pass. The E2E profiles have a data ID of
their own for that.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_plant.compiler import compilable

NONE, CRC8_SAE_J1850, XOR8, SUM8, E2E_P01, E2E_P02, E2E_P05 = range(7)
KINDS = {"none": NONE, "crc8-sae-j1850": CRC8_SAE_J1850, "xor8": XOR8, "sum8": SUM8}
PROFILES = {"e2e-p01": E2E_P01, "e2e-p02": E2E_P02, "e2e-p05": E2E_P05}

# How profile 1 takes the data ID into its CRC: both bytes, alternating, the low one, or the low one while the
# high one's low nibble is sent.
BOTH, ALTERNATING, LOW, NIBBLE = range(4)
DATA_ID_MODES = {"both": BOTH, "alternating": ALTERNATING, "low": LOW, "nibble": NIBBLE}


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
    """CRC-8 SAE J1850 after one more byte."""
    return int(np.int64(_J1850[crc ^ byte]))


@compilable
def crc8h2f_byte(crc: int, byte: int) -> int:
    """CRC-8 with the polynomial 0x2F after one more byte."""
    return int(np.int64(_H2F[crc ^ byte]))


@compilable
def crc16_byte(crc: int, byte: int) -> int:
    """CRC-16/CCITT-FALSE after one more byte."""
    return ((crc << 8) & 0xFF00) ^ int(np.int64(_CCITT[(crc >> 8) ^ byte]))


@compilable
def checksum(table: Any, counter: int, data: NDArray[np.uint8], row: int) -> int:
    """The checksum that a frame (row of `data`) must have; `table` is its record of tables.MESSAGE."""
    if table.kind == E2E_P01:
        return profile_1(table, counter, data, row)
    if table.kind == E2E_P02:
        return profile_2(table, counter, data, row)
    if table.kind == E2E_P05:
        return profile_5(table, data, row)
    low, high = table.identifier & 0xFF, (table.identifier >> 8) & 0xFF
    skip = table.checksum_byte
    if table.kind == CRC8_SAE_J1850:  # initial value and final XOR 0xFF, check value 0x4B
        crc = crc8_byte(crc8_byte(0xFF, low), high)
        for i in range(table.length):
            if i != skip:
                crc = crc8_byte(crc, int(np.int64(data[row, i])))
        return crc ^ 0xFF
    total = low ^ high if table.kind == XOR8 else low + high
    for i in range(table.length):
        if i != skip:
            if table.kind == XOR8:
                total ^= int(np.int64(data[row, i]))
            else:
                total += int(np.int64(data[row, i]))
    return int(total & 0xFF)


@compilable
def profile_1(table: Any, counter: int, data: NDArray[np.uint8], row: int) -> int:
    """E2E profile 1: CRC-8 with SAE J1850's polynomial, initial value and final XOR 0, over data ID and data."""
    low, high = table.data_ids[0] & 0xFF, table.data_ids[0] >> 8
    crc = 0
    if table.data_id_mode == BOTH:
        crc = crc8_byte(crc8_byte(crc, low), high)
    elif table.data_id_mode == ALTERNATING:
        crc = crc8_byte(crc, high if counter % 2 else low)
    elif table.data_id_mode == LOW:
        crc = crc8_byte(crc, low)
    else:
        crc = crc8_byte(crc8_byte(crc, low), 0)
    for i in range(table.length):
        if i != table.checksum_byte:
            crc = crc8_byte(crc, int(np.int64(data[row, i])))
    return crc


@compilable
def profile_2(table: Any, counter: int, data: NDArray[np.uint8], row: int) -> int:
    """E2E profile 2: CRC8H2F over the data and then the counter's entry of the data ID list."""
    crc = 0xFF
    for i in range(table.length):
        if i != table.checksum_byte:
            crc = crc8h2f_byte(crc, int(np.int64(data[row, i])))
    return crc8h2f_byte(crc, table.data_ids[counter & 15]) ^ 0xFF


@compilable
def profile_5(table: Any, data: NDArray[np.uint8], row: int) -> int:
    """E2E profile 5: CRC-16/CCITT-FALSE over the data without the CRC's two bytes, and then the data ID."""
    crc = 0xFFFF
    for i in range(table.length):
        if i - table.checksum_byte not in (0, 1):
            crc = crc16_byte(crc, int(np.int64(data[row, i])))
    return crc16_byte(crc16_byte(crc, table.data_ids[0] & 0xFF), table.data_ids[0] >> 8)


@compilable
def checksum_in(table: Any, data: NDArray[np.uint8], row: int) -> int:
    """The checksum that a frame has."""
    first = int(np.int64(data[row, table.checksum_byte]))
    if table.kind == E2E_P05:  # low byte first
        return first | int(np.int64(data[row, table.checksum_byte + 1])) << 8
    return first


@compilable
def put_checksum(table: Any, counter: int, data: NDArray[np.uint8], row: int) -> None:
    """Complete a frame with its checksum."""
    value = checksum(table, counter, data, row)
    data[row, table.checksum_byte] = value & 0xFF
    if table.kind == E2E_P05:
        data[row, table.checksum_byte + 1] = value >> 8
