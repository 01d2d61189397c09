"""Slots of a cluster's worker that have no batch at the moment, each for the client whose base it has.

A slot that evaluates is its task's alone: nobody can take it or end it from outside.
"""

from __future__ import annotations

import threading
import time
from typing import NamedTuple

from liftgate_hil.campaigns.executors.slot import Slot

_IDLE_S = 60.0  # s without a batch until a slot is ended; another one starts within two
_LOOK_S = 5.0


class _Idle(NamedTuple):
    token: str  # of the client
    since: float  # s, monotonic
    slot: Slot


class IdleSlots:
    """Idle slots of this process, for any of its threads.

    One that is not taken for a minute is ended: a client that was killed has not asked for its end.
    """

    def __init__(self) -> None:
        self._idle: list[_Idle] = []
        self._lock = threading.Lock()
        self._is_watched = False

    def take(self, token: str) -> Slot | None:
        """Return the slot of a client that has been idle for the shortest time; None: there is none."""
        with self._lock:
            for place in reversed(range(len(self._idle))):
                if self._idle[place].token == token:
                    return self._idle.pop(place).slot
        return None

    def put(self, token: str, slot: Slot) -> None:
        """Keep a slot for the next batch of its client."""
        with self._lock:
            self._idle.append(_Idle(token, time.monotonic(), slot))
            if not self._is_watched:
                self._is_watched = True
                threading.Thread(target=self._watch, name="idle slots", daemon=True).start()

    def end(self, token: str) -> None:
        """End the slots of a client."""
        with self._lock:
            ended = [each for each in self._idle if each.token == token]
            self._idle = [each for each in self._idle if each.token != token]
        for each in ended:
            each.slot.close()

    def _watch(self) -> None:
        """End slots that have been idle for too long, until there are none."""
        while True:
            time.sleep(_LOOK_S)
            first = time.monotonic() - _IDLE_S
            with self._lock:
                ended = [each for each in self._idle if each.since <= first]
                self._idle = [each for each in self._idle if each.since > first]
                self._is_watched = goes_on = bool(self._idle)
            for each in ended:
                each.slot.close()
            if not goes_on:
                return
