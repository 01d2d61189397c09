"""A measurement, whatever file it came from: columns over one time base."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.signals import COLUMNS, INPUT_SIGNALS
from liftgate_plant.signals import Signal

Floats = NDArray[np.float64]

# Inputs hold from their row to the next one.
INPUTS: Mapping[str, Signal] = INPUT_SIGNALS
OUTPUTS: Mapping[str, Signal] = {
    name: COLUMNS[name]
    for name in (
        *(f"{side}_{what}" for what in ("current_a", "speed_rps", "position_rev", "hall_count")
          for side in ("left", "right")),
        "gate_angle_deg",
    )
}  # fmt: skip


@dataclass(frozen=True)
class Measurement:
    """Columns over one time base: inputs without gaps, outputs NaN where there is no sample."""

    source: str  # the file, for messages
    times: Floats  # (n,) s, finite and rising
    columns: Mapping[str, Floats]  # of INPUTS and OUTPUTS, (n,) each
    # Whether the outputs are the sensors' readings (a bus log) or the true values.
    through_sensors: bool
    notes: tuple[str, ...] = ()  # what was noticed and done: gaps, outliers, decimation
