"""The composition root: objects from files and flags. Nobody else reads files."""

from __future__ import annotations

from collections.abc import Sequence

from liftgate_hil.config.rig import Rig, load_rig
from liftgate_hil.config.scenario import Scenario, load_scenario, no_scenario
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.vehicle import load_vehicle
from liftgate_hil.loop.tick import LoopConfig
from liftgate_hil.stimuli.timeline import Timeline
from liftgate_plant.vehicle import Vehicle, load_of, plant_of

NS = 1_000_000_000


def vehicle_from(name: str, settings: Sequence[str] = ()) -> Vehicle:
    """The vehicle of a `--vehicle` value."""
    return load_vehicle(find_config("vehicles", name), settings)


def rig_from(name: str) -> Rig:
    """The rig of a `--rig` value."""
    return load_rig(find_config("rigs", name))


def scenario_from(name: str | None) -> Scenario:
    """The scenario of a `--scenario` value, or none."""
    return no_scenario() if name is None else load_scenario(find_config("scenarios", name))


def bench_of(vehicle: Vehicle, rig: Rig, timeline: Timeline, rate: float, seed: int) -> LoopConfig:
    """The loop's constants."""
    mapped = {wire.quantity for wire in rig.inputs}
    return LoopConfig(
        plant=plant_of(vehicle),
        sensors=vehicle.sensors,
        load=load_of(vehicle),
        timeline=timeline,
        inputs=rig.input_config(),
        outputs=rig.output_config(),
        signed_left=int("left_direction" not in mapped),
        signed_right=int("right_direction" not in mapped),
        latch_mapped=int("latch_release" in mapped),
        obstacle_distance=vehicle.gate.length,
        step=1.0 / rate,
        step_ns=round(NS / rate),
        seed=seed,
    )
