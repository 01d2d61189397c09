"""Is the frame the next one? Alive counters, and the state machine of AUTOSAR E2E.

A simple counter must move. An E2E profile (AUTOSAR_PRS_E2EProtocol, R21-11: E2E_PxxCheck) tells repetition, loss
up to a tolerated number and wrong sequence apart; each cycle in which no frame came tolerates one more (delay).
Its state machine (E2E_SMCheck) looks at the last frames in a window, and lets data through only while VALID. A
message that times out starts again from NODATA.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_plant.compiler import compilable

# What a frame is in the sequence.
NEXT, SOME_LOST, FIRST, SYNCHRONISING, REPEATED, WRONG, BAD_SUM = range(7)

# States of the machine. The rows of `min_ok` and `max_error` are those from INIT on.
NODATA, INIT, VALID, INVALID = range(4)

MAX_WINDOW = 32

# What is remembered of a message: the machine's state, frames still to come in synchronisation, how many
# statuses the window holds, where its next one goes; then the window.
STATE, SYNC, HELD, AT, WINDOW = range(5)
MEMORY = WINDOW + MAX_WINDOW

# What the machine makes of a frame's status.
_OTHER, _OK, _ERROR = range(3)


@compilable
def missing(last: int, counter: int, modulus: int) -> int:
    """Frames between two counters."""
    return (counter - last - 1) % modulus


@compilable
def place_in_sequence(
    modulus: int, profile: Any, memory: NDArray[np.int64], last: int, counter: int, late: int
) -> int:
    """What a frame with a sound checksum is, of a counter with so many values; `last` is the counter before (-1:
    none), `late` the cycles in which no frame came. `profile` is the message's record of tables.END_TO_END, or
    None; `memory` the message's row.
    """
    if counter >= modulus:  # 15 in profile 1
        return BAD_SUM
    if last < 0:
        memory[SYNC] = 0
        return FIRST
    if counter == last:
        return REPEATED
    if profile is None:
        return NEXT
    if profile.window == 0:
        return NEXT
    delta = missing(last, counter, modulus) + 1
    if delta > min(profile.max_delta + late, modulus - 1):
        memory[SYNC] = profile.sync
        return WRONG
    if memory[SYNC] > 0:
        memory[SYNC] -= 1
        return SYNCHRONISING
    return NEXT if delta == 1 else SOME_LOST


@compilable
def next_state(profile: Any, memory: NDArray[np.int64], status: int) -> int:
    """E2E_SMCheck: the state after one more frame; VALID without a profile."""
    if profile is None:
        return VALID
    if profile.window == 0:
        return VALID
    state = int(memory[STATE])
    if state == NODATA:
        if status != BAD_SUM:
            memory[STATE] = INIT
        return int(memory[STATE])
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
    return int(memory[STATE])


@compilable
def forget(memory: NDArray[np.int64]) -> None:
    """As before the first frame."""
    memory[:] = 0
