"""A drive's load as a current: the motor current less what accelerates the drive.

    i = load + K dn/dt        K = 2π J/c1Φ

Current and speed pass the same filter, so that the acceleration cancels out at every moment.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from liftgate_compiler import compilable
from liftgate_hil.ecu.memory import MAX_WINDOW, EcuConstants


@compilable
def measure_load(constants: EcuConstants, drive: Any, current: float, elapsed: float) -> None:
    """Take a sample of the current [A] into a record of DRIVE, `elapsed` [s] after the last one.

    Missing samples are interpolated linearly between the two. The acceleration is not derived from counts, which
    are too coarse.
    """
    c = constants.calibration
    cycles = max(1, round(elapsed / constants.cycle))
    cycle = elapsed / cycles
    share = 1.0 - math.exp(-cycle / c.load_filter)
    before = drive.turned_before
    if np.isnan(before):
        before = drive.turning
    gained = 0.0
    for left in range(min(cycles, MAX_WINDOW) - 1, -1, -1):
        part = left / cycles
        drive.current += (current + (drive.reading - current) * part - drive.current) * share
        if not np.isnan(drive.turning):
            gained = (drive.turning + (before - drive.turning) * part - drive.settled) * share
            drive.settled += gained
    drive.turned_before = drive.turning
    drive.load = drive.current - c.inertia * gained / cycle
