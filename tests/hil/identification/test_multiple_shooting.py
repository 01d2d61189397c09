"""Data cut into short pieces: which of them tell of the motion."""

from __future__ import annotations

import numpy as np
import pytest

from liftgate_hil.identification.multiple_shooting import in_segments
from liftgate_hil.identification.problem import Problem
from liftgate_hil.identification.trajectory import REST
from tests.hil.identification.simulated import measured
from tests.plant.runs import suv


@pytest.mark.parametrize(("released_at", "left_out"), [(0.0, 0.0), (1.0, 1.225)])
def test_pieces_in_which_the_latch_holds_the_closed_gate_are_left_out(released_at: float, left_out: float) -> None:
    times = np.arange(601) / 200.0
    drive = (times, np.where(times < 1.0, 0.0, 12.0))
    data = measured(
        suv(),
        "full",
        {"left_position_rev": 0.0, "gate_angle_deg": 0.0},
        drive=drive,
        start=REST._replace(latched=1.0),
        latch_released=np.where(times < released_at, 0.0, 1.0),
    )
    assert data.outputs["gate_angle_deg"][-1] > 5.0
    cut = in_segments(Problem(suv(), "full", [], [data], [*data.outputs], 0.0))
    assert cut is not None
    # Pieces of 49 samples; the fifth begins at 0.98 s, while the latch still holds.
    assert data.times[-1] - sum(np.ptp(each.times) for each in cut.data) == pytest.approx(left_out, abs=1e-9)
