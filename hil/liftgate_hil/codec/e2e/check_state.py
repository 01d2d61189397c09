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
    table: Any, memory: NDArray[np.int64], last: int, counter: int, late: int
) -> int:
    """What a frame with a sound checksum is; `last` is the counter before (-1: none), `late` the cycles in
    which no frame came. `table` is a record of tables.MESSAGE, `memory` the message's row.
    """
    if counter >= table.modulus:  # 15 in profile 1
        return BAD_SUM
    if last < 0:
        memory[SYNC] = 0
        return FIRST
    if counter == last:
        return REPEATED
    if table.window == 0:
        return NEXT
    delta = missing(last, counter, table.modulus) + 1
    if delta > min(table.max_delta + late, table.modulus - 1):
        memory[SYNC] = table.sync
        return WRONG
    if memory[SYNC] > 0:
        memory[SYNC] -= 1
        return SYNCHRONISING
    return NEXT if delta == 1 else SOME_LOST


@compilable
def next_state(table: Any, memory: NDArray[np.int64], status: int) -> int:
    """E2E_SMCheck: the state after one more frame."""
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
    memory[AT] = (memory[AT] + 1) % table.window
    memory[HELD] = min(memory[HELD] + 1, table.window)
    good, bad = 0, 0
    for i in range(memory[HELD]):
        good += memory[WINDOW + i] == _OK
        bad += memory[WINDOW + i] == _ERROR
    row = state - INIT
    if bad <= table.max_error[row] and good >= table.min_ok[row]:
        memory[STATE] = VALID
    elif state == VALID or bad > table.max_error[row]:
        memory[STATE] = INVALID
    return int(memory[STATE])


@compilable
def forget(memory: NDArray[np.int64]) -> None:
    """As before the first frame."""
    memory[:] = 0
