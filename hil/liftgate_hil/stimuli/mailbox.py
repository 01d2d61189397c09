"""A command queue into the running loop: posted values hold from the next tick on, until they are posted again.

One side posts, the loop takes; neither waits. A command says which of the held values it replaces.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.signals import Timing
from liftgate_plant.compiler import compilable
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.signals import Surroundings

# The values that are held: surroundings (NaN: none), an obstacle (stiffness NaN: none), timing.
_NAMES = (
    *Surroundings._fields,
    *(f"obstacle_{name}" for name in Obstacle._fields),
    *Timing._fields,
)
HELD: Any = namedtuple("Held", _NAMES)(*range(len(_NAMES)))
HELD_SURROUNDINGS = Surroundings(**{name: getattr(HELD, name) for name in Surroundings._fields})
HELD_OBSTACLE = Obstacle(**{name: getattr(HELD, f"obstacle_{name}") for name in Obstacle._fields})
HELD_TIMING = Timing(**{name: getattr(HELD, name) for name in Timing._fields})

LETTER = np.dtype(
    [
        ("place", "i8"),  # place of the first value replaced
        ("count", "i8"),
        ("values", "f8", (max(len(Obstacle._fields), len(Timing._fields)),)),
    ]
)
LETTERS = 256  # commands that may wait; the loop empties the queue every tick
# Counters: commands posted so far (written by the posting side), commands taken (written by the loop).
BOX = np.dtype([("posted", "i8"), ("taken", "i8"), ("letters", LETTER, (LETTERS,))])


def nothing_held() -> NDArray[np.float64]:
    """Return the held values before anything was posted."""
    return np.full(len(_NAMES), np.nan)


def post(box: Any, values: Mapping[str, float]) -> bool:
    """Post held values by their names, in one command; return False where the queue (a row of BOX) is full.

    Raises ValueError for values that are not held one after the other.
    """
    if box["posted"] - box["taken"] >= LETTERS:
        return False
    places = [_NAMES.index(name) for name in values]
    if places != list(range(places[0], places[0] + len(places))):
        raise ValueError(f"{', '.join(values)}: allowed: values that are held one after the other")
    letter = box["letters"][box["posted"] % LETTERS]
    letter["place"], letter["count"] = places[0], len(places)
    letter["values"][: len(places)] = list(values.values())
    box["posted"] += 1
    return True


def post_all(box: Any, values: Mapping[str, float]) -> bool:
    """Post held values by their names, in as many commands as it takes.

    Returns False, and posts none of them, where the queue (a row of BOX) has no room.
    """
    most = LETTER["values"].shape[0]
    letters: list[dict[str, float]] = []
    for place in sorted(map(_NAMES.index, values)):
        name = _NAMES[place]
        if not letters or _NAMES[place - 1] not in letters[-1] or len(letters[-1]) == most:
            letters.append({})
        letters[-1][name] = values[name]
    if box["posted"] - box["taken"] + len(letters) > LETTERS:
        return False
    for each in letters:
        post(box, each)
    return True


def hold(held: NDArray[np.float64], values: Mapping[str, float]) -> None:
    """Set held values by their names; called in the loop's own thread."""
    for name, value in values.items():
        held[_NAMES.index(name)] = value


@compilable
def take_letters(box: Any, held: NDArray[np.float64]) -> None:
    """Apply all posted commands to the held values; `box` is (1,) BOX."""
    posted = box[0].posted
    while box[0].taken < posted:
        letter = box[0].letters[box[0].taken % LETTERS]
        for i in range(letter.count):
            held[letter.place + i] = letter.values[i]
        box[0].taken += 1
