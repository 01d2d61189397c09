"""Control of one drive: its speed, measured by Hall counts, and its load, estimated from the motor current.

The duty is a feed-forward, scaled by the voltage, with PI control of the speed. The load is the motor current less
what accelerates the drive:

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
def measure_speed(constants: EcuConstants, drive: Any, count: float, turning: float, elapsed: float) -> None:
    """Update a drive's speed with a sample of its count and motor speed [rev/s], `elapsed` [s] after the last.

    Without the motor's speed (NaN), the speed is the count's difference over a few cycles. `drive` is a record of
    DRIVE.
    """
    moved, is_first = abs(count - drive.count), drive.held == 0 or np.isnan(drive.turning)
    note_counts(constants, drive, count, elapsed)
    drive.count = count
    spans = drive.held - 1
    if not np.isnan(turning):
        if is_first:  # what came before was not received
            drive.settled = turning
        else:
            drive.counted += moved
            drive.turned += abs(turning) * elapsed
        drive.speed = counts_a_turn(constants, drive) * turning
    elif spans > 0:
        drive.speed = (count - drive.history[0]) / (spans * constants.cycle)
    drive.turning = turning


@compilable
def note_counts(constants: EcuConstants, drive: Any, count: float, elapsed: float) -> None:
    """Append a drive's count in each cycle since the last sample to its history, interpolated linearly."""
    drive.due += elapsed / constants.cycle
    cycles = math.floor(drive.due + 0.5) if drive.held > 0 else 1
    drive.due -= cycles
    for left in range(min(cycles, constants.window + 1) - 1, -1, -1):
        if drive.held > constants.window:
            for i in range(constants.window):
                drive.history[i] = drive.history[i + 1]
            drive.held -= 1
        drive.history[drive.held] = count - (count - drive.count) * left / cycles
        drive.held += 1


@compilable
def counts_a_turn(constants: EcuConstants, drive: Any) -> float:
    """Return the Hall counts per motor revolution: calibrated or, after enough turns, measured and rounded."""
    c = constants.calibration
    if drive.turned < c.turns_to_count:
        return c.counts_per_turn
    return float(max(math.floor(drive.counted / drive.turned + 0.5), 1))


@compilable
def controlled_duty(constants: EcuConstants, drive: Any, wanted: float, voltage: float) -> float:
    """Return the signed duty (−1…1) for a speed setpoint [counts/s]; the integral stops at saturation."""
    c = constants.calibration
    boost = c.rated_voltage / max(voltage, 4.0)
    error = wanted - drive.speed
    feed_forward = wanted / c.rated_speed
    duty = (feed_forward + c.gain * error + drive.integral) * boost
    limited = min(max(duty, -1.0), 1.0)
    if duty == limited or (duty > 0.0) != (error > 0.0):
        drive.integral += c.gain * error * constants.cycle / c.integral_time
    return float(limited)


@compilable
def measure_load(constants: EcuConstants, drive: Any, current: float, elapsed: float) -> None:
    """Update a drive's load with a sample of its current [A], `elapsed` [s] after the last sample.

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
