"""Plausibility monitor: stops a motion on implausible sensor values, and detects a gate that moves by itself.

The limits leave a margin to the spread of the drives of a production, see docs/anti-trap.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from liftgate_compiler import compilable
from liftgate_hil.ecu import events
from liftgate_hil.ecu.memory import EcuConstants, EcuMemory

SOUND = -1  # no event


@compilable
def measure_reading(drive: Any, current: float, elapsed: float) -> None:
    """Track the time and the counts for which a drive's current [A] has had the same reading."""
    if current == drive.reading:
        drive.same += elapsed
    else:
        drive.reading, drive.same, drive.same_from = current, 0.0, drive.count


@compilable
def begin_monitoring(memory: EcuMemory) -> None:
    """Reset the plausibility monitor at the beginning of a motion."""
    control = memory.control[0]
    control.over = control.unlike = 0.0
    for i in range(len(memory.drives)):
        memory.drives[i].same = 0.0
        memory.drives[i].same_from = memory.drives[i].count


@compilable
def held_for(seconds: float, is_so: bool, cycle: float) -> float:
    """Return how long a condition has held [s], after one more cycle; 0 if it does not hold."""
    return seconds + cycle if is_so else 0.0


@compilable
def implausible(constants: EcuConstants, memory: EcuMemory) -> int:
    """Return the event of an implausible sensor value in a cycle of a motion; SOUND: none."""
    c, control, drives = constants.calibration, memory.control[0], memory.drives
    mean, largest, is_frozen = 0.0, 0.0, False
    for i in range(len(drives)):
        drive = drives[i]
        mean += (drive.count - drive.start) / len(drives)
        largest = max(largest, abs(drive.reading))
        has_moved = abs(drive.count - drive.same_from) > c.frozen_counts
        is_frozen = is_frozen or (drive.same > c.frozen_time and has_moved)
    control.over = held_for(control.over, largest > c.over_current, constants.cycle)
    if control.over >= c.over_current_time:
        return events.OVER_CURRENT
    if is_frozen:
        return events.CURRENT_FROZEN
    if len(drives) == 1:
        return SOUND
    for i in range(len(drives)):
        if abs(drives[i].count - drives[i].start - mean) > c.counts_apart:
            return events.DRIVES_APART
    left, right = abs(drives[0].current), abs(drives[1].current)
    is_alone = min(left, right) < c.idle_current and max(left, right) > c.lone_current
    control.unlike = held_for(control.unlike, is_alone, constants.cycle)
    return events.CURRENT_LOST if control.unlike >= c.lone_time else SOUND


@compilable
def moves_by_itself(constants: EcuConstants, memory: EcuMemory) -> bool:
    """Whether the gate has come down since it stopped, although it should stand.

    The position that it is compared with is taken anew after each fall, and while the gate settles: at first it
    springs back from where it was pressed to.
    """
    c, control = constants.calibration, memory.control[0]
    falls = False
    for i in range(len(memory.drives)):
        falls = falls or memory.drives[i].count - memory.drives[i].start < -c.fall_counts
    is_settling = control.now - control.entered < c.settling_time
    if is_settling:
        falls = False
    if falls or is_settling:
        for i in range(len(memory.drives)):
            memory.drives[i].start = memory.drives[i].count
    return falls


@compilable
def is_hot(constants: EcuConstants, memory: EcuMemory, temperature: float) -> bool:
    """Whether the motors must cool before they may run, with hysteresis; temperature [°C], NaN: they need not."""
    c, control = constants.calibration, memory.control[0]
    if np.isnan(temperature):
        return False
    if temperature > c.hot:
        control.is_hot = 1
    elif temperature < c.cool:
        control.is_hot = 0
    return bool(control.is_hot != 0)
