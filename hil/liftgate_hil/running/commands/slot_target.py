"""Target of orders for a running loop: they go through the slots of its stimulus plan, from any thread."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario_tables import Fault
from liftgate_hil.errors import ConfigError
from liftgate_hil.running.commands.target import Target
from liftgate_hil.running.setup import Setup
from liftgate_hil.running.stimulation import injections_of
from liftgate_hil.stimuli.faults import Injection
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.restbus import LAYERS
from liftgate_hil.stimuli.slots import SLOTS, has_room, post_fault, post_reset, post_signal
from liftgate_hil.stimuli.stimulus_plan import OFF_A_REAL_BUS, StimulusPlan
from liftgate_plant.constants import constants_of, numbers_of


class SlotTarget:
    """Executes the orders of all layers on a running loop, see `layer`.

    `signals` are those that the stimuli are open to (`Opening`); `is_real`: the bus is not a virtual one;
    `restart` runs the rig's program that resets the ECU, where the rig has one.
    """

    def __init__(
        self,
        stimuli: StimulusPlan,
        setup: Setup,
        rig: Rig,
        signals: Sequence[str],
        is_real: bool,
        restart: Callable[[], None] | None = None,
    ) -> None:
        self._slots, self._tester, self._not_made = stimuli.slots, stimuli.tester, stimuli.not_made
        self._is_real = is_real
        self._setup, self._rig, self._restart = setup, rig, restart
        self._signals = {name: place for place, name in enumerate(signals)}
        names = (*signals, *(each.signal for each in setup.scenario.signals))
        self._restbus = {name.partition(".")[0] for name in names}
        self._places = {
            name: place for place, name in enumerate(numbers_of(constants_of(setup.vehicle)))
        }
        self._faults: list[tuple[Fault, ...]] = [()] * LAYERS
        self._taken: dict[_Key, tuple[int, Injection]] = {}

    def layer(self, place: int) -> Target:
        """Return the target for orders in a layer, BENCH or OPERATOR; later layers override those before."""
        return _Layer(self, place)

    def inject(self, layer: int, faults: Sequence[Fault]) -> None:
        """Set the faults of a layer from the next tick on. Raises ConfigError, and changes nothing then."""
        before = self._faults
        self._faults = [*before[:layer], tuple(faults), *before[layer + 1 :]]
        try:
            self._inject()
        except ConfigError:
            self._faults = before
            raise

    def _inject(self) -> None:
        layers = [layer for layer, own in enumerate(self._faults) for _ in own]
        faults = [each for own in self._faults for each in own]
        if len(faults) > SLOTS:
            raise ConfigError(f"{len(faults)} faults; allowed: up to {SLOTS} at a time")
        vehicle, beside = self._setup.vehicle, self._setup.scenario.faults
        made = injections_of(faults, vehicle, self._rig, self._restbus, beside)
        wanted = dict(zip(map(_key_of, layers, faults), made, strict=True))
        ended = [key for key in self._taken if key not in wanted]
        changed = [key for key, each in wanted.items() if self._now(key) != each]
        self._check_room(len(ended) + len(changed))
        if self._is_real and any(each.kind == "bus_off" for each in faults):
            self._not_made[OFF_A_REAL_BUS] = 1
        for key in ended:
            post_fault(self._slots, self._taken.pop(key)[0], None, self._places, key.layer)
        for key in changed:
            slot = self._taken[key][0] if key in self._taken else self._free_slot()
            self._taken[key] = slot, wanted[key]
            post_fault(self._slots, slot, wanted[key], self._places, key.layer)

    def _free_slot(self) -> int:
        taken = {slot for slot, _ in self._taken.values()}
        return next(slot for slot in range(SLOTS) if slot not in taken)

    def _now(self, key: _Key) -> Injection | None:
        return self._taken[key][1] if key in self._taken else None

    def set_signals(
        self, layer: int, values: Mapping[str, float], instead_of: float, rest: float
    ) -> None:
        """Set signals in a layer, as `Target.set_signals`. Raises ConfigError, and changes nothing then."""
        unknown = [name for name in values if name not in self._signals]
        if unknown:
            said = "not sent on this run's bus; allowed: in a message that fits its frames"
            raise ConfigError(f"signal {', '.join(unknown)}: {said}")
        self._check_room(len(values))
        for name, value in values.items():
            post_signal(self._slots, self._signals[name], value, instead_of, rest, layer)

    def reset(self) -> None:
        """Reset the ECU by the rig's program or the tester's ECUReset. Raises ConfigError where it has neither."""
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


class _Layer:
    """Target for orders in one layer."""

    def __init__(self, target: SlotTarget, place: int) -> None:
        self._target, self._place = target, place

    def inject(self, faults: Sequence[Fault]) -> None:
        """Set the faults of this layer from the next tick on. Raises ConfigError, and changes nothing then."""
        self._target.inject(self._place, faults)

    def set_signals(
        self, values: Mapping[str, float], instead_of: float = math.nan, rest: float = math.nan
    ) -> None:
        """Set signals in this layer. Raises ConfigError, and changes nothing then."""
        self._target.set_signals(self._place, values, instead_of, rest)

    def reset(self) -> None:
        """Reset the ECU. Raises ConfigError where that is not possible."""
        self._target.reset()


class _Key(NamedTuple):
    """Key of an injected fault: its layer, identity and start."""

    layer: int
    identity: tuple[Any, ...]
    start: Instant


def _key_of(layer: int, fault: Fault) -> _Key:
    return _Key(layer, fault.identity, fault.start)
