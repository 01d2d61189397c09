"""A drive's load as a current: what the motor takes beside accelerating the drive.

    i = load + K dn/dt        K = 2π J/c1Φ

Current and speed go through the same filter, so that the one takes the other away at every moment.
"""

from __future__ import annotations

import math
from typing import Any

from liftgate_hil.ecu.memory import Constants
from liftgate_plant.compiler import compilable


@compilable
def measure_load(constants: Constants, drive: Any, current: float, is_sharp: bool) -> None:
    """Take the current [A] of this cycle; what accelerates the drive is told from a sharp speed only. `drive` is a
    record of DRIVE.
    """
    c = constants.calibration
    share = 1.0 - math.exp(-constants.cycle / c.load_filter)
    before = drive.settled
    drive.current += (current - drive.current) * share
    drive.settled += (drive.speed - before) * share
    drive.load = drive.current
    if is_sharp:
        drive.load -= c.inertia * (drive.settled - before) / constants.cycle
