"""The precondition of a scenario: motions by which an ECU learns its gate before the scenario begins.

With an ECU in this process they run in machine code with every clock, at their own pace and without observers: the
scenario's time 0 is where they end, with gate and ECU as they are then. Nothing of the scenario acts before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.diagnostics.tester import quiet
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.errors import EcuError, PreconditionError
from liftgate_hil.loop.episode import Episode, LoopStart
from liftgate_hil.signals import COLUMN_PLACE
from liftgate_hil.stimuli.moments import Instant, Sheet
from liftgate_hil.stimuli.requests import Request, requests_of

_LONG_AGO = 2**36  # ticks until the scenario's time 0, assumed while that is not known
_AGES = 2e9  # s before time 0, earlier than all of these ticks: due at once
_LOOK = 0.5  # s of standing after which a motion is over
LONGEST_MOTION = 120.0  # s
_STANDS = {  # below these limits it stands
    "gate_rate_degps": 0.02,
    "left_speed_rps": 0.02,
    "right_speed_rps": 0.02,
    "left_current_a": 0.05,
    "right_current_a": 0.05,
}


class StandstillDetector:
    """Detects the end of a requested motion: standstill for a hold time, after enough time for it to begin."""

    def __init__(self, step: float) -> None:
        self._limits = [(COLUMN_PLACE[name], limit) for name, limit in _STANDS.items()]
        self._enough = max(1, round(_LOOK / step))
        self._stood = self._seen = 0  # rows

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Update the time without motion from rows (n, ROW_WIDTH)."""
        moves = np.zeros(len(rows), dtype=np.bool_)
        for at, limit in self._limits:
            moves |= abs(rows[:, at]) > limit
        last = np.flatnonzero(moves)
        self._stood = len(rows) - 1 - int(last[-1]) if len(last) else self._stood + len(rows)
        self._seen += len(rows)

    def is_over(self) -> bool:
        """Whether the requested motion has ended, by the rows so far."""
        return self._stood >= self._enough and self._seen >= 3 * self._enough


def after_precondition(
    start: LoopStart,
    adapter: Adapter,
    actions: Sequence[str],
    stopped: Callable[[], bool] = lambda: False,
    guard: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> LoopStart:
    """Run requests of the driver, each once the last one's motion has ended; return the LoopStart after them.

    Its stimuli, which are those of `start`, begin there. The ECU runs within contexts that `guard` makes. Raises
    PreconditionError, EcuError, PlantDivergedError.
    """
    config, stimuli = start.config, start.stimuli
    look = max(1, round(_LOOK / config.step))
    sinks: list[StandstillDetector] = []
    episode = Episode(start, adapter, sinks, is_recorded=False)
    stimuli.origin[0] = start.state.tick + _LONG_AGO
    try:
        episode.begin()
        for action in actions:
            asked = requests_of([Request(Instant(-_AGES), action)], Sheet())
            episode.follow(stimuli._replace(requests=asked, tester=quiet(stimuli.tester)))
            sinks[:] = [StandstillDetector(config.step)]
            for _ in range(round(LONGEST_MOTION / _LOOK)):
                with guard():
                    episode.advance(look)
                if stopped() or sinks[0].is_over():
                    break
            else:
                raise PreconditionError(
                    f"precondition: {action}: the gate still moves, or a drive is still driven, after "
                    f"{LONGEST_MOTION:g} s; allowed: motions that end"
                )
    except EcuError as error:  # its time is not a time of the scenario
        raise EcuError(f"precondition: the ECU: {adapter.failure()}") from error
    finally:
        episode.close()
    stimuli.origin[0] = episode.state.tick
    adapter.begins_anew(episode.state.tick * config.step, episode.in_flight)
    return start._replace(state=episode.state._replace(counts=NO_COUNTS, timeouts=0))
