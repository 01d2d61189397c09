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
from liftgate_hil.codec.crc import crc8_byte
from liftgate_hil.codec.e2e import profile_1, profile_2, profile_5
from liftgate_hil.codec.rocksoft import rocksoft
from liftgate_hil.codec.tables import BusConfig

NONE, CRC8_SAE_J1850, XOR8, SUM8, E2E_P01, E2E_P02, E2E_P05, OWN = range(8)
KINDS = {"none": NONE, "crc8-sae-j1850": CRC8_SAE_J1850, "xor8": XOR8, "sum8": SUM8}
PROFILES = {"e2e-p01": E2E_P01, "e2e-p02": E2E_P02, "e2e-p05": E2E_P05}


@outlined
def profile_checksum(table: Any, profile: Any, counter: int, data: NDArray[np.uint8], row: int) -> int:
    """Return the checksum that a frame (row of `data`) of an E2E profile must have.

    `table` is its row of tables.MESSAGE, `profile` that of tables.END_TO_END.
    """
    if table.kind == E2E_P01:
        return profile_1.crc(table, profile, counter, data, row)
    if table.kind == E2E_P02:
        return profile_2.crc(table, profile, counter, data, row)
    return profile_5.crc(table, profile, data, row)


@outlined
def checksum(table: Any, data: NDArray[np.uint8], row: int) -> int:
    """Return the checksum of a simple kind that a frame (row of `data`) must have.

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
    """Return the checksum that a frame (row of `data`) must have; its message must be one with a checksum."""
    table = bus.messages[message]
    if table.kind == OWN:
        return rocksoft(bus.own_checksums[table.own], bus.places, data, row)
    if table.profile >= 0:
        return profile_checksum(table, bus.end_to_end[table.profile], counter, data, row)
    return checksum(table, data, row)


@compilable
def checksum_in(bus: BusConfig, message: int, data: NDArray[np.uint8], row: int) -> int:
    """Return the checksum that a frame contains; its message must be one with a checksum."""
    return extract_long(data, row, place_at(bus.places, bus.messages[message].checksum))


@compilable
def write_checksum(bus: BusConfig, message: int, data: NDArray[np.uint8], row: int, value: int) -> None:
    """Write a checksum into a frame."""
    insert_long(data, row, place_at(bus.places, bus.messages[message].checksum), value)


@compilable
def put_checksum(bus: BusConfig, message: int, counter: int, data: NDArray[np.uint8], row: int) -> None:
    """Write the correct checksum into a frame that already contains its counter."""
    write_checksum(bus, message, data, row, expected_checksum(bus, message, counter, data, row))
