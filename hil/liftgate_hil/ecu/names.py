"""Values of `ecu` that are keywords, not a file, a class or an object."""

from __future__ import annotations

REFERENCE = "reference"  # the reference ECU
ON_A_BUS = "bus"  # an external ECU, on a bus
