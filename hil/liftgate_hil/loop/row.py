"""The row of a recording: true values, sensed values, how well the bench kept up, and the faults in force."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import all_finite, compilable, fill
from liftgate_hil.signals import COLUMN_ROWS, Bench
from liftgate_plant.signals import CURRENT, GATE_ANGLE, GATE_RATE, POSITION, SPEED, Sensed, Truth

_MOST_CURRENT, _MOST_SPEED, _MOST_TURNS = CURRENT.high, SPEED.high, POSITION.high
_MOST_RATE, _MOST_ANGLE = GATE_RATE.high, GATE_ANGLE.high


@compilable
def write_row(row: NDArray[np.float64], truth: Truth, sensed: Sensed, bench: Bench, in_force: float) -> None:
    """Fill a row (ROW_WIDTH,) of signals.COLUMNS; `in_force` are the bits of the faults in force."""
    fill(row, COLUMN_ROWS.truth, truth)
    fill(row, COLUMN_ROWS.sensed, sensed)
    fill(row, COLUMN_ROWS.bench, bench)
    row[COLUMN_ROWS.faults] = in_force


@compilable
def is_sound(truth: Truth) -> bool:
    """Whether the plant still gives finite numbers, within the catalogue's limits for currents and motions.

    A plant that diverges exceeds these limits long before it exceeds what a number can hold.
    """
    return (
        all_finite(truth)
        and max(abs(truth.left_current_a), abs(truth.right_current_a)) <= _MOST_CURRENT
        and max(abs(truth.left_speed_rps), abs(truth.right_speed_rps)) <= _MOST_SPEED
        and max(abs(truth.left_position_rev), abs(truth.right_position_rev)) <= _MOST_TURNS
        and abs(truth.gate_rate_degps) <= _MOST_RATE
        and abs(truth.gate_angle_deg) <= _MOST_ANGLE
    )
