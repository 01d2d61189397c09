"""Ring buffer of Hall edges, in which a tick may write any number."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable

EDGE = np.dtype(
    [
        ("time_s", "f8"),  # s, model time of the edge
        ("drive", "i8"),  # LEFT, RIGHT
        ("channel", "i8"),  # A, B
        ("level", "i8"),  # level after the edge, 0 or 1
    ]
)

# Edges of a drive in a tick: 1e4 counts a turn at 1300 rev/s make 130,000 in 10 ms.
MOST_EDGES = 2**17
RING_SIZE = 4 * MOST_EDGES  # size of a ring that loses no edges: twice what a tick may add


class EdgeRing(NamedTuple):
    """Ring buffer of the last Hall edges of both drives; written in place."""

    rows: Any  # (n,) EDGE
    written: NDArray[np.int64]  # (1,), number of edges so far


@compilable
def write_edge(ring: EdgeRing, time: float, drive: int, channel: int, level: int) -> None:
    """Write a Hall edge into the ring buffer."""
    row = ring.rows[ring.written[0] % len(ring.rows)]
    row.time_s = time
    row.drive = drive
    row.channel = channel
    row.level = level
    ring.written[0] += 1


def edge_ring(size: int) -> EdgeRing:
    """Return an empty ring buffer with room for the last `size` edges."""
    return EdgeRing(np.zeros(size, dtype=EDGE).view(np.recarray), np.zeros(1, dtype=np.int64))


def edges_after(ring: EdgeRing, seen: int) -> Any:
    """Return a copy of the edges (n,) EDGE written after the first `seen` ones, in the order of time.

    Raises ValueError where the ring has lost some.
    """
    written = int(ring.written[0])
    if written - seen > len(ring.rows):
        raise ValueError(f"{written - seen} edges in a ring of {len(ring.rows)}")
    places = np.arange(seen, written) % len(ring.rows)
    rows = ring.rows[places]  # within a tick, one drive's edges come after the other's
    return rows[np.argsort(rows.time_s, kind="stable")]
