"""AUTOSAR E2E profile 1 (AUTOSAR_PRS_E2EProtocol, R21-11)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.codec.crc import crc8_byte

# How profile 1 includes the data ID in its CRC: both bytes, alternating bytes, the low byte, or the low byte while
# the low nibble of the high byte is transmitted.
BOTH, ALTERNATING, LOW, NIBBLE = range(4)
DATA_ID_MODES = {"both": BOTH, "alternating": ALTERNATING, "low": LOW, "nibble": NIBBLE}


@compilable
def crc(table: Any, profile: Any, counter: int, data: NDArray[np.uint8], row: int) -> int:
    """Return the CRC-8 of E2E profile 1 over data ID and data.

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
