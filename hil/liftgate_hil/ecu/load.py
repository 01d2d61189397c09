"""A drive's load as a current: what the motor takes beside accelerating the drive.

    i = load + K dn/dt        K = 2π J/c1Φ

Current and speed go through the same filter, so that the one takes the other away at every moment.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from liftgate_hil.ecu.memory import Constants
from liftgate_plant.compiler import compilable


@compilable
def measure_load(constants: Constants, drive: Any, current: float) -> None:
    """Take the current [A] of this cycle into a record of DRIVE. What accelerates the drive is not told from
    counts, which are too coarse.
    """
    c = constants.calibration
    share = 1.0 - math.exp(-constants.cycle / c.load_filter)
    drive.current += (current - drive.current) * share
    drive.load = drive.current
    if not np.isnan(drive.turning):
        gained = (drive.turning - drive.settled) * share
        drive.settled += gained
        drive.load -= c.inertia * gained / constants.cycle
