"""What may be broken in bridges, sensors and latch; what is broken in the mechanics is a changed constant.

    shaft → Hall A, B → stuck → swapped → missing, extra → quadrature decoder
    current → gain, offset, in the order of the scenario → converter → frozen
              motor's terminals joined: the bridge drives a short circuit

NaN, 0 or 1 as they stand in `SOUND` are a gate without faults.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class HallFault(NamedTuple):
    """Of one drive's Hall sensors; levels 0 or 1, NaN: as the shaft has them."""

    is_on: float  # 0.0: none of these
    level_a: float
    level_b: float
    swapped: float  # 1.0: A and B are
    missing: float  # probability that neither decoder nor timer sees an edge
    extra: float  # 1/s, edges that are none, on either sensor
    seed: float  # of missing and extra ones, whole


class CurrentFault(NamedTuple):
    """Of the measurement of one motor's current."""

    is_on: float  # 0.0: none of these
    gain: float  # beside that of the vehicle file
    offset: float  # A, beside that of the vehicle file
    frozen: float  # 1.0: the last reading stays
    shorted: float  # 1.0: the bridge drives a short circuit, which is more than the converter shows


class DriveFaults(NamedTuple):
    """Of one drive's bridge and sensors."""

    bridge: float  # state that it is stuck in, one of bridge's; NaN: it obeys
    hall: HallFault
    current: CurrentFault


class Faults(NamedTuple):
    """Of a whole gate."""

    inputs: float  # 0.0: bridges and latch do as they are told
    left: DriveFaults
    right: DriveFaults
    angle_frozen: float  # 1.0: the last reading stays
    latch_reading: float  # what the latch's switch says, 0 or 1; NaN: what is so
    latch_held: float  # 1.0: it is not released, whatever drives it


class Line(NamedTuple):
    """What lies between a bridge and its motor."""

    is_open: float  # 1.0: no current can flow
    is_shorted: float  # 1.0: the motor's terminals are joined
    resistance: float  # Ω, of contacts


SOUND_HALL = HallFault(0.0, math.nan, math.nan, 0.0, 0.0, 0.0, 0.0)
SOUND_CURRENT = CurrentFault(0.0, 1.0, 0.0, 0.0, 0.0)
SOUND_DRIVE = DriveFaults(math.nan, SOUND_HALL, SOUND_CURRENT)
SOUND = Faults(0.0, SOUND_DRIVE, SOUND_DRIVE, 0.0, math.nan, 0.0)
SOUND_LINE = Line(0.0, 0.0, 0.0)
