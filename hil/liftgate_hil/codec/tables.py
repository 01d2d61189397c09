"""The tables that the loop works through: a layout of all that is received, or all that is sent.

They are arrays of records: few of them, so that passing a layout on costs compiled code little.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

# Where a signal's bits lie; the fields of `Place`.
PLACE = np.dtype(
    [("byte", "i8"), ("shift", "i8"), ("length", "i8"), ("stride", "i8"), ("kind", "i8")]
)

# A mapped signal, under one value of each multiplexer above it.
SIGNAL = np.dtype(
    [
        ("quantity", "i8"),  # index into the quantities
        ("place", "i8"),  # row in `places`
        ("selectors_first", "i8"),  # rows in `selectors`, all of which must hold
        ("selectors_count", "i8"),
        ("pages", "i8"),  # on which pages of a message that is sent: a bit each
        ("names_first", "i8"),  # rows in `names`
        ("names_count", "i8"),
        ("factor", "f8"),  # physical = factor raw + offset
        ("offset", "f8"),
        ("scale", "f8"),  # quantity = scale physical + bias
        ("bias", "f8"),
        ("low", "f8"),  # allowed physical values
        ("high", "f8"),
        ("raw_low", "f8"),  # what fits into the bits and the range
        ("raw_high", "f8"),
        ("quantity_low", "f8"),  # allowed values of the quantity
        ("quantity_high", "f8"),
    ]
)

# A multiplexer's value under which a signal is in the frame.
SELECTOR = np.dtype([("place", "i8"), ("value", "f8")])

# An enumeration's value of ours, and its physical value.
NAME = np.dtype([("ours", "f8"), ("theirs", "f8")])

MESSAGE = np.dtype(
    [
        ("identifier", "i8"),  # with the EXTENDED flag
        ("fd", "i8"),  # FD or 0
        ("length", "i8"),  # bytes
        ("pages", "i8"),  # sent in turn, one for each set of multiplexers' values
        ("start", "i8"),  # row in `start` of the first of them
        ("first", "i8"),  # rows in `signals`
        ("count", "i8"),
        ("cycle_ns", "i8"),  # 0: not cyclic
        ("timeout_ns", "i8"),  # 0: never goes stale
        ("counter", "i8"),  # row in `places` of the alive counter; -1: none
        # How it counts, see counter.Counting.
        ("modulus", "i8"),  # turns until it begins anew
        ("lowest", "i8"),
        ("span", "i8"),  # values from there on
        ("offset", "i8"),  # of its start above the lowest
        ("step", "i8"),  # modulo the span
        ("grain", "i8"),  # what step and span have in common
        ("inverse", "i8"),  # of step / grain modulo the modulus
        ("kind", "i8"),  # of protection, see checksum.KINDS
        ("checksum", "i8"),  # row in `places` of the checksum; -1: none
        ("checksum_byte", "i8"),  # its first; -1: none
        ("own", "i8"),  # row in `own_checksums`; -1: none
        ("profile", "i8"),  # row in `end_to_end`; -1: none
    ]
)

MOST_COVERED = 128  # bytes that a checksum of OWN_CHECKSUM is over

# A checksum by parameters, see rocksoft.py.
OWN_CHECKSUM = np.dtype(
    [
        ("unused", "i8"),  # 64 - its width
        ("mask", "i8"),  # of its bits
        ("start", "i8"),  # of the register, mirrored
        ("final_xor", "i8"),
        ("reflect_in", "i8"),  # 1 or 0
        ("reflect_out", "i8"),
        ("counter", "i8"),  # row in `places` of the counter; -1: none
        ("id_count", "i8"),
        ("data_ids", "i8", (16,)),
        ("count", "i8"),  # bytes that it is over, in their order:
        ("source", "u1", (MOST_COVERED,)),  # see rocksoft.PARTS
        ("number", "u1", (MOST_COVERED,)),  # of the byte there
        (
            "bits",
            "u1",
            (MOST_COVERED,),
        ),  # of the payload those that count; of an identifier the byte
        ("table", "i8", (256,)),  # what each byte makes of the register
    ]
)

# An AUTOSAR E2E profile of a message.
END_TO_END = np.dtype(
    [
        ("data_ids", "i8", (16,)),  # the data ID, in profile 2 the list
        ("data_id_mode", "i8"),  # of profile 1, see e2e.profile_1.DATA_ID_MODES
        ("nibble", "i8"),  # row in `places` of the data ID's nibble; -1: none
        # Of the state machine, see e2e/check_state.py.
        ("max_delta", "i8"),
        ("sync", "i8"),
        ("window", "i8"),
        ("min_ok", "i8", (3,)),  # in the states INIT, VALID, INVALID
        ("max_error", "i8", (3,)),
    ]
)


class BusConfig(NamedTuple):
    """All that is received, or all that is sent: m messages, n signals, ordered by message."""

    messages: Any  # (m,) MESSAGE
    signals: Any  # (n,) SIGNAL
    places: Any  # PLACE
    selectors: Any  # SELECTOR
    names: Any  # NAME
    start: NDArray[np.uint8]  # (pages of all messages, 64) payloads with start values
    own_checksums: Any  # OWN_CHECKSUM
    end_to_end: Any  # END_TO_END
