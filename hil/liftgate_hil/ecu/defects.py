"""What may be wrong with the reference ECU on purpose, so that tests of an ECU can be tested.

Data, as its calibration is: 0 is as it should be.
"""

from __future__ import annotations

from typing import NamedTuple


class Defects(NamedTuple):
    """Of its program; those of its numbers are other values of the calibration."""

    closing_unwatched: int = 0  # 1: nothing is seen in the way of the closing gate
    opening_unwatched: int = 0  # 1: nothing is seen in the way of the opening gate
    one_drive_watched: int = 0  # 1: the load of the left drive stands for both
    second_run_unwatched: int = 0  # 1: after a reversal the next run is not watched
    only_stops: int = 0  # 1: what is trapped stays so: the gate stops instead of reversing
    learns_disturbed: int = 0  # 1: the loads of a run that was broken off are learned, too
    stop_ignored: int = 0  # 1: the driver cannot stop a motion
    latch_unseen: int = 0  # 1: what the latch's switch says is not looked at
    latch_believed: int = 0  # 1: what it says is believed far from closed, too
    one_drive_commanded: int = 0  # 1: the right drive is not driven
    end_never_learned_again: int = 0  # 1: open, where the gate is open already, does nothing
    goes_on_after_reset: int = 0  # 1: switched on with the gate open, it closes it


NO_DEFECTS = Defects()
