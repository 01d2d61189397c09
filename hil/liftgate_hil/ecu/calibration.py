"""What an ECU developer would calibrate. Speeds in Hall counts per second, positions in counts."""

from __future__ import annotations

from typing import NamedTuple


class Calibration(NamedTuple):
    """The reference ECU's constants. Chosen by hand on the three shipped vehicles."""

    # Motion. Travel times are of a typical gate: 4 to 8 s.
    opening_time: float = 6.0  # s over the learned travel
    closing_time: float = 9.0  # s: what is trapped is met more slowly
    learning_speed: float = 350.0  # before the travel is known
    creep_speed: float = 90.0  # into the end stops and the latch
    start_time: float = 0.6  # s, soft start from rest to full speed
    stop_distance: float = 0.14  # share of the travel in which the soft stop slows down
    end_margin: float = 12.0  # stop this far before the learned open end

    # Speed control of each drive, and the two kept together.
    rated_speed: float = 620.0  # counts/s at full duty and rated voltage, no load
    rated_voltage: float = 12.0  # V
    gain: float = 0.0005  # duty per count/s
    integral_time: float = 0.15  # s
    tie: float = 5.0  # 1/s, speed correction per count that one drive is ahead
    speed_window: float = 0.040  # s over which counts are differenced

    # Anti-trap.
    current_filter: float = 0.006  # s
    excess_learned: float = 0.40  # A over the learned reference
    excess_unlearned: float = 0.45  # A over this run's own recent current
    reference_time: float = 0.30  # s, how fast that recent current follows
    speed_drop: float = 0.10  # share of the wanted speed that counts as much as the excess
    certainty: float = 1.8  # sum of both, in units of their limits
    change_factor: float = 2.0  # on the excess, during soft start and soft stop
    blank_time: float = 0.25  # s after a start in which nothing is judged
    detection_time: float = 0.020  # s without a break
    seal_zone: float = 36.0  # counts above closed in which the seal is expected
    reverse_distance: float = 0.30  # share of the travel that a reversal opens

    # Ends.
    stall_speed: float = 25.0  # slower than this is standing
    stall_time: float = 0.15  # s
    seal_stall_time: float = 1.0  # s, in the seal zone
    hold_time: float = 0.25  # s of braking after a stop
    latch_pulse: float = 1.0  # s at most


BINS = 50  # of the position-dependent current reference
