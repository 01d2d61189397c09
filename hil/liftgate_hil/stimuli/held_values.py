"""Values that commands set while a run goes on, and that hold until another command sets them."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.signals import Timing
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.signals import Surroundings

# Surroundings (NaN: none), an obstacle (stiffness NaN: none), timing.
NAMES = (*Surroundings._fields, *(f"obstacle_{name}" for name in Obstacle._fields), *Timing._fields)
HELD: Any = namedtuple("Held", NAMES)(*range(len(NAMES)))
HELD_SURROUNDINGS = Surroundings(**{name: getattr(HELD, name) for name in Surroundings._fields})
HELD_OBSTACLE = Obstacle(**{name: getattr(HELD, f"obstacle_{name}") for name in Obstacle._fields})
HELD_TIMING = Timing(**{name: getattr(HELD, name) for name in Timing._fields})


def nothing_held() -> NDArray[np.float64]:
    """Return the held values before the first command."""
    return np.full(len(NAMES), np.nan)
