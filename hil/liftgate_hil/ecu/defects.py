"""Defects that the reference ECU can be given on purpose, so that tests of an ECU can be tested.

They are data, as the calibration is; 0 means no defect.
"""

from __future__ import annotations

from typing import NamedTuple


class Defects(NamedTuple):
    """Defects of the ECU's program; those of its numbers are other values of the calibration."""

    closing_unwatched: int = 0  # 1: nothing trapped is detected while closing
    opening_unwatched: int = 0  # 1: nothing trapped is detected while opening
    one_drive_watched: int = 0  # 1: only the load of the left drive is evaluated
    second_run_unwatched: int = 0  # 1: the next run after a reversal is not supervised
    only_stops: int = 0  # 1: the gate stops instead of reversing, and what is trapped stays trapped
    learns_disturbed: int = 0  # 1: the loads of an aborted run are learned, too
    stop_ignored: int = 0  # 1: the driver cannot stop a motion
    latch_unseen: int = 0  # 1: the latch switch is ignored
    latch_believed: int = 0  # 1: the latch switch is believed far from closed, too
    one_drive_commanded: int = 0  # 1: the right drive is not driven
    end_never_learned_again: int = 0  # 1: a request to open does nothing where the gate is already open
    goes_on_after_reset: int = 0  # 1: the ECU closes the gate when it is switched on with the gate open


NO_DEFECTS = Defects()
