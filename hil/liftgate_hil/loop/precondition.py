"""What goes before a scenario: an ECU that is to have learned its gate goes through a few motions first.

They run in machine code on every clock, at no pace but its own, and nobody looks on: the scenario's time 0 is
where they end, with gate and ECU as they are then. Nothing of the scenario acts before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.errors import PreconditionError
from liftgate_hil.loop.closed_loop import Episode
from liftgate_hil.loop.tick import LoopConfig, LoopState
from liftgate_hil.signals import COLUMN_PLACE
from liftgate_hil.stimuli.moments import Instant, Sheet
from liftgate_hil.stimuli.requests import Request, requests_of
from liftgate_hil.stimuli.scene import Scene

_LONG_AGO = 2**36  # ticks before the scenario's time 0, as long as that is not known
_AGES = 2e9  # s before it, and before that
_LOOK = 0.5  # s of standing after which a motion is over
_MOST = 120.0  # s
_STANDS = {  # slower than this is standing
    "gate_rate_degps": 0.02,
    "left_speed_rps": 0.02,
    "right_speed_rps": 0.02,
    "left_current_a": 0.05,
    "right_current_a": 0.05,
}


class _Standing:
    """Whether all stood still in the rows since the last question."""

    def __init__(self) -> None:
        self._limits = [(COLUMN_PLACE[name], limit) for name, limit in _STANDS.items()]
        self._moved = False

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """See Taker."""
        self._moved |= any(bool((abs(rows[:, at]) > limit).any()) for at, limit in self._limits)

    def stood(self) -> bool:
        """Since it was last asked."""
        moved, self._moved = self._moved, False
        return not moved


def gone_through(
    config: LoopConfig,
    state: LoopState,
    scene: Scene,
    adapter: Adapter,
    actions: Sequence[str],
    stopped: Callable[[], bool] = lambda: False,
    guard: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> LoopState:
    """The gate after requests, each made when the motion of the one before is over; `scene` begins there. The ECU
    runs within a `guard`.

    Raises PreconditionError, EcuError, PlantDivergedError.
    """
    if not actions:
        return state
    standing = _Standing()
    look = max(1, round(_LOOK / config.step))
    episode = Episode(config, state, scene, adapter, [standing], is_recorded=False)
    scene.origin[0] = state.tick + _LONG_AGO
    try:
        episode.begin()
        for action in actions:
            asked = requests_of([Request(Instant(-_AGES), action)], Sheet())
            episode.follow(scene._replace(requests=asked))
            for count in range(round(_MOST / _LOOK)):
                with guard():
                    episode.advance(look)
                if stopped() or (standing.stood() and count > 1):
                    break
            else:
                raise PreconditionError(
                    f"precondition: {action}: the gate still moves after {_MOST:g} s; allowed: motions that end"
                )
    finally:
        episode.close()
    scene.origin[0] = episode.state.tick
    adapter.begins_anew(episode.state.tick * config.step)
    return episode.state
