"""Initial loop of a run, before its first tick: its constants, and its state at rest."""

from __future__ import annotations

from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.codec.transmit import message_of
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.rig_fit import check_fit
from liftgate_hil.loop.episode import LoopStart
from liftgate_hil.loop.tick import LoopConfig, LoopState, initial_loop
from liftgate_hil.plan.request import NS
from liftgate_hil.plan.setup import Setup
from liftgate_hil.plan.stimulation import planned_stimuli
from liftgate_hil.signals import OUT
from liftgate_hil.stimuli.command_queue import CLOSED, Opening
from liftgate_plant.faults import SOUND
from liftgate_plant.friction_profile import friction_profile
from liftgate_plant.initial import closed_state, initial_state
from liftgate_plant.vehicle import Vehicle, load_of, plant_of

_EDGES = 64  # of the ring of Hall edges


def loop_config_of(vehicle: Vehicle, rig: Rig, rate: float, seed: int) -> LoopConfig:
    """Return the constants of a loop at a rate [Hz]. Raises ConfigError where the rig does not fit."""
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
        nothing=empty_frames(0),
    )


def loop_start_of(
    setup: Setup, rig: Rig, rate: float, opening: Opening = CLOSED, edges: int = _EDGES
) -> LoopStart:
    """Return a loop at rest with a setup's stimuli, for an ECU in this process. Raises ConfigError."""
    config = loop_config_of(setup.vehicle, rig, rate, setup.seed)
    state = start_of(config, setup.start_angle, edges)
    return LoopStart(config, state, planned_stimuli(setup, rig, opening=opening))


def start_of(config: LoopConfig, angle: float = 0.0, edges: int = _EDGES) -> LoopState:
    """Return a loop's state with room for `edges` Hall edges; its gate rests at `angle` [rad], latched at 0."""
    is_closed = angle == 0.0
    state = closed_state(config.plant, config.load) if is_closed else initial_state(config.plant, angle)
    return initial_loop(config, state, edges)
