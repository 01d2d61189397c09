"""A measurement, whatever file it came from: columns over one time base."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Column: lowest and highest value allowed. Inputs hold from their row to the next one.
INPUTS: Mapping[str, tuple[float, float]] = {
    "left_voltage_v": (-1000.0, 1000.0),
    "right_voltage_v": (-1000.0, 1000.0),
    "left_duty": (-1.0, 1.0),
    "right_duty": (-1.0, 1.0),
    "left_coast": (0.0, 1.0),
    "right_coast": (0.0, 1.0),
    "supply_voltage_v": (0.0, 1000.0),
    "road_slope_deg": (-45.0, 45.0),
    "hand_force_n": (-1e5, 1e5),
    "ambient_temperature_degc": (-60.0, 150.0),
    "latch_released": (0.0, 1.0),
}
OUTPUTS: Mapping[str, tuple[float, float]] = {
    "left_current_a": (-1e4, 1e4),
    "right_current_a": (-1e4, 1e4),
    "left_speed_rps": (-1e5, 1e5),
    "right_speed_rps": (-1e5, 1e5),
    "left_position_rev": (-1e9, 1e9),
    "right_position_rev": (-1e9, 1e9),
    "left_hall_count": (-1e12, 1e12),
    "right_hall_count": (-1e12, 1e12),
    "gate_angle_deg": (-360.0, 360.0),
}


@dataclass(frozen=True)
class Measurement:
    """Inputs without gaps, outputs NaN where there is no sample."""

    source: str  # the file, for messages
    times: Floats  # (n,) s, finite and rising
    columns: Mapping[str, Floats]  # of INPUTS and OUTPUTS, (n,) each
    through_sensors: (
        bool  # whether the outputs are the sensors' readings (a bus log) or the true ones
    )
    notes: tuple[str, ...] = ()  # what was noticed and done: gaps, outliers, decimation
