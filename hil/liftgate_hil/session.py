"""The composition root: objects from files and values.

No flags, no printing, no signal handlers: the command line, pytest and the rest of the API are users of this file.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from liftgate_hil.codec.transmit import message_of
from liftgate_hil.config.arguments import number_of, numbers_of, seed_of, time_of, whole_of
from liftgate_hil.config.rig import Rig, load_rig
from liftgate_hil.config.rig_fit import check_fit
from liftgate_hil.config.scenario import Scenario, load_scenario, no_scenario
from liftgate_hil.config.settings import settings_of
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.toml import show
from liftgate_hil.config.variant import AS_FILED, Variant
from liftgate_hil.config.vehicle import load_vehicle
from liftgate_hil.errors import ConfigError
from liftgate_hil.loop.tick import LoopConfig, LoopState, initial_loop, no_frames
from liftgate_hil.recording.rotation import Limit
from liftgate_hil.signals import OUT
from liftgate_plant.faults import SOUND
from liftgate_plant.friction_profile import friction_profile
from liftgate_plant.initial import closed_state, initial_state
from liftgate_plant.vehicle import Vehicle, load_of, plant_of

NS = 1_000_000_000
CLOCKS = ("realtime", "free", "lockstep")
RATES = (200.0, 10_000.0)  # Hz
LEAST_LIMIT = 1_000_000  # bytes of a recording's file
AROUND, LONGEST_AROUND = 1.0, 600.0  # s that are recorded before and after a condition


def vehicle_from(
    name: str | Path,
    settings: Sequence[str] = (),
    *,
    draw: int | None = None,
    ideal: bool = False,
) -> Vehicle:
    """The vehicle of a shipped name or a path, with KEY=VALUE settings put over it. `draw`: the seed of one car of
    the file's `[spread]`; `ideal`: without errors of sensors, torsion, source resistance. Raises ConfigError.
    """
    path = find_config("vehicles", str(name))
    return load_vehicle(path, settings_of(settings), variant_of(draw, ideal))


def variant_of(draw: int | None, ideal: bool) -> Variant:
    """Which car of a vehicle file. Raises ConfigError."""
    if draw is not None:
        draw = seed_of(draw, "draw")
    return Variant(draw, bool(ideal))


def rig_from(name: str | Path) -> Rig:
    """The rig of a shipped name or a path. Raises ConfigError."""
    return load_rig(find_config("rigs", str(name)))


def scenario_from(
    name: str | Path | None, parameters: Mapping[str, float] | None = None
) -> Scenario:
    """The scenario of a shipped name or a path with its parameters replaced, or none. Raises ConfigError."""
    if name is None:
        return no_scenario()
    given = numbers_of("parameters", parameters)
    return load_scenario(find_config("scenarios", str(name)), given)


def vehicle_of(
    vehicle: str | Path | Vehicle,
    settings: Sequence[str] = (),
    variant: Variant = AS_FILED,
) -> Vehicle:
    """That variant of the vehicle of a name or a path, with settings put over it, or one that there is. Raises
    ConfigError.
    """
    if isinstance(vehicle, str | Path):
        return load_vehicle(find_config("vehicles", str(vehicle)), settings_of(settings), variant)
    if not isinstance(vehicle, Vehicle):
        raise ConfigError(f"`vehicle` {show(vehicle)}: allowed: a shipped name, a file, a Vehicle")
    if settings:
        raise ConfigError(
            f"`settings` {', '.join(settings)}: allowed with a vehicle by its name or file"
        )
    if variant != AS_FILED:
        asked = "`ideal`" if variant.is_ideal else f"`draw` {variant.draw}"
        raise ConfigError(f"{asked}: allowed with a vehicle by its name or file")
    return vehicle


def rig_of(rig: str | Path | Rig | None, scenario: Scenario | None = None) -> Rig:
    """The rig of a name or a path, or one that there is; None: the scenario's, else ours. Raises ConfigError."""
    if rig is None and scenario is not None and scenario.rig:
        return load_rig(find_config("rigs", scenario.rig, f"{scenario.source}: rig"))
    if rig is None:
        rig = "liftgate"
    if isinstance(rig, str | Path):
        return rig_from(str(rig))
    if not isinstance(rig, Rig):
        raise ConfigError(f"`rig` {show(rig)}: allowed: a shipped name, a file, a Rig")
    return rig


