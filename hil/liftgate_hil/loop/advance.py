"""Order of the operations within one tick, which all loops share.

The stimuli act, the gate advances, its frames are made ready to be sent, and the row of the recording is written.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import all_finite, compilable, fill
from liftgate_hil.codec.frames import Frames
from liftgate_hil.loop.tick import LoopConfig, LoopState, tick
from liftgate_hil.signals import COLUMN_ROWS, Bench
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan, note_tick, outside_at, sent
from liftgate_plant.signals import CURRENT, GATE_ANGLE, GATE_RATE, POSITION, SPEED, Sensed, Truth


@compilable
def advance(
    gate: LoopConfig,
    state: LoopState,
    stimuli: StimulusPlan,
    given: Frames,
    row: NDArray[np.float64],
    bench: Bench,
    is_silent: bool,
    is_stop: bool,
) -> tuple[LoopState, Frames, bool]:
    """Advance by one tick; return the state, the frames that the gate sends, and whether the plant is still sound.

    `gate` has the constants in force, see `tick.in_force`. The gate reads the frames `given`; the tick's row is
    written to `row` (1, ROW_WIDTH), and the conditions are evaluated with it. `is_silent`: the tick makes up for
    a missed one and sends nothing; `is_stop`: it is the last one, with the motors off. Both are flags and no
    enumeration, so that the compiler drops what a loop never does: 5 % of an episode.
    """
    now = (state.tick - stimuli.origin[0]) * gate.step
    missed = int(bench.ticks_missed)
    outside = outside_at(stimuli, now, gate.step, missed, is_silent, is_stop)
    state, replies, truth, sensed = tick(gate, state, given, outside)
    if not (is_silent or is_stop):
        replies = sent(stimuli, replies, state.tick, gate.step_ns, gate.seed)
    write_row(row[0], truth, sensed, bench, stimuli.faults.in_force[0])
    note_tick(stimuli, row, given, replies)
    return state, replies, is_sound(truth)


_MOST_CURRENT, _MOST_SPEED, _MOST_TURNS = CURRENT.high, SPEED.high, POSITION.high
_MOST_RATE, _MOST_ANGLE = GATE_RATE.high, GATE_ANGLE.high


@compilable
def write_row(row: NDArray[np.float64], truth: Truth, sensed: Sensed, bench: Bench, in_force: float) -> None:
    """Write a tick's values to a row (ROW_WIDTH,) of signals.COLUMNS; `in_force`: bits of the faults in force."""
    fill(row, COLUMN_ROWS.truth, truth)
    fill(row, COLUMN_ROWS.sensed, sensed)
    fill(row, COLUMN_ROWS.bench, bench)
    row[COLUMN_ROWS.faults] = in_force


@compilable
def is_sound(truth: Truth) -> bool:
    """Whether the plant's values are finite and within the catalogue's limits for currents and motions.

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
