"""Source, bridges and windings together: both motor currents over a step, before the speeds are known."""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_compiler import compilable
from liftgate_plant import bridge, dynamics
from liftgate_plant.bridge import CUT, Coasting, DriveInput
from liftgate_plant.current import NO_SWITCHING, CurrentPath, Switching
from liftgate_plant.dynamics import (
    Drive,
    DriveState,
    Inputs,
    Load,
    Place,
    Plant,
    State,
    emf_constant,
    fed_of,
    is_chopped,
    resistances_soon,
    time_on_source,
)
from liftgate_plant.friction import level
from liftgate_plant.motor import (
    Phi,
    Response,
    Transient,
    Winding,
    end_current,
    mean_current,
    phi_functions,
    restarted,
    solve_windings,
    transient_of,
)
from liftgate_plant.pwm import NO_COURSE, SLOW, Course
from liftgate_plant.switching import courses, drawn_share


class Electric(NamedTuple):
    """Electrical model of one drive during a step, in which its current depends on the final speeds."""

    response: Response
    transient: Transient
    torque_constant: float  # N m/A, at the present temperature
    diodes: float  # V, voltage that the diodes hold on a coasting motor
    switching: Switching


class Around(NamedTuple):
    """Changes of the voltages [V] on a coasting motor, by the other motor's current and its own speed.

    They are the drop of its terminal voltage by the other motor at the start, the rise of that drop over the
    step, and the rise of its own back-EMF without a current.
    """

    drop: float
    rise: float
    free: float