def scenario_of(
    scenario: str | Path | Scenario | None, parameters: Mapping[str, float] | None = None
) -> Scenario:
    """The scenario of a name or a path, with its parameters replaced, or one that there is. Raises ConfigError."""
    if isinstance(scenario, str | Path):
        return scenario_from(str(scenario), parameters)
    if scenario is not None and not isinstance(scenario, Scenario):
        raise ConfigError(
            f"`scenario` {show(scenario)}: allowed: a shipped name, a file, a Scenario, or None"
        )
    if parameters:
        raise ConfigError(
            f"`parameters` {', '.join(parameters)}: allowed with a scenario by its name or file"
        )
    return no_scenario() if scenario is None else scenario


def angle_from(initial: float | str, open_angle: float, others: str = "") -> float:
    """The angle [rad] of "closed", "open" (`open_angle`, rad) or degrees; `others` are allowed besides.

    Raises ConfigError.
    """
    named = {"closed": 0.0, "open": open_angle}
    if isinstance(initial, str) and initial in named:
        return named[initial]
    try:
        degrees = math.nan if isinstance(initial, bool) else float(initial)
    except (TypeError, ValueError, OverflowError):
        degrees = math.nan
    top = math.degrees(open_angle)
    if not 0.0 <= degrees <= top:
        raise ConfigError(
            f"`initial` {_short(initial)}: allowed: {others}closed, open, or 0 to {top:g} degrees"
        )
    return math.radians(degrees)


def _short(initial: object) -> str:
    return initial if isinstance(initial, str) and len(initial) <= 60 else show(initial)


@dataclass(frozen=True)
class Setup:
    """Which gate, where it starts, and what happens to it."""

    scenario: Scenario
    vehicle: Vehicle
    vehicle_name: str
    seed: int
    start_angle: float  # rad


def setup_of(
    scenario: str | Path | Scenario | None = None,
    *,
    parameters: Mapping[str, float] | None = None,
    vehicle: str | Path | Vehicle | None = None,
    settings: Sequence[str] = (),
    initial: float | str | None = None,
    seed: int | None = None,
    variant: Variant = AS_FILED,
) -> Setup:
    """The setup of what a caller names; what is None the scenario says, else suv, closed, seed 0.

    `settings` come after the scenario's, and both after the variant. Raises ConfigError.
    """
    scenario = scenario_of(scenario, parameters)
    called = ""
    if vehicle is None:
        vehicle = scenario.vehicle or "suv"
        called = f"{scenario.source}: vehicle" if scenario.vehicle else ""
    is_named = isinstance(vehicle, str | Path)
    if scenario.settings and not is_named:
        raise ConfigError(
            f"{', '.join(each.source + each.key for each in scenario.settings)}: allowed with a vehicle "
            "by its name or file"
        )
    built = (
        load_vehicle(
            find_config("vehicles", str(vehicle), called),
            [*scenario.settings, *settings_of(settings)],
            variant,
        )
        if is_named
        else vehicle_of(vehicle, settings, variant)
    )
    initial = initial if initial is not None else scenario.initial
    return Setup(
        scenario=scenario,
        vehicle=built,
        vehicle_name=str(vehicle) if is_named else "a vehicle",
        seed=seed_of(seed if seed is not None else scenario.seed),
        start_angle=angle_from(initial, built.gate.open_angle),
    )


def loop_config_of(vehicle: Vehicle, rig: Rig, rate: float, seed: int) -> LoopConfig:
    """The loop's constants, at a rate [Hz]. Raises ConfigError where the rig does not fit vehicle or rate."""
    check_fit(rig, vehicle, rate)
    mapped = {mapping.quantity for mapping in rig.inputs}
    outputs = rig.output_config()
    plant = plant_of(vehicle)
    return LoopConfig(
        plant=plant,
        sensors=vehicle.sensors,
        friction=friction_profile(vehicle, plant, seed),
        load=load_of(vehicle),
        faults=SOUND,
        inputs=rig.input_config(),
        outputs=outputs,
        signed_left=int("left_direction" not in mapped),
        signed_right=int("right_direction" not in mapped),
        latch_mapped=int("latch_release" in mapped),
        hold_message=message_of(outputs, OUT.pinch_force_max),
        obstacle_distance=vehicle.gate.length,
        step=1.0 / rate,
        step_ns=round(NS / rate),
        seed=seed,
        nothing=no_frames(),
    )


