"""Wanted speed of the gate: a soft start, then what is calibrated for the position."""

from __future__ import annotations

import math

import numpy as np

from liftgate_compiler import compilable
from liftgate_hil.ecu.calibration import PLACES
from liftgate_hil.ecu.memory import CLOSING, EcuConstants, EcuMemory
from liftgate_hil.ecu.position import position_of


@compilable
def speed_over(speeds: tuple[float, ...], place: float) -> float:
    """Return the speed at a position, both as shares of the travel, interpolated linearly between PLACES."""
    if place <= PLACES[0]:
        return speeds[0]
    for i in range(1, len(PLACES)):
        if place < PLACES[i]:
            share = (place - PLACES[i - 1]) / (PLACES[i] - PLACES[i - 1])
            return speeds[i - 1] + share * (speeds[i] - speeds[i - 1])
    return speeds[len(PLACES) - 1]


@compilable
def wanted_speed(constants: EcuConstants, memory: EcuMemory) -> float:
    """Return the wanted speed [counts/s]: a soft start over time, then what is calibrated for the position."""
    c, control = constants.calibration, memory.control[0]
    position, travel = position_of(memory), control.travel
    elapsed = control.now - control.since
    if np.isnan(position) or np.isnan(travel):
        return float(min(c.learning_speed, c.creep_speed + c.learning_start * elapsed))
    if control.state == CLOSING:
        start = c.closing_start
        speed = speed_over(c.closing_speed, (position - c.seal_zone) / travel)
    else:
        start = c.opening_start
        speed = speed_over(c.opening_speed, position / travel)
    started = c.creep_speed + travel * start * elapsed
    return float(max(min(travel * speed, started), c.creep_speed))


@compilable
def want(constants: EcuConstants, memory: EcuMemory, speed: float) -> None:
    """Set the wanted speed [counts/s], and track how fast it changes, since the gate feels that for a while."""
    control = memory.control[0]
    fading = control.ramp * math.exp(-constants.cycle / constants.calibration.ramp_time)
    rate = abs(speed - control.wanted) / constants.cycle if control.wanted > 0.0 else 0.0
    control.wanted, control.ramp = speed, max(rate, fading)
