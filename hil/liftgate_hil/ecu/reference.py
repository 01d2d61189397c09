"""The reference ECU: receives the gate's frames, runs the controller, and sends the command by the rig.

`step` is called with the frames that have come since the last call. It controls as often as the currents come, and
sends its command in that message's cycle, and at once when it stops or reverses. It runs as plain Python, and
compiled as part of the episode.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable
from liftgate_hil.codec.frames import Frames, empty_frames
from liftgate_hil.codec.receive import NO_COUNTS, Counts, Reception, nothing_received, receive
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.codec.transmit import encode
from liftgate_hil.config.rig import COMMANDS, Rig
from liftgate_hil.config.signal_mapping import missing_values
from liftgate_hil.diagnostics.isotp import MOST_SPOKEN
from liftgate_hil.ecu.buttons import Buttons, ButtonState, buttons_of, nothing_pressed, pressed_in
from liftgate_hil.ecu.calibration import CALIBRATED, Calibration
from liftgate_hil.ecu.controller import COASTING, DriveCommand, Feedback, lose_feedback, update
from liftgate_hil.ecu.diagnostics import DiagnosticServer, ServerState, has_work, new_server, serve, server_of
from liftgate_hil.ecu.events import note_statuses
from liftgate_hil.ecu.memory import NO_REQUEST, EcuConstants, EcuMemory, constants_of, new_memory, note_course
from liftgate_hil.ecu.states import is_moving
from liftgate_hil.ecu.wire import next_time
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.signals import IN, OUT, OUTPUT_COUNT
from liftgate_plant.signals import SIDES

_COAST, _OPEN, _CLOSE, _BRAKE = 0.0, 1.0, 2.0, 3.0
_NOMINAL_V = 12.0  # used where the bus does not carry the terminal voltage


class EcuConfig(NamedTuple):
    """Constants of the reference ECU."""

    constants: EcuConstants
    drives: int
    inputs: BusConfig  # what it receives: the rig's outputs
    outputs: BusConfig  # what it sends: the rig's inputs
    buttons: Buttons
    commands: NDArray[np.int64]  # rows of `outputs` that the ECU sends
    pages: int  # pages of the command message that has the most
    needed: NDArray[np.int64]  # rows of `inputs` without which nothing moves
    patience_ns: NDArray[np.int64]  # time after which each of these is stale
    drives_rows: NDArray[np.int64]  # (2,) rows of `inputs` with the drives' currents
    speed_rows: NDArray[np.int64]  # (2,) rows with their speeds; the currents' where the cycle differs, or without
    has_latch: int  # 0: the angle shows when the gate is closed
    has_angle: int  # 0: the bus carries no angle
    signed: int  # 1: the duty's sign is the direction
    cycle_ns: int  # control cycle
    command_ns: int  # cycle of the command message
    server: DiagnosticServer
    nothing: Frames  # no frames


class EcuState(NamedTuple):
    """State of the reference ECU; its arrays are written in place."""

    reception: Reception
    buttons: ButtonState
    counts: Counts
    memory: EcuMemory
    server: ServerState
    frames: Frames  # frames sent in this cycle


def ecu_config(rig: Rig, drives: int, calibration: Calibration = CALIBRATED) -> EcuConfig:
    """Return the constants of the reference ECU for a rig."""
    inputs = rig.output_config(sending=False)
    needed, (current_rows, speed_rows) = _needed(rig, drives), _sampled_rows(rig)
    sent = {mapping.quantity for mapping in rig.outputs}
    timeout_ns = round(calibration.feedback_timeout * 1e9)
    outputs, commands = rig.input_config(), message_rows(rig, (*COMMANDS, "latch_release"))
    command_ms, current_ms = rig.command_cycle_ms(), rig.current_cycle_ms()
    cycle_ms = current_ms if 0.0 < current_ms < command_ms else command_ms
    return EcuConfig(
        constants=constants_of(calibration, cycle_ms * 1e-3),
        drives=drives,
        inputs=inputs,
        outputs=outputs,
        buttons=buttons_of(rig),
        commands=np.array(commands, dtype=np.int64),
        pages=max((int(outputs.messages[each].pages) for each in commands), default=1),
        needed=np.array(needed, dtype=np.int64),
        patience_ns=np.array(
            [max(timeout_ns, int(inputs.messages[row].timeout_ns)) for row in needed], dtype=np.int64
        ),
        drives_rows=np.array(current_rows, dtype=np.int64),
        speed_rows=np.array(speed_rows, dtype=np.int64),
        has_latch=int("latch_state" in sent),
        has_angle=int("gate_angle" in sent),
        signed=int("left_direction" not in {mapping.quantity for mapping in rig.inputs}),
        cycle_ns=round(cycle_ms * 1e6),
        command_ns=round(command_ms * 1e6),
        server=server_of(rig.diagnostics),
        nothing=empty_frames(0),
    )


def new_ecu(config: EcuConfig, shares_clock: bool = True) -> EcuState:
    """Return the state of a reference ECU that has just been switched on; see `memory.new_memory`."""
    return EcuState(
        reception=nothing_received(config.inputs, OUTPUT_COUNT),
        buttons=nothing_pressed(config.buttons),
        counts=NO_COUNTS,
        memory=new_memory(config.drives, shares_clock),
        server=new_server(config.server),
        frames=empty_frames(len(config.commands) * config.pages + MOST_SPOKEN),
    )


def check_rig(rig: Rig, drives: int) -> None:
    """Raise ConfigError if the reference ECU cannot control a gate of `drives` drives through a rig."""
    issues = ConfigIssues(rig.source)
    for quantity in lacking_feedback(rig, drives):
        issues.add(
            f"outputs.{quantity}",
            f"missing, and the reference ECU does not move without it; allowed: the signal with the "
            f"{quantity.partition('_')[0]} drive's feedback, or another `ecu`",
        )
    commands = {name for name in COMMANDS if name.startswith(SIDES[:drives])} | {"latch_release"}
    for mapping in rig.inputs:
        missing = missing_values(mapping)
        if missing and mapping.quantity in commands:
            issues.add(
                f"inputs.{mapping.quantity}.values",
                f"{', '.join(missing)} missing, and the reference ECU sends it; allowed: a value for each, or "
                "another `ecu`",
            )
    issues.raise_if_any()


def lacking_feedback(rig: Rig, drives: int) -> list[str]:
    """Return the quantities that the reference ECU needs for `drives` drives, but a rig does not send."""
    sent = {mapping.quantity for mapping in rig.outputs}
    return [quantity for quantity in _feedback(drives) if quantity not in sent]


def _feedback(drives: int) -> list[str]:
    return [f"{side}_{name}" for side in SIDES[:drives] for name in ("current", "hall_count")]


def _needed(rig: Rig, drives: int) -> list[int]:
    """Return the rows of the cyclic messages with the drives' feedback, or with the signal of a closed gate."""
    names = list(dict.fromkeys(mapping.message for mapping in rig.outputs))
    wanted = {*_feedback(drives), "latch_state", "gate_angle"}
    carrying = {each.message for each in rig.outputs if each.quantity in wanted}
    return [row for row, name in enumerate(names) if name in carrying and rig.cycle_ms(name) > 0.0]


