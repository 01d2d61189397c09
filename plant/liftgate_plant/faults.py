"""Faults of bridges, sensors and latch; faults of the mechanics are changed constants.

    shaft → Hall A, B → stuck → swapped → missing, extra → quadrature decoder
    current → gain, offset, in the order of the scenario → converter → frozen
              motor's terminals joined: the bridge drives a short circuit

The values of `SOUND` (NaN, 0 or 1) are a gate without faults.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class HallFault(NamedTuple):
    """Faults of one drive's Hall sensors: fixed levels 0 or 1 (NaN: not fixed), and others."""

    is_on: float  # 0.0: no Hall fault is active
    level_a: float
    level_b: float
    swapped: float  # 1.0: A and B are swapped
    missing: float  # probability that neither decoder nor timer sees an edge
    extra: float  # 1/s, rate of spurious edges, on either sensor
    seed: float  # of missing and extra edges, a whole number


class CurrentFault(NamedTuple):
    """Faults of the measurement of one motor's current."""

    is_on: float  # 0.0: no current fault is active
    gain: float  # in addition to that of the vehicle file
    offset: float  # A, in addition to that of the vehicle file
    frozen: float  # 1.0: the last reading is held
    shorted: float  # 1.0: the bridge drives a short circuit, whose current exceeds the converter's range


class DriveFaults(NamedTuple):
    """Faults of one drive's bridge and sensors."""

    bridge: float  # state in which it is stuck, one of those in `bridge`; NaN: it follows its commands
    hall: HallFault
    current: CurrentFault


class Faults(NamedTuple):
    """All faults of one gate's bridges, sensors and latch."""

    inputs: float  # 0.0: bridges and latch follow their commands
    left: DriveFaults
    right: DriveFaults
    angle_frozen: float  # 1.0: the last reading is held
    latch_reading: float  # reading of the latch's switch, 0 or 1; NaN: the true value
    latch_held: float  # 1.0: the latch is not released, whatever drives it


class MotorLine(NamedTuple):
    """Electrical line between a bridge and its motor."""

    is_open: float  # 1.0: no current can flow
    is_shorted: float  # 1.0: the motor's terminals are joined
    resistance: float  # Ω, of contacts


SOUND_HALL = HallFault(0.0, math.nan, math.nan, 0.0, 0.0, 0.0, 0.0)
SOUND_CURRENT = CurrentFault(0.0, 1.0, 0.0, 0.0, 0.0)
SOUND_DRIVE = DriveFaults(math.nan, SOUND_HALL, SOUND_CURRENT)
SOUND = Faults(0.0, SOUND_DRIVE, SOUND_DRIVE, 0.0, math.nan, 0.0)
SOUND_LINE = MotorLine(0.0, 0.0, 0.0)
