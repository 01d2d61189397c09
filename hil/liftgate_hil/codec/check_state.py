"""Sequence checks of received frames: alive counters, and the state machine of AUTOSAR E2E.

A simple counter must change. An E2E profile (AUTOSAR_PRS_E2EProtocol, R21-11: E2E_PxxCheck) distinguishes
repetition, loss up to a tolerated number and wrong sequence; each cycle in which no frame came raises the
tolerance by one (delay). Its state machine (E2E_SMCheck) evaluates the last frames in a window, and lets data
through only while VALID. A message that times out starts again from NODATA.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined

# Status of a frame.
NEXT, SOME_LOST, FIRST, SYNCHRONISING, REPEATED, WRONG, BAD_SUM = range(7)

# States of the machine. `min_ok` and `max_error` have one row per state from INIT on.
NODATA, INIT, VALID, INVALID = range(4)

MAX_WINDOW = 32

# E2E check state of a message: state of the machine, frames left in synchronisation, number of statuses in the
# window, index of the next one; then the window.
STATE, SYNC, HELD, AT, WINDOW = range(5)
MEMORY = WINDOW + MAX_WINDOW

# Kinds of status that the machine distinguishes.
_OTHER, _OK, _ERROR = range(3)


@compilable
def missing(last: int, counter: int, modulus: int) -> int:
    """Return how many frames are missing between two indices (turns) in a counter's sequence of `modulus`."""
    return (counter - last - 1) % modulus


@compilable
def place_of_simple(last: int, turn: int) -> int:
    """Return the counter status of a frame with a simple alive counter: NEXT, FIRST, REPEATED or WRONG.

    `turn` is the counter's index in its sequence (-1: no valid value), `last` that of the frame before (-1: none).
    """
    if turn < 0:
        return WRONG
    if last < 0:
        return FIRST
    return REPEATED if turn == last else NEXT


@compilable
def place_in_sequence(
    modulus: int, profile: Any, memory: NDArray[np.int64], last: int, turn: int, late: int
) -> int:
    """Return the counter status of an E2E-protected frame with a correct checksum: any but BAD_SUM.

    `turn` is the turn of its counter, which repeats after `modulus` turns, `last` that of the frame before (-1:
    none), `late` the number of cycles in which no frame came. `profile` is the message's row of tables.END_TO_END;
    in `memory`, its E2E check state, the number of frames left in synchronisation is updated.
    """
    if last < 0:
        memory[SYNC] = 0
        return FIRST
    if turn == last:
        return REPEATED
    delta = missing(last, turn, modulus) + 1
    if delta > min(profile.max_delta + late, modulus - 1):
        memory[SYNC] = profile.sync
        return WRONG
    if memory[SYNC] > 0:
        memory[SYNC] -= 1
        return SYNCHRONISING
    return NEXT if delta == 1 else SOME_LOST


@outlined
def checked(
    profile: Any, memory: NDArray[np.int64], modulus: int, is_sound: bool, last: int, turn: int, late: int
) -> int:
    """Return the status of an E2E-protected frame and advance the state machine of its message.

    The status results from the checksum (`is_sound`) and the place in the sequence. A counter value that the
    profile does not have (`turn` -1: 15 in profile 1) is an error like a bad checksum, but leaves the machine as
    it is.
    """
    if is_sound and turn < 0:
        return BAD_SUM
    status = BAD_SUM
    if is_sound:
        status = place_in_sequence(modulus, profile, memory, last, turn, late)
    note_status(profile, memory, status)
    return status


@compilable
def is_qualified(memory: NDArray[np.int64], status: int) -> bool:
    """Whether the data of an E2E-protected frame may be used; `status` is what `checked` returned for it."""
    return bool(memory[STATE] == VALID and status != SYNCHRONISING)


@compilable
def note_status(profile: Any, memory: NDArray[np.int64], status: int) -> None:
    """Advance the E2E state machine of a message by the status of one frame (E2E_SMCheck)."""
    state = int(memory[STATE])
    if state == NODATA:
        if status != BAD_SUM:
            memory[STATE] = INIT
        return
    kind = _OTHER
    if status in (NEXT, SOME_LOST, SYNCHRONISING):
        kind = _OK
    elif status == BAD_SUM:
        kind = _ERROR
    memory[WINDOW + memory[AT]] = kind
    memory[AT] = (memory[AT] + 1) % profile.window
    memory[HELD] = min(memory[HELD] + 1, profile.window)
    good, bad = 0, 0
    for i in range(memory[HELD]):
        good += memory[WINDOW + i] == _OK
        bad += memory[WINDOW + i] == _ERROR
    row = state - INIT
    if bad <= profile.max_error[row] and good >= profile.min_ok[row]:
        memory[STATE] = VALID
    elif state == VALID or bad > profile.max_error[row]:
        memory[STATE] = INVALID


@compilable
def forget(memory: NDArray[np.int64]) -> None:
    """Reset a message's E2E check state to that before the first frame."""
    memory[:] = 0