def _sampled_rows(rig: Rig) -> tuple[list[int], list[int]]:
    """Return the table rows of the messages with the drives' currents, and of the messages with their speeds.

    Without a right drive they are the left one's. Where a speed is not sampled together with the current, its row
    is that of the current.
    """
    names = list(dict.fromkeys(mapping.message for mapping in rig.outputs))
    of = {mapping.quantity: names.index(mapping.message) for mapping in rig.outputs}
    left = of.get("left_current", 0)
    currents = [left, of.get("right_current", left)]
    speeds = [of.get(f"{side}_period_speed", row) for side, row in zip(SIDES, currents, strict=True)]
    return currents, [
        speed if rig.cycle_ms(names[speed]) == rig.cycle_ms(names[row]) else row
        for speed, row in zip(speeds, currents, strict=True)
    ]


def message_rows(rig: Rig, quantities: Collection[str]) -> list[int]:
    """Return the table rows of the input messages that carry any of these quantities; no bench messages."""
    names = list(dict.fromkeys(mapping.message for mapping in rig.inputs))
    own = {each.message for each in rig.inputs if each.quantity in quantities}
    return [row for row, name in enumerate(names) if name in own]


@compilable
def sample_time(config: EcuConfig, reception: Reception, drive: int) -> float:
    """Return the time [s] at which a drive's feedback was sampled, by the count of its message's cycles.

    That is the cycles of its message so far or, where it is not cyclic, the time of its arrival. Where current and
    speed come in two messages, a sample is complete with the later one, for which it waits up to one cycle: an
    earlier speed with the present current gives no valid load.
    """
    row = config.drives_rows[drive]
    cycle_ns = config.inputs.messages[row].cycle_ns
    if cycle_ns > 0:
        current, speed = reception.cycles[row], reception.cycles[config.speed_rows[drive]]
        return float(max(min(current, speed), current - 1) * cycle_ns * 1e-9)
    return float(reception.seen_ns[row] * 1e-9)


@compilable
def feedback_of(config: EcuConfig, reception: Reception) -> tuple[bool, Feedback]:
    """Return whether all needed messages have been received, and the drives' feedback."""
    values = reception.values
    left, right = values[OUT.left_current], values[OUT.right_current]
    left_count, right_count = values[OUT.left_hall_count], values[OUT.right_hall_count]
    # Without a latch switch on the bus the angle shows when the gate is closed; without either it never is.
    latched = values[OUT.latch_state]
    if config.has_latch == 0:
        angle = values[OUT.gate_angle]
        latched = 1.0 if angle <= 0.0 else 0.0
        if config.has_angle and np.isnan(angle):
            latched = np.nan
    voltage = values[OUT.terminal_voltage]
    heard = not (np.isnan(left) or np.isnan(left_count) or np.isnan(latched))
    if config.drives > 1:
        heard = heard and not (np.isnan(right) or np.isnan(right_count))
    return heard, Feedback(
        left_current=left,
        right_current=right,
        left_count=left_count,
        right_count=right_count,
        left_turning=values[OUT.left_period_speed],
        right_turning=values[OUT.right_period_speed],
        latched=latched > 0.5,
        caught=latched > 0.5 or values[OUT.latch_half] > 0.5,
        voltage=_NOMINAL_V if np.isnan(voltage) else float(voltage),
        temperature=hotter_of(values[OUT.left_motor_temperature], values[OUT.right_motor_temperature]),
        left_time=sample_time(config, reception, 0),
        right_time=sample_time(config, reception, 1),
    )


