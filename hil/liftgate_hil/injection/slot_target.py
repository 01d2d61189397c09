"""Orders for a loop that runs: through the slots of the scene that it carries along, whichever thread it is in."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Fault
from liftgate_hil.errors import ConfigError
from liftgate_hil.session import Setup
from liftgate_hil.staging import injections_of
from liftgate_hil.stimuli.faults import Injection
from liftgate_hil.stimuli.scene import Scene
from liftgate_hil.stimuli.slots import SLOTS, has_room, post_fault, post_reset, post_signal
from liftgate_plant.constants import constants_of, numbers_of


class SlotTarget:
    """See Target. `restart` runs the rig's program that restarts the ECU, where that is how it is done."""

    def __init__(
        self, scene: Scene, setup: Setup, rig: Rig, restart: Callable[[], None] | None = None
    ) -> None:
        self._slots, self._tester = scene.slots, scene.tester
        self._setup, self._rig, self._restart = setup, rig, restart
        names = (*rig.settable, *(each.signal for each in setup.scenario.signals))
        self._restbus = {name.partition(".")[0] for name in names}
        self._places = {
            name: place for place, name in enumerate(numbers_of(constants_of(setup.vehicle)))
        }
        self._taken: dict[tuple[Any, ...], tuple[int, Injection]] = {}

    def inject(self, faults: Sequence[Fault]) -> None:
        """See Target."""
        if len(faults) > SLOTS:
            raise ConfigError(f"{len(faults)} faults; allowed: up to {SLOTS} at a time")
        vehicle, beside = self._setup.vehicle, self._setup.scenario.faults
        made = injections_of(faults, vehicle, self._rig, self._restbus, beside)
        wanted = dict(zip(map(_key_of, faults), made, strict=True))
        ended = [key for key in self._taken if key not in wanted]
        changed = [key for key, each in wanted.items() if self._now(key) != each]
        self._check_room(len(ended) + len(changed))
        for key in ended:
            post_fault(self._slots, self._taken.pop(key)[0], None, self._places)
        for key in changed:
            taken = {slot for slot, _ in self._taken.values()}
            free = next(slot for slot in range(SLOTS) if slot not in taken)
            slot = self._taken[key][0] if key in self._taken else free
            self._taken[key] = slot, wanted[key]
            post_fault(self._slots, slot, wanted[key], self._places)

    def _now(self, key: tuple[Any, ...]) -> Injection | None:
        return self._taken[key][1] if key in self._taken else None

    def set_signal(self, name: str, value: float, instead_of: float = math.nan) -> None:
        """See Target."""
        self._check_room(1)
        post_signal(self._slots, self._rig.settable.index(name), value, instead_of)

    def reset(self) -> None:
        """See Target."""
        if self._restart is not None:
            self._restart()
        elif self._tester.head[0].takes_resets:
            self._check_room(1)
            post_reset(self._slots)
        else:
            raise ConfigError("request reset; allowed with an ECU on a bus (`ecu` bus)")

    def _check_room(self, letters: int) -> None:
        if not has_room(self._slots, letters):
            raise ConfigError("the loop has not taken the last orders yet; allowed: fewer at once")


def _key_of(fault: Fault) -> tuple[Any, ...]:
    own = fault.values
    return fault.kind, fault.where, own.get("key"), own.get("direction"), own.get("id"), fault.start
