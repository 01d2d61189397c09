"""The study of the reference ECU's anti-trap protection, shortened."""

from __future__ import annotations

import math

import pytest

from liftgate_hil.ecu.calibration import Calibration
from tools.anti_trap.study import LIMIT, drawn, speed_for, widened
from tools.anti_trap.trials import Car, Trial, run

GAPS = (0.3, 4.0, 30.0, 65.0)  # deg


def test_with_a_learned_gate_the_ecu_reverses_below_the_force_limit_without_false_alarms() -> None:
    done = run(Car("suv"), Trial(free=2, gaps=GAPS), Calibration())
    assert done.false == done.missed == 0
    assert 10.0 < max(done.peaks) < LIMIT
    assert done.opening < 6.0
    assert done.closing < 9.5
    assert max(done.speeds) > 0.2


def test_narrow_anti_trap_limits_give_false_reversals_and_wide_ones_larger_forces() -> None:
    own, car = Calibration(), Car("suv")
    narrow = run(car, Trial(free=3), widened(own, 0.2))
    assert narrow.false > 0
    usual, wide = (run(car, Trial(gaps=(30.0,)), widened(own, factor)).peaks[0] for factor in (1.0, 3.0))
    assert wide > usual + 10.0


def test_a_random_car_is_repeatable() -> None:
    assert drawn("compact", 5) == drawn("compact", 5)
    assert drawn("compact", 5) != drawn("compact", 6)


def test_the_closing_speed_at_the_force_limit_is_interpolated() -> None:
    points = [(0.2, 150.0), (0.1, 50.0), (math.nan, math.nan)]
    assert speed_for(points) == pytest.approx(0.15)
    assert speed_for([(0.1, 50.0), (0.2, 90.0)]) == 0.2
    assert math.isnan(speed_for([(0.1, 150.0)]))
