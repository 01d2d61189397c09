"""AUTOSAR E2E profile 2 (AUTOSAR_PRS_E2EProtocol, R21-11)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.codec.crc import crc8h2f_byte


@compilable
def crc(table: Any, profile: Any, counter: int, data: NDArray[np.uint8], row: int) -> int:
    """Return E2E profile 2's CRC8H2F over the data and then the counter's entry of the data ID list."""
    crc = 0xFF
    for i in range(table.length):
        if i != table.checksum_byte:
            crc = crc8h2f_byte(crc, int(np.int64(data[row, i])))
    return crc8h2f_byte(crc, profile.data_ids[counter & 15]) ^ 0xFF