@compilable
def hotter_of(left: float, right: float) -> float:
    """Return the larger of two temperatures, each NaN if unknown; NaN if both are."""
    if np.isnan(left) or right > left:
        return right
    return left


@compilable
def is_stale(config: EcuConfig, seen_ns: NDArray[np.int64], now_ns: int) -> bool:
    """Whether a needed message has not been received for too long."""
    stale = False
    for i in range(len(config.needed)):
        stale = stale or now_ns - seen_ns[config.needed[i]] > config.patience_ns[i]
    return stale


@compilable
def direction_of(duty: float) -> float:
    """Return the bridge state for a signed duty; NaN: coast, 0: brake."""
    if np.isnan(duty):
        return _COAST
    if duty == 0.0:
        return _BRAKE
    return _OPEN if duty > 0.0 else _CLOSE


@compilable
def percent_of(duty: float, signed: int) -> float:
    """Return a duty [%] as the bus carries it: without its sign unless `signed`; 0 for NaN, which coasts."""
    if np.isnan(duty):
        return 0.0
    return 100.0 * duty if signed else abs(100.0 * duty)


@compilable
def set_command(config: EcuConfig, memory: EcuMemory, command: DriveCommand) -> None:
    """Set the signal values of the command that is encoded next."""
    values = memory.command
    values[IN.left_duty] = percent_of(command.left_duty, config.signed)
    values[IN.left_direction] = direction_of(command.left_duty)
    if config.drives > 1:
        values[IN.right_duty] = percent_of(command.right_duty, config.signed)
        values[IN.right_direction] = direction_of(command.right_duty)
    values[IN.latch_release] = 1.0 if command.latch_release else 0.0


@compilable
def command_frames(config: EcuConfig, state: EcuState, everything: bool) -> Frames:
    """Return the frames that carry the set command; they are valid until the next call.

    For a multiplexed message that is the next page or, with `everything`, all pages.
    """
    values, frames, control = state.memory.command, state.frames, state.memory.control[0]
    count = 0
    for _ in range(config.pages if everything else 1):
        for message in config.commands:
            encode(config.outputs, message, values, control.sent, frames, count)
            count += 1
        control.sent += 1
    return Frames(count, frames.identifiers, frames.lengths, frames.data)


@compilable
def step(config: EcuConfig, state: EcuState, frames: Frames, now_ns: int) -> tuple[EcuState, Frames]:
    """Process the frames received by a time [ns]; return the ECU's state and the frames to send.

    These are a command where one is due, and the response to a diagnostic tester.
    """
    counts = receive(config.inputs, state.reception, state.counts, frames, now_ns)
    after = EcuState(state.reception, state.buttons, counts, state.memory, state.server, state.frames)
    control = state.memory.control[0]
    asked = pressed_in(config.buttons, state.buttons, frames, now_ns)
    if asked != NO_REQUEST:
        control.request = asked
    sent = controlled(config, after, now_ns)
    if control.noted != control.events:
        note_statuses(state.memory)
    if config.server.is_on == 0 or not has_work(state.server, frames):
        return after, sent
    room, statuses = state.frames, state.memory.statuses
    count = serve(config.server, state.server, statuses, frames, room, sent.count, now_ns)
    return after, Frames(count, room.identifiers, room.lengths, room.data)


@compilable
def controlled(config: EcuConfig, state: EcuState, now_ns: int) -> Frames:
    """Run the control cycle if it is due at a time [ns]; return the command frames if they are due."""
    control = state.memory.control[0]
    if now_ns < control.next_ns:
        return config.nothing
    control.next_ns = next_time(control.next_ns, config.cycle_ns, now_ns)
    heard, feedback = feedback_of(config, state.reception)
    command, before = COASTING, control.state
    if heard:
        if control.began_ns < 0:
            control.began_ns = now_ns
        now = (now_ns - control.began_ns) * 1e-9
        if is_stale(config, state.reception.seen_ns, now_ns):
            command = lose_feedback(config.constants, state.memory, now)
        else:
            command = update(config.constants, state.memory, now, feedback)
    set_command(config, state.memory, command)
    note_course(state.memory, control.state != before)
    ends = is_moving(before) and control.state != before
    if now_ns < control.command_ns and not ends:
        return config.nothing
    if now_ns >= control.command_ns:
        control.command_ns = next_time(control.command_ns, config.command_ns, now_ns)
    return command_frames(config, state, False)


@compilable
def last_frames(config: EcuConfig, state: EcuState) -> Frames:
    """Return the frames that the ECU sends last: all pages of a command with the motors off."""
    set_command(config, state.memory, COASTING)
    return command_frames(config, state, True)
