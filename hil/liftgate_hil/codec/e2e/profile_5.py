"""AUTOSAR E2E profile 5 (AUTOSAR_PRS_E2EProtocol, R21-11)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.codec.crc import crc16_byte


@compilable
def crc(table: Any, profile: Any, data: NDArray[np.uint8], row: int) -> int:
    """Return E2E profile 5's CRC-16/CCITT-FALSE over the data without the CRC's two bytes, then the data ID."""
    crc = 0xFFFF
    for i in range(table.length):
        if i - table.checksum_byte not in (0, 1):
            crc = crc16_byte(crc, int(np.int64(data[row, i])))
    return crc16_byte(crc16_byte(crc, profile.data_ids[0] & 0xFF), profile.data_ids[0] >> 8)
