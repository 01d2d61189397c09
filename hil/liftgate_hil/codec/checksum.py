"""Checksums of frames: simple kinds, for a DBC with a one-byte checksum signal, and those of AUTOSAR E2E profiles.

The profiles are 1, 2 and 5 (AUTOSAR_PRS_E2EProtocol, R21-11). Manufacturer-specific checksums are in rocksoft.py.

The simple kinds cover the identifier's low 16 bits (low byte first) and then the payload without the checksum's
byte, so that a frame sent under another identifier does not pass. The E2E profiles use their data ID for that.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.codec.bits import extract_long, insert_long, place_at
from liftgate_hil.codec.rocksoft import rocksoft
from liftgate_hil.codec.tables import BusConfig

NONE, CRC8_SAE_J1850, XOR8, SUM8, E2E_P01, E2E_P02, E2E_P05, OWN = range(8)
KINDS = {"none": NONE, "crc8-sae-j1850": CRC8_SAE_J1850, "xor8": XOR8, "sum8": SUM8}
PROFILES = {"e2e-p01": E2E_P01, "e2e-p02": E2E_P02, "e2e-p05": E2E_P05}
# How profile 1 includes the data ID in its CRC: both bytes, alternating bytes, the low byte, or the low byte while
# the low nibble of the high byte is transmitted.
BOTH, ALTERNATING, LOW, NIBBLE = range(4)
DATA_ID_MODES = {"both": BOTH, "alternating": ALTERNATING, "low": LOW, "nibble": NIBBLE}


def _table(polynomial: int, kind: type[np.unsignedinteger[Any]]) -> NDArray[Any]:
    """Return the lookup table (256,) of a CRC, highest bit first: its register after each byte, from 0."""
    table = np.zeros(256, dtype=kind)
    bits = 8 * table.itemsize
    for index in range(256):
        crc = index << (bits - 8)
        for _ in range(8):
            crc = ((crc << 1) ^ polynomial if crc >> (bits - 1) else crc << 1) & ((1 << bits) - 1)
        table[index] = crc
    return table


_J1850 = _table(0x1D, np.uint8)  # SAE J1850
_H2F = _table(0x2F, np.uint8)  # AUTOSAR CRC8H2F
_CCITT = _table(0x1021, np.uint16)  # CRC-16/CCITT-FALSE


@compilable
def crc8_byte(crc: int, byte: int) -> int:
    """Return the register of a CRC-8 SAE J1850 after one more byte."""
    return int(np.int64(_J1850[crc ^ byte]))


@compilable
def crc8h2f_byte(crc: int, byte: int) -> int:
    """Return the register of a CRC-8 with the polynomial 0x2F (CRC8H2F) after one more byte."""
    return int(np.int64(_H2F[crc ^ byte]))


@compilable
def crc16_byte(crc: int, byte: int) -> int:
    """Return the register of a CRC-16/CCITT-FALSE after one more byte."""
    return ((crc << 8) & 0xFF00) ^ int(np.int64(_CCITT[(crc >> 8) ^ byte]))


@compilable
def profile_1(table: Any, profile: Any, counter: int, data: NDArray[np.uint8], row: int) -> int:
    """Return the CRC-8 of E2E profile 1 over the data ID and the payload without the CRC's byte.

    It has SAE J1850's polynomial, and initial value and final XOR 0.
    """
    low, high = profile.data_ids[0] & 0xFF, profile.data_ids[0] >> 8
    crc = 0
    if profile.data_id_mode == BOTH:
        crc = crc8_byte(crc8_byte(crc, low), high)
    elif profile.data_id_mode == ALTERNATING:
        crc = crc8_byte(crc, high if counter % 2 else low)
    elif profile.data_id_mode == LOW:
        crc = crc8_byte(crc, low)
    else:
        crc = crc8_byte(crc8_byte(crc, low), 0)
    for i in range(table.length):
        if i != table.checksum_byte:
            crc = crc8_byte(crc, int(np.int64(data[row, i])))
    return crc


@compilable
def profile_2(table: Any, profile: Any, counter: int, data: NDArray[np.uint8], row: int) -> int:
    """Return E2E profile 2's CRC8H2F over the data without its own byte, then the data ID of the counter."""
    crc = 0xFF
    for i in range(table.length):
        if i != table.checksum_byte:
            crc = crc8h2f_byte(crc, int(np.int64(data[row, i])))
    return crc8h2f_byte(crc, profile.data_ids[counter & 15]) ^ 0xFF


@compilable
def profile_5(table: Any, profile: Any, data: NDArray[np.uint8], row: int) -> int:
    """Return E2E profile 5's CRC-16/CCITT-FALSE over the data without the CRC's two bytes, then the data ID."""
    crc = 0xFFFF
    for i in range(table.length):
        if i - table.checksum_byte not in (0, 1):
            crc = crc16_byte(crc, int(np.int64(data[row, i])))
    return crc16_byte(crc16_byte(crc, profile.data_ids[0] & 0xFF), profile.data_ids[0] >> 8)


@outlined
def profile_checksum(table: Any, profile: Any, counter: int, data: NDArray[np.uint8], row: int) -> int:
    """Return the correct checksum of a frame (row of `data`) with an E2E profile.

    `table` is the message's row of tables.MESSAGE, `profile` its row of tables.END_TO_END.
    """
    if table.kind == E2E_P01:
        return profile_1(table, profile, counter, data, row)
    if table.kind == E2E_P02:
        return profile_2(table, profile, counter, data, row)
    return profile_5(table, profile, data, row)


@outlined
def checksum(table: Any, data: NDArray[np.uint8], row: int) -> int:
    """Return the correct checksum of a simple kind for a frame (row of `data`).

    `table` is its row of tables.MESSAGE.
    """
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
def expected_checksum(bus: BusConfig, message: int, counter: int, data: NDArray[np.uint8], row: int) -> int:
    """Return the correct checksum of a frame (row of `data`), whose message must have a checksum signal."""
    table = bus.messages[message]
    if table.kind == OWN:
        return rocksoft(bus.own_checksums[table.own], bus.places, data, row)
    if table.profile >= 0:
        return profile_checksum(table, bus.end_to_end[table.profile], counter, data, row)
    return checksum(table, data, row)


@compilable
def checksum_in(bus: BusConfig, message: int, data: NDArray[np.uint8], row: int) -> int:
    """Return the checksum that a frame contains; its message must have a checksum signal."""
    return extract_long(data, row, place_at(bus.places, bus.messages[message].checksum))


@compilable
def write_checksum(bus: BusConfig, message: int, data: NDArray[np.uint8], row: int, value: int) -> None:
    """Write the checksum `value` into a frame (row of `data`), whose message must have a checksum signal."""
    insert_long(data, row, place_at(bus.places, bus.messages[message].checksum), value)


@compilable
def put_checksum(bus: BusConfig, message: int, counter: int, data: NDArray[np.uint8], row: int) -> None:
    """Compute and write the correct checksum into a frame that already contains its counter."""
    write_checksum(bus, message, data, row, expected_checksum(bus, message, counter, data, row))
