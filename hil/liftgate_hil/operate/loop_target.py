"""Target of commands for a running loop, which posts them to the command queue of the loop's stimulus plan."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario_tables import Fault
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.setup import Setup
from liftgate_hil.plan.stimulation import injections_of
from liftgate_hil.stimuli.command_queue import SLOTS, has_room, post_fault, post_reset, post_signal, post_values
from liftgate_hil.stimuli.faults import Injection
from liftgate_hil.stimuli.restbus import LAYERS
from liftgate_hil.stimuli.stimulus_plan import OFF_A_REAL_BUS, StimulusPlan
from liftgate_plant.constants import constants_of, numbers_of


class _Slot(NamedTuple):
    """Fault in one slot of the stimulus plan, with its layer."""

    layer: int
    fault: Fault
    injection: Injection


class LoopTarget:
    """Executes the commands of all layers on a running loop, see `layer`.

    `signals` are those that the stimuli are open to (`Opening`); `is_real`: the bus is not a virtual one;
    `restart` resets the ECU in place of the tester; `make_room` is called where the queue is full, and can empty
    it where the loop does not run beside the caller.
    """

    def __init__(
        self,
        stimuli: StimulusPlan,
        setup: Setup,
        rig: Rig,
        signals: Sequence[str],
        is_real: bool = False,
        restart: Callable[[], None] | None = None,
        make_room: Callable[[], None] = lambda: None,
    ) -> None:
        self._queue, self._tester, self._not_made = stimuli.queue, stimuli.tester, stimuli.not_made
        self._setup, self._rig, self._is_real = setup, rig, is_real
        self._restart, self._make_room = restart, make_room
        self._signals = {name: place for place, name in enumerate(signals)}
        names = (*signals, *(each.signal for each in setup.scenario.signals))
        self._restbus = {name.partition(".")[0] for name in names}
        self._places = {name: place for place, name in enumerate(numbers_of(constants_of(setup.vehicle)))}
        self._faults: list[tuple[Fault, ...]] = [()] * LAYERS
        self._slots: list[_Slot | None] = [None] * SLOTS

    def layer(self, place: int) -> Target:
        """Return the command target of a layer, BENCH or OPERATOR; later layers override earlier ones."""
        return Target(self, place)

    def hold(self, values: Mapping[str, float]) -> None:
        """Hold values, as `Target.hold`. Raises ConfigError, and changes nothing then."""
        self._check_room(len(values))
        post_values(self._queue, values)

    def inject(self, layer: int, faults: Sequence[Fault]) -> None:
        """Set the faults of a layer, as `Target.inject`. Raises ConfigError, and changes nothing then."""
        layers = [*self._faults[:layer], tuple(faults), *self._faults[layer + 1 :]]
        wanted = [(place, fault) for place, own in enumerate(layers) for fault in own]
        if len(wanted) > SLOTS:
            raise ConfigError(f"{len(wanted)} faults; allowed: up to {SLOTS} at a time")
        every = [fault for _, fault in wanted]
        vehicle, beside = self._setup.vehicle, self._setup.scenario.faults
        made = injections_of(every, vehicle, self._rig, self._restbus, beside)
        taken = {id(each.fault): slot for slot, each in enumerate(self._slots) if each is not None}
        ended = [slot for own, slot in taken.items() if own not in map(id, every)]
        free = iter([s for s, each in enumerate(self._slots) if each is None or s in ended])
        begun: list[tuple[int, _Slot]] = []
        for (place, fault), injection in zip(wanted, made, strict=True):
            # The injection of a fault that goes on changes where it acts on the same constants as another one.
            slot = taken.get(id(fault))
            before = None if slot is None else self._slots[slot]
            if before is None or before.injection != injection:
                begun.append((next(free) if slot is None else slot, _Slot(place, fault, injection)))
        self._check_room(len(ended) + len(begun))
        if self._is_real and any(each.kind == "bus_off" for each in every):
            self._not_made[OFF_A_REAL_BUS] = 1
        self._faults = layers
        for slot in ended:
            post_fault(self._queue, slot, None, self._places, layer)
            self._slots[slot] = None
        for slot, own in begun:
            post_fault(self._queue, slot, own.injection, self._places, own.layer)
            self._slots[slot] = own

    def set_signals(
        self, layer: int, values: Mapping[str, float], instead_of: float = math.nan, rest: float = math.nan
    ) -> None:
        """Set signals in a layer, as `Target.set_signals`. Raises ConfigError, and changes nothing then."""
        unknown = [name for name in values if name not in self._signals]
        if unknown:
            text = "not sent on this run's bus; allowed: a signal in a message that fits its frames"
            raise ConfigError(f"signal {', '.join(unknown)}: {text}")
        self._check_room(len(values))
        for name, value in values.items():
            post_signal(self._queue, self._signals[name], value, instead_of, rest, layer)

    def reset(self) -> None:
        """Reset the ECU by `restart` or the tester's ECUReset. Raises ConfigError where there is neither."""
        if self._restart is not None:
            self._restart()
        elif self._tester.head[0].takes_resets:
            self._check_room(1)
            post_reset(self._queue)
        else:
            raise ConfigError("request reset; allowed with an ECU on a bus (`ecu` bus)")

    def _check_room(self, commands: int) -> None:
        if not has_room(self._queue, commands):
            self._make_room()
        if not has_room(self._queue, commands):
            raise ConfigError("the loop has not processed the last commands yet; allowed: fewer at once")


class Target:
    """Target for the commands of one layer, on a running loop or a gate."""

    def __init__(self, loop: LoopTarget, place: int) -> None:
        self._loop, self._place = loop, place

    def hold(self, values: Mapping[str, float]) -> None:
        """Hold values, by their names in command_queue.NAMES, from the next tick on; NaN releases a value.

        Raises ConfigError where there is no room for so many, and changes nothing then.
        """
        self._loop.hold(values)

    def inject(self, faults: Sequence[Fault]) -> None:
        """Put these faults in force from the next tick on, in place of all that this layer injected before.

        Where several act on the same thing, they act in their order. Raises ConfigError, and changes nothing then.
        """
        self._loop.inject(self._place, faults)

    def set_signals(
        self, values: Mapping[str, float], instead_of: float = math.nan, rest: float = math.nan
    ) -> None:
        """Set signals [the database's unit]; with `instead_of` (NaN: any) only those that have this value.

        The value NaN clears a signal, which then has the scenario's value, else `rest`. Raises ConfigError, and
        changes nothing then.
        """
        self._loop.set_signals(self._place, values, instead_of, rest)

    def reset(self) -> None:
        """Reset the ECU in the rig's way other than a signal. Raises ConfigError where the rig has none."""
        self._loop.reset()