def start_of(config: LoopConfig, angle: float = 0.0) -> LoopState:
    """A loop whose gate rests at an angle [rad]; closed it is latched."""
    if angle == 0.0:
        return initial_loop(config, closed_state(config.plant, config.load))
    return initial_loop(config, initial_state(config.plant, angle))


def ticks_of(duration: float | None, rate: float) -> int | None:
    """How many ticks a duration [s] is, at least one; None: until stopped."""
    return None if duration is None else max(1, math.ceil(duration * rate - 1e-9))


@dataclass(frozen=True)
class RunOptions:
    """How a run goes, whatever runs."""

    rate: float = 1000.0  # Hz
    clock: str = "realtime"  # of CLOCKS
    duration: float | None = None  # s of model time; None: the scenario's, else until stopped
    overrun_limit: float = 1.0  # s that the loop may fall behind
    wall_timeout: float | None = None  # s that lockstep waits for a command; None: for ever
    records: tuple[Path, ...] = ()
    record_limit: int | None = None  # bytes of a recording's file; None: any
    record_keep: int | None = None  # files of a recording that stay, the last ones; None: all
    record_when: tuple[str, ...] = ()  # conditions: record only around them; none: record all
    record_before: float | None = None  # s before one of them is true; None: AROUND
    record_after: float | None = None  # s after it
    realtime: bool = False  # ask for FIFO scheduling, locked memory, a CPU
    cpu: int | None = None  # which

    def limit(self) -> Limit | None:
        """Of a recording's files."""
        size = self.record_limit
        return None if size is None else Limit(size, self.record_keep)

    def around(self) -> tuple[float, float]:
        """What is recorded before and after a condition [s], where only that is."""
        before, after = self.record_before, self.record_after
        return AROUND if before is None else before, AROUND if after is None else after

    def _check_trigger(self) -> None:
        if self.record_when and not self.records:
            raise ConfigError(
                f"`record_when` {', '.join(self.record_when)}: allowed: together with `record`"
            )
        for name in ("record_before", "record_after"):
            if (value := getattr(self, name)) is not None:
                number_of(name, value, 0.0, LONGEST_AROUND, "s")
                if not self.record_when:
                    raise ConfigError(f"`{name}` {value:g}: allowed: together with `record_when`")

    def check(self) -> None:
        """Raises ConfigError where one cannot be, or they cannot be had together."""
        number_of("rate", self.rate, *RATES, "Hz")
        for name in ("duration", "wall_timeout", "overrun_limit"):
            if (value := getattr(self, name)) is not None:
                time_of(name, value)
        for name, least in (("record_limit", LEAST_LIMIT), ("record_keep", 2)):
            if (value := getattr(self, name)) is not None:
                whole_of(name, value, least)
        if self.record_limit is not None and not self.records:
            raise ConfigError(
                f"`record_limit` {self.record_limit}: allowed: together with `record`"
            )
        if self.record_keep is not None and self.record_limit is None:
            raise ConfigError(
                f"`record_keep` {self.record_keep}: allowed: together with `record_limit`"
            )
        self._check_trigger()
        if len({os.path.realpath(path) for path in self.records}) < len(self.records):
            names = ", ".join(str(path) for path in self.records)
            raise ConfigError(f"`record` {names}: allowed: a file once")
        if self.cpu is None:
            return
        if not self.realtime:
            raise ConfigError(f"`cpu` {self.cpu}: allowed: together with `realtime`")
        if hasattr(os, "sched_getaffinity") and self.cpu not in os.sched_getaffinity(0):
            from liftgate_hil.loop.priority import allowed_cpus

            raise ConfigError(f"`cpu` {self.cpu}: allowed here: {allowed_cpus()}")
