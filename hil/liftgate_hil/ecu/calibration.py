"""Calibration of the reference ECU: the constants that an ECU developer would calibrate.

Speeds are in Hall counts per second, positions in counts.
"""

from __future__ import annotations

from typing import NamedTuple

from liftgate_plant.coding import Coding


class Defects(NamedTuple):
    """Seeded defects of the ECU's program; defects of its constants are other values of the calibration."""

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


class Calibration(NamedTuple):
    """Constants of the reference ECU, tuned by hand on the three shipped vehicles."""

    # Motion: speeds over the travel [travels/s], at PLACES from closed to open. Closing is slow where the gate's
    # edge moves fast at a given speed of the drives, and where the backlash is crossed.
    opening_speed: tuple[float, ...] = (
        0.190, 0.190, 0.190, 0.190, 0.195, 0.200, 0.200, 0.200, 0.200, 0.200, 0.176, 0.127, 0.085, 0.040,
    )  # fmt: skip
    closing_speed: tuple[float, ...] = (
        0.030, 0.055, 0.078, 0.102, 0.134, 0.155, 0.158, 0.158, 0.150, 0.140, 0.130, 0.120, 0.110, 0.110,
    )  # fmt: skip
    opening_start: float = 0.20  # travels/s², acceleration of the soft start
    closing_start: float = 0.10  # travels/s²
    learning_speed: float = 350.0  # counts/s while the travel is not known
    learning_start: float = 500.0  # counts/s², acceleration of its soft start
    creep_speed: float = 90.0  # counts/s, lowest speed, also into the end stops and the latch
    end_margin: float = 12.0  # counts before the learned open end at which the gate stops

    # Speed control of each drive, and synchronization of the two.
    rated_speed: float = 620.0  # counts/s at full duty and rated voltage, no load
    rated_voltage: float = 12.0  # V
    gain: float = 0.0005  # duty per count/s
    integral_time: float = 0.15  # s
    tie: float = 5.0  # 1/s, speed correction per count that one drive is ahead
    speed_window: float = 0.040  # s over which counts are differenced
    counts_per_turn: float = 4.0  # counts per motor revolution; measured where the bus carries the speed
    turns_to_count: float = 20.0  # revolutions, after which the measured number is used

    # Anti-trap.
    inertia: float = 0.0076  # A s²/rev, motor current per acceleration of a drive: 2π J/c1Φ
    inertia_error: float = 0.42  # relative error of `inertia` that is allowed for
    ramp_time: float = 0.20  # s, time constant with which a change of the wanted speed dies away
    load_filter: float = 0.007  # s, time constant for current and speed
    excess_learned: float = 0.12  # A by which the load may exceed the learned reference
    excess_unlearned: float = 0.60  # A by which it may exceed this run's own recent load
    excess_share: float = 0.03  # share of the load itself, for ripple and warm magnets
    excess_per_slope: float = 2.0  # counts of position error, which matter where the reference is steep
    reference_time: float = 0.50  # s, time constant for tracking what shifts the whole reference
    blank_time: float = 0.50  # s after a start during which nothing is judged
    detection_time: float = 0.005  # s for which the load must exceed its limit without a break
    seal_zone: float = 36.0  # counts above closed in which the seal is expected
    reverse_distance: float = 0.30  # share of the travel by which a reversal opens

    # Ends.
    stall_speed: float = 25.0  # counts/s, below which the gate is standing
    stall_blank: float = 0.6  # s after a start during which a stall is not judged
    stall_time: float = 0.15  # s of standing that make a stall
    seal_stall_time: float = 1.0  # s, the same in the seal zone
    hold_time: float = 0.25  # s of braking after a stop
    latch_pulse: float = 1.0  # s, longest release of the latch
    learning_excess: float = 3.5  # A over this run's own recent load that mark the end stop to be learned

    learning_time: float = 0.025  # s for which that must last
    most_squeezed: float = 100.0  # counts at most from where the load rises to where the drives stand

    # Plausibility. Sound drives of a production were seen 15 counts from their mean.
    feedback_timeout: float = 0.05  # s without a drive's feedback
    counts_apart: float = 40.0  # counts, deviation of a drive from the mean of both
    frozen_time: float = 0.5  # s for which a current's reading stays the same although the drive moves
    frozen_counts: float = 20.0  # counts by which the drive must have moved meanwhile
    over_current: float = 45.0  # A
    over_current_time: float = 0.1  # s
    idle_current: float = 0.15  # A, below which a drive is idle
    lone_current: float = 1.2  # A, above which the other drive carries the whole load
    lone_time: float = 0.5  # s for which that must last
    fall_counts: float = 20.0  # counts by which a standing gate may come down before it is held
    fall_hold_time: float = 10.0  # s of braking that hold it
    settling_time: float = 1.0  # s after a stop during which the gate settles
    travel_change: float = 20.0  # counts by which a new open end must be further to replace the known one
    latch_zone: float = 100.0  # counts above closed within which a report of the latch as closed is plausible
    hot: float = 110.0  # °C of a motor above which no motion begins
    cool: float = 90.0  # °C below which motions may begin again

    defects: Defects = NO_DEFECTS


CALIBRATED = Calibration()


def coded(calibration: Calibration, coding: Coding) -> Calibration:
    """Return the calibration with closing speed and anti-trap limits scaled by a vehicle's coding."""
    pace, limits = coding.closing_speed, coding.anti_trap_limits
    return calibration._replace(
        closing_speed=tuple(pace * speed for speed in calibration.closing_speed),
        closing_start=pace * calibration.closing_start,
        inertia_error=limits * calibration.inertia_error,
        excess_learned=limits * calibration.excess_learned,
        excess_unlearned=limits * calibration.excess_unlearned,
        excess_share=limits * calibration.excess_share,
        excess_per_slope=limits * calibration.excess_per_slope,
    )


# Shares of the travel above closed; when closing, above the seal zone.
PLACES = (0.0, 0.02, 0.05, 0.10, 0.20, 0.30, 0.50, 0.60, 0.70, 0.80, 0.90, 0.95, 0.98, 1.0)  # fmt: skip

BINS = 100  # bins of the position-dependent load reference
FINE = 34  # of these bins for the last counts before closed, 4 counts each
FINE_FROM, FINE_TO = (-40.0, 96.0)  # counts; below 0 since the drives squeeze the mechanism on closing