_LASTING = 0.1  # largest share of a step's change of speed that the mechanism's force may undo
ALONE = Around(0.0, 0.0, 0.0)
NO_TRANSIENT = Transient(0.0, 1.0, 0.0, 0.0)
NO_RESPONSE = Response(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@compilable
def resistance_soon(drive: Drive, state: DriveState, step: float) -> float:
    """Return the resistance R [Ω] of a motor's whole current path in the middle of the step."""
    by_winding, by_fuse = resistances_soon(drive, state, 0.5 * step)
    return by_winding + by_fuse


@compilable
def winding_of(
    drive: Drive,
    state: DriveState,
    drive_input: DriveInput,
    terminal: float,
    rise: float,
    free_rise: float,
    resistance: float,
    step: float,
) -> tuple[Winding, Coasting, Switching]:
    """Return a motor's winding with the voltage applied to it, how it coasts, and how its bridge switches.

    The winding's equation is L di/dt = u − R i − c2Φ n, (4.1) of the thesis; switching is that of a PWM's mean.
    `resistance` [Ω] is that of the whole line, with cut-out and contacts. `terminal` [V] is the voltage at the
    start of a step [s], `rise` its change by source and other motor, `free_rise` that of the EMF without current.
    """
    motor, by_speed = drive.motor, emf_constant(drive, state)
    if drive.active == 0.0:  # no winding there, so nothing that could load the source
        winding = Winding(resistance, motor.inductance, by_speed, 0.0, 0.0, 0.0)
        return winding, Coasting(1.0, 0.0, 0.0, step), NO_SWITCHING
    if drive_input.coast == CUT:
        winding = Winding(resistance, motor.inductance, by_speed, 0.0, 0.0, 0.0)
        return winding, Coasting(0.0, 0.0, 0.0, step), NO_SWITCHING
    if drive_input.coast == 0.0:
        duty = drive_input.duty
        winding = Winding(resistance, motor.inductance, by_speed, duty, drive_input.voltage, duty * rise)
        return winding, Coasting(1.0, 0.0, 0.0, step), directly_on(drive_input)
    limit = terminal + 2.0 * drive.diode_drop
    emf = by_speed * state.speed
    growth = free_rise * math.copysign(1.0, emf) - rise
    coast = bridge.coasting(state.current, emf, resistance, motor.inductance, limit, growth, step)
    more = 0.0 if coast.voltage == 0.0 else math.copysign(1.0, coast.voltage) * rise
    voltage = coast.voltage + 0.5 * more
    winding = Winding(resistance, motor.inductance, by_speed, 0.0, voltage, more)
    return winding, coast, Switching(0.0, 0.0, 0.0, coasting_share(coast), 0.0, 0.0, 0.0)


@compilable
def emf_rise(drive: Drive, state: DriveState, place: Place, friction: float, current: float, step: float) -> float:
    """Return the rise [V] of a motor's back-EMF over a step with a given current and the forces at its start.

    Returns 0 where these forces do not last for a step, as with a very stiff mechanism.
    """
    yielding = drive.mechanism.stiffness * step + drive.mechanism.damping
    if dynamics.shaft_mobility(drive) * yielding * step > _LASTING:
        return 0.0
    force = dynamics.drive_force(drive, state, place)
    loss = friction * (level(drive.friction, state.speed) + drive.friction.viscous * abs(state.speed))
    loss += drive.load_friction * drive.torque_per_force * abs(force)
    torque = dynamics.torque_constant(drive, state) * current - drive.torque_per_force * force
    if state.speed == 0.0 and abs(torque) <= loss:
        return 0.0
    torque -= math.copysign(loss, state.speed if state.speed != 0.0 else torque)
    constant = emf_constant(drive, state)
    rise, emf = constant * torque / (2.0 * math.pi * drive.inertia) * step, constant * state.speed
    # Friction, such as that of a jammed spindle, stops a shaft but never reverses it.
    return -emf if rise * emf < 0.0 and abs(rise) > abs(emf) else rise


@compilable
def drop_beside(
    drive: Drive,
    state: DriveState,
    place: Place,
    friction: float,
    drive_input: DriveInput,
    source: tuple[float, float],
    now: Course,
    step: float,
) -> tuple[float, float]:
    """Return the drop [V] of one motor's terminal voltage due to the other's current, and the drop's rise.

    `source` has the source's voltage [V] and resistance [Ω].
    The drop holds once its winding has followed a switch of its bridge; the rise over the step is due to the motor
    turning faster.
    """
    duty = drive_input.duty
    voltage, source_resistance = source
    if source_resistance == 0.0 or duty == 0.0 or drive_input.coast != 0.0 or drive.active == 0.0:
        return 0.0, 0.0
    if is_chopped(drive, drive_input):
        return source_resistance * now.drawn, 0.0
    by_winding, by_fuse = resistances_soon(drive, state, 0.5 * step)
    resistance = by_winding + by_fuse + source_resistance * duty * duty
    driving = duty * voltage + drive_input.voltage - emf_constant(drive, state) * state.speed
    final = driving / resistance
    left = (state.current - final) * math.exp(-resistance / drive.motor.inductance * step)
    faster = emf_rise(drive, state, place, friction, final, step)
    by_current = source_resistance * duty
    return by_current * (final + left), -by_current * faster / resistance


@compilable
def around(
    plant: Plant, state: State, inputs: Inputs, source: float, now_l: Course, now_r: Course, step: float
) -> tuple[Around, Around]:
    """Return the voltage changes on the left and right motor if coasting; all 0 if neither coasts."""
    if inputs.left.coast == 0.0 and inputs.right.coast == 0.0:
        return ALONE, ALONE
    places, frictions = dynamics.places_of(plant, state), dynamics.frictions_at(plant, inputs)
    fed = source, plant.source_resistance
    drop_l, rise_l = drop_beside(
        plant.right, state.right, places.right, frictions.right, inputs.right, fed, now_r, step
    )
    drop_r, rise_r = drop_beside(
        plant.left, state.left, places.left, frictions.left, inputs.left, fed, now_l, step
    )
    free_l = emf_rise(plant.left, state.left, places.left, frictions.left, 0.0, step)
    free_r = emf_rise(plant.right, state.right, places.right, frictions.right, 0.0, step)
    return Around(drop_l, rise_l, free_l), Around(drop_r, rise_r, free_r)


@compilable
def directly_on(drive_input: DriveInput) -> Switching:
    """Return the Switching of a bridge that does not switch: its PWM's mean, or a directly applied voltage.

    A measurement while the PWM is on sees the motor's whole current. The result is NO_SWITCHING if nothing is
    applied.
    """
    duty, voltage = drive_input.duty, drive_input.voltage
    if duty != 0.0:
        return Switching(0.0, 0.0, 0.0, duty, 0.0, math.copysign(1.0, duty), 0.0)
    if voltage != 0.0:
        along = math.copysign(1.0, voltage)
        return Switching(0.0, 0.0, 0.0, along, 0.0, along, 0.0)
    return NO_SWITCHING


@compilable
def coasting_share(coast: Coasting) -> float:
    """Return the share of a coasting motor's current that flows through the source: 1, −1 or 0.

    The source supplies none of it: all of the current flows back.
    """
    return 0.0 if coast.voltage == 0.0 else math.copysign(1.0, coast.voltage)


@compilable
def switching_of(drive: Drive, duty: float, now: Course) -> Switching:
    """Return the Switching of a bridge that switches, at a duty and with the motor's periodic current waveform."""
    along = math.copysign(1.0, duty)
    above, below = now.high - now.mean, now.low - now.mean
    if along < 0.0:
        above, below = -below, -above
    share = drawn_share(drive.pwm_period, drive.freewheeling, duty)
    surplus = now.drawn - share * now.mean
    return Switching(now.ripple, above, below, along * share, surplus, along, now.on - now.mean)


@compilable
def on_source(drive: Drive, drive_input: DriveInput) -> float:
    """Return the factor by which a motor's current flows through the source's resistance.

    The resistance acts on the motor with the factor's square. For a bridge that switches, and so draws for a part
    of the period, the square is the share of the period.
    """
    if not is_chopped(drive, drive_input):
        return drive_input.duty
    share = time_on_source(drive, drive_input.duty)
    return math.copysign(math.sqrt(share), drive_input.duty)


@compilable
def followed(
    drive: Drive, winding: Winding, drive_input: DriveInput, speed: float, now: Course, load: Load, sag: float
) -> Winding:
    """Return a winding whose current tends to its periodic PWM waveform, not to a mean voltage's current.

    It holds from the speed [rev/s] at the step's start on; `sag` [V] is what its equation takes off the source
    with both currents on their waveforms.

    What diodes let through is not linear in EMF and source voltage, so the mean is that of the waveform there,
    with its slopes. The transition from one waveform to another has the winding's L/R, as where the current does
    not end.
    """
    along, factor = math.copysign(1.0, drive_input.duty), on_source(drive, drive_input)
    constant = -winding.resistance * now.by_emf * winding.speed_constant
    rise = along * winding.resistance * now.by_supply * load.supply_rise
    voltage = along * winding.resistance * now.mean + constant * speed + 0.5 * rise
    voltage += factor * (sag - load.supply_voltage)
    return Winding(winding.resistance, winding.inductance, constant, factor, voltage, rise)


@compilable
def shared_sag(plant: Plant, inputs: Inputs, now_l: Course, now_r: Course) -> float:
    """Return the voltage drop [V] at the source's resistance that enters both windings' equations.

    Both currents are taken on their periodic waveforms.
    """
    drawn = along_duty(inputs.left, now_l) * on_source(plant.left, inputs.left)
    drawn += along_duty(inputs.right, now_r) * on_source(plant.right, inputs.right)
    return plant.source_resistance * drawn


@compilable
def along_duty(drive_input: DriveInput, now: Course) -> float:
    """Return a motor's signed mean current [A] by its periodic waveform; 0 for a bridge not on the source."""
    if drive_input.duty == 0.0 or drive_input.coast != 0.0:
        return 0.0
    return math.copysign(1.0, drive_input.duty) * now.mean


@compilable
def follows(drive: Drive, drive_input: DriveInput, source_resistance: float) -> bool:
    """Whether a winding is solved by its periodic PWM waveform (`followed`) instead of the mean voltage.

    It is asked where at least one of the bridges switches. On a source without resistance that is a bridge that
    switches with diode or fast freewheeling: with slow freewheeling, which shorts the motor, the mean of the
    applied voltage determines the current. On a source with resistance, whose voltage drop both drives share, it
    is each drive that neither coasts nor has a duty of 0.
    """
    if source_resistance == 0.0:
        return drive.freewheeling != SLOW and is_chopped(drive, drive_input)
    return drive.active != 0.0 and drive_input.coast == 0.0 and drive_input.duty != 0.0


@compilable
def electric_of(
    drive: Drive,
    state: DriveState,
    other: DriveState,
    line: tuple[Winding, Coasting, Switching],
    response: Response,
    phi: Phi,
    step: float,
) -> Electric:
    """Return one drive's electrical model for a step; `line` is what `winding_of` returned for it.

    A coasting motor whose current ends is treated as switched off until its back-EMF drives a current the other
    way.
    """
    winding, coast, switching = line
    torque_constant = dynamics.torque_constant(drive, state)
    if drive.active == 0.0:
        return Electric(NO_RESPONSE, NO_TRANSIENT, torque_constant, 0.0, NO_SWITCHING)
    if coast.conducts == 0.0:
        idle = Response(coast.mean, 0.0, 0.0, 0.0, 0.0, 0.0)
        if coast.restart < step:
            idle = restarted(winding, coast.mean, coast.restart, state.speed, step)
        return Electric(idle, NO_TRANSIENT, torque_constant, coast.voltage, switching)
    fall = state.current - end_current(response, state.speed, other.speed)
    fall += winding.rise / winding.resistance  # the part due to the voltage's rise does not die away
    per_inertia = torque_constant / (2.0 * math.pi * drive.inertia)
    transient = transient_of(per_inertia, winding, phi, fall, step)
    lagging = Response(
        response.mean + transient.lag,
        response.mean_own,
        response.mean_other,
        response.end,
        response.end_own,
        response.end_other,
    )
    return Electric(lagging, transient, torque_constant, winding.voltage, switching)


@compilable
def electrics_of(plant: Plant, state: State, inputs: Inputs, step: float) -> tuple[Electric, Electric]:
    """Return both drives' electrical models during a step of `step` seconds."""
    load = inputs.load
    rise = load.supply_rise
    source = load.supply_voltage - 0.5 * rise
    ohms_l = resistance_soon(plant.left, state.left, step)
    ohms_r = resistance_soon(plant.right, state.right, step)
    switches_l = is_chopped(plant.left, inputs.left)
    switches_r = is_chopped(plant.right, inputs.right)
    now_l, now_r = NO_COURSE, NO_COURSE
    if switches_l or switches_r:
        fed_l = fed_of(plant.left, state.left, inputs.left, ohms_l)
        fed_r = fed_of(plant.right, state.right, inputs.right, ohms_r)
        now_l, now_r = courses(fed_l, fed_r, source, plant.source_resistance)
    around_l, around_r = around(plant, state, inputs, source, now_l, now_r, step)
    winding_l, coast_l, switching_l = winding_of(
        plant.left, state.left, inputs.left, source - around_l.drop, rise - around_l.rise,
        around_l.free, ohms_l, step,
    )  # fmt: skip
    winding_r, coast_r, switching_r = winding_of(
        plant.right, state.right, inputs.right, source - around_r.drop, rise - around_r.rise,
        around_r.free, ohms_r, step,
    )  # fmt: skip
    if switches_l or switches_r:
        sag, shared = shared_sag(plant, inputs, now_l, now_r), plant.source_resistance
        if follows(plant.left, inputs.left, shared):
            winding_l = followed(plant.left, winding_l, inputs.left, state.left.speed, now_l, load, sag)
        if follows(plant.right, inputs.right, shared):
            winding_r = followed(plant.right, winding_r, inputs.right, state.right.speed, now_r, load, sag)
    if switches_l:
        switching_l = switching_of(plant.left, inputs.left.duty, now_l)
    if switches_r:
        switching_r = switching_of(plant.right, inputs.right.duty, now_r)
    left, right = state.left, state.right
    currents, speeds = (left.current, right.current), (left.speed, right.speed)
    response_l, response_r, phi_l, phi_r = solve_windings(
        winding_l, winding_r, currents, speeds,
        load.supply_voltage, plant.source_resistance, step,
    )  # fmt: skip
    if plant.source_resistance > 0.0:  # otherwise the modes are those of the windings already
        phi_l = phi_functions(-winding_l.resistance / winding_l.inductance * step)
        phi_r = phi_functions(-winding_r.resistance / winding_r.inductance * step)
    line_l, line_r = (winding_l, coast_l, switching_l), (winding_r, coast_r, switching_r)
    return (
        electric_of(plant.left, left, right, line_l, response_l, phi_l, step),
        electric_of(plant.right, right, left, line_r, response_r, phi_r, step),
    )  # fmt: skip


@compilable
def path_of(electric: Electric, begin: float, end: float, own: float, other: float, step: float) -> CurrentPath:
    """Return the course of a motor's current from `begin` to `end` [A] over a step, for final speeds [rev/s]."""
    mean = mean_current(electric.response, own, other)
    amplitude, decay = electric.transient.amplitude, electric.transient.decay
    if amplitude == 0.0 and (begin - end) * (mean - end) > 0.0:
        # It ended inside the step: modelled as one that decays, with the same start and the same charge.
        amplitude = begin - end
        decay = amplitude / ((mean - end) * step)
    return CurrentPath(begin, end, mean, amplitude, decay, electric.switching)


@compilable
def final_current(electric: Electric, coast: float, own: float, other: float) -> float:
    """Return a motor's current [A] at the end of the step; a coasting motor's diodes block reverse current."""
    current = end_current(electric.response, own, other)
    return current if coast == 0.0 else bridge.blocked(current, -electric.diodes)
