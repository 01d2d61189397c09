"""What an ECU developer would calibrate. Speeds in Hall counts per second, positions in counts."""

from __future__ import annotations

from typing import NamedTuple

from liftgate_hil.ecu.defects import NO_DEFECTS, Defects
from liftgate_plant.coding import Coding


class Calibration(NamedTuple):
    """The reference ECU's constants. Chosen by hand on the three shipped vehicles."""

    # Motion: speeds over the travel, in travels a second, at PLACES from closed to open. Closing is slow where the
    # gate's edge is quick for it, and where the backlash is crossed.
    opening_speed: tuple[float, ...] = (
        0.190, 0.190, 0.190, 0.190, 0.195, 0.200, 0.200, 0.200, 0.200, 0.200, 0.176, 0.127, 0.085, 0.040,
    )  # fmt: skip
    closing_speed: tuple[float, ...] = (
        0.030, 0.055, 0.078, 0.102, 0.134, 0.155, 0.158, 0.158, 0.150, 0.140, 0.130, 0.120, 0.110, 0.110,
    )  # fmt: skip
    opening_start: float = 0.20  # travels a second, in a second: the soft start
    closing_start: float = 0.10
    learning_speed: float = 350.0  # before the travel is known
    learning_start: float = 500.0  # counts/s², its soft start
    creep_speed: float = 90.0  # at least, and into the end stops and the latch
    end_margin: float = 12.0  # stop this far before the learned open end

    # Speed control of each drive, and the two kept together.
    rated_speed: float = 620.0  # counts/s at full duty and rated voltage, no load
    rated_voltage: float = 12.0  # V
    gain: float = 0.0005  # duty per count/s
    integral_time: float = 0.15  # s
    tie: float = 5.0  # 1/s, speed correction per count that one drive is ahead
    speed_window: float = 0.040  # s over which counts are differenced
    counts_per_turn: float = 4.0  # of a motor; where the bus tells its speed, they are counted
    turns_to_count: float = 20.0  # before it is believed

    # Anti-trap.
    inertia: float = 0.0076  # A s²/rev that accelerating a drive takes of the current: 2π J/c1Φ
    inertia_error: float = 0.42  # share by which that may be wrong
    ramp_time: float = 0.20  # s for which a change of the wanted speed is felt
    load_filter: float = 0.007  # s
    excess_learned: float = 0.12  # A over the learned reference
    excess_unlearned: float = 0.60  # A over this run's own recent load
    excess_share: float = 0.03  # of the load itself: ripple, warm magnets
    excess_per_slope: float = 2.0  # counts that a place may be off, where the reference is steep
    reference_time: float = 0.50  # s, how fast what moves the whole reference is followed
    blank_time: float = 0.50  # s after a start in which nothing is judged
    detection_time: float = 0.005  # s without a break
    seal_zone: float = 36.0  # counts above closed in which the seal is expected
    reverse_distance: float = 0.30  # share of the travel that a reversal opens

    # Ends.
    stall_speed: float = 25.0  # slower than this is standing
    stall_blank: float = 0.6  # s after a start in which standing is not yet judged
    stall_time: float = 0.15  # s
    seal_stall_time: float = 1.0  # s, in the seal zone
    hold_time: float = 0.25  # s of braking after a stop
    latch_pulse: float = 1.0  # s at most
    learning_excess: float = 3.5  # A over this run's own recent load: the stop that is looked for

    learning_time: float = 0.025  # s for which that is to last
    most_squeezed: float = 100.0  # counts from where the load rises to where the drives stand

    # What cannot be. Sound drives of a production were seen 15 counts from their mean.
    feedback_timeout: float = 0.05  # s without a drive's feedback
    counts_apart: float = 40.0  # of a drive from the mean of both
    frozen_time: float = 0.5  # s of one and the same reading of a current, though the drive moves
    frozen_counts: float = 20.0
    over_current: float = 45.0  # A
    over_current_time: float = 0.1  # s
    idle_current: float = 0.15  # A, of a drive that does nothing,
    lone_current: float = 1.2  # A, while the other carries all,
    lone_time: float = 0.5  # s
    fall_counts: float = 20.0  # that a gate which stands may come down before it is held
    fall_hold_time: float = 10.0  # s
    settling_time: float = 1.0  # s after a stop
    travel_change: float = 20.0  # counts that another open end is to be further
    latch_zone: float = 100.0  # counts above closed in which the latch may say that it holds
    hot: float = 110.0  # °C of a motor, above which no motion begins
    cool: float = 90.0  # °C, below which one does again

    defects: Defects = NO_DEFECTS


CALIBRATED = Calibration()


def coded(calibration: Calibration, coding: Coding) -> Calibration:
    """The calibration of a vehicle."""
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


# Shares of the travel; closing, of what is left to the seal.
PLACES = (0.0, 0.02, 0.05, 0.10, 0.20, 0.30, 0.50, 0.60, 0.70, 0.80, 0.90, 0.95, 0.98, 1.0)  # fmt: skip

BINS = 100  # of the position-dependent reference of the load
FINE = 34  # of them for the last counts before closed, 4 each
FINE_FROM, FINE_TO = -40.0, 96.0  # counts: closed, the drives have squeezed the mechanism
