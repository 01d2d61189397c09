"""Source, bridges and windings together: both motors' currents over a step, before the speeds are known."""

from __future__ import annotations

import math
from typing import NamedTuple

from liftgate_plant import bridge, supply, thermal
from liftgate_plant.bridge import Coasting, DriveInput
from liftgate_plant.compiler import compilable
from liftgate_plant.current import NO_SWITCHING, CurrentPath, Switching
from liftgate_plant.dynamics import (
    Drive,
    DriveState,
    Inputs,
    Plant,
    State,
    chopper_of,
    emf_constant,
    source_share,
    winding_resistance,
)
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
from liftgate_plant.pwm import SLOW, course


class Electric(NamedTuple):
    """One drive's electrical side during a step."""

    response: Response
    transient: Transient
    resistance: float  # Ω, at the present temperature
    torque_constant: float  # N m/A, at the present temperature
    diodes: float  # V, what those of a coasting motor hold on it
    switching: Switching


NO_TRANSIENT = Transient(0.0, 1.0, 0.0, 0.0)
NO_RESPONSE = Response(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@compilable
def winding_of(
    drive: Drive,
    state: DriveState,
    drive_input: DriveInput,
    terminal: float,
    rise: float,
    step: float,
) -> tuple[Winding, Coasting, Switching]:
    """The winding of (4.1) at its present temperature with what is applied to it, how it coasts, and how it is
    switched; `terminal` voltage of the step's start, `rise` of the source over the step.
    """
    motor = drive.motor
    resistance, by_speed = winding_resistance(drive, state), emf_constant(drive, state)
    if drive.active == 0.0:  # no winding there, so nothing that could load the source
        winding = Winding(resistance, motor.inductance, by_speed, 0.0, 0.0, 0.0)
        return winding, Coasting(1.0, 0.0, 0.0, step), NO_SWITCHING
    if drive_input.coast == 0.0:
        duty = drive_input.duty
        winding = Winding(
            resistance, motor.inductance, by_speed, duty, drive_input.voltage, duty * rise
        )
        switching = directly_on(drive_input)
        if drive.pwm_period > 0.0 and 0.0 < abs(duty) < 1.0:
            winding, switching = chopped(drive, winding, state.speed, terminal)
        return winding, Coasting(1.0, 0.0, 0.0, step), switching
    limit = terminal + 2.0 * drive.diode_drop
    emf = by_speed * state.speed
    coast = bridge.coasting(state.current, emf, resistance, motor.inductance, limit, step)
    more = 0.0 if coast.voltage == 0.0 else math.copysign(1.0, coast.voltage) * rise
    voltage = coast.voltage + 0.5 * more
    winding = Winding(resistance, motor.inductance, by_speed, 0.0, voltage, more)
    return winding, coast, Switching(0.0, 0.0, 0.0, coasting_share(coast), 0.0)


@compilable
def directly_on(drive_input: DriveInput) -> Switching:
    """Of a bridge that is taken as its mean, or of a voltage that is applied without one: all of it is seen."""
    duty, voltage = drive_input.duty, drive_input.voltage
    if duty != 0.0:
        return Switching(0.0, 0.0, 0.0, duty, math.copysign(1.0, duty))
    if voltage != 0.0:
        return Switching(0.0, 0.0, 0.0, math.copysign(1.0, voltage), math.copysign(1.0, voltage))
    return NO_SWITCHING


@compilable
def coasting_share(coast: Coasting) -> float:
    """Of a coasting motor's current, what the source gives: none of it, all comes back."""
    return 0.0 if coast.voltage == 0.0 else math.copysign(1.0, coast.voltage)


@compilable
def chopped(
    drive: Drive, winding: Winding, speed: float, terminal: float
) -> tuple[Winding, Switching]:
    """A winding whose bridge switches, at the speed [rev/s] and terminal voltage of the step's start.

    What diodes let through is not linear in either, so that its mean is that of the course there and of its
    slopes. From one course to another the mean goes with the winding's L/R, as where the current does not end.
    """
    along = math.copysign(1.0, winding.duty)
    emf = winding.speed_constant * speed
    chopper = chopper_of(drive, winding.resistance)
    now = course(chopper, abs(winding.duty), terminal, along * emf)
    drawn, on = winding.duty, along
    if now.mean != 0.0:
        drawn, on = along * now.drawn / now.mean, along * now.on / now.mean
    above, below = now.high - now.mean, now.low - now.mean
    if along < 0.0:
        above, below = -below, -above
    switching = Switching(now.ripple, above, below, drawn, on)
    if drive.freewheeling == SLOW:
        return winding, switching
    duty = along * winding.resistance * now.by_supply
    slope = -winding.resistance * now.by_emf
    voltage = along * winding.resistance * now.mean + slope * emf - duty * terminal
    return Winding(
        winding.resistance,
        winding.inductance,
        slope * winding.speed_constant,
        duty,
        winding.voltage + voltage,
        0.0 if winding.duty == 0.0 else duty * winding.rise / winding.duty,
    ), switching


@compilable
def electric_of(
    drive: Drive,
    state: DriveState,
    other: DriveState,
    winding: Winding,
    coast: Coasting,
    switching: Switching,
    response: Response,
    phi: Phi,
    step: float,
) -> Electric:
    """One drive's side of the solved windings; a coasting motor whose current ends is switched off until its
    back-EMF drives one the other way.
    """
    flux = thermal.flux_factor(drive.thermal, state.housing_temperature)
    torque_constant = drive.motor.torque_constant * flux
    if drive.active == 0.0:
        return Electric(
            NO_RESPONSE, NO_TRANSIENT, winding.resistance, torque_constant, 0.0, NO_SWITCHING
        )
    if coast.conducts == 0.0:
        idle = Response(coast.mean, 0.0, 0.0, 0.0, 0.0, 0.0)
        if coast.restart < step:
            idle = restarted(winding, coast.mean, coast.restart, state.speed, step)
        return Electric(
            idle, NO_TRANSIENT, winding.resistance, torque_constant, coast.voltage, switching
        )
    fall = state.current - end_current(response, state.speed, other.speed)
    fall += winding.rise / winding.resistance  # which does not die away
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
    return Electric(
        lagging, transient, winding.resistance, torque_constant, winding.voltage, switching
    )


@compilable
def electrics_of(
    plant: Plant, state: State, inputs: Inputs, step: float
) -> tuple[Electric, Electric]:
    """Both drives' electrical sides during a step of `step` seconds."""
    load = inputs.load
    rise = load.supply_rise
    source = load.supply_voltage - 0.5 * rise
    terminal = supply.terminal_voltage(
        source,
        plant.source_resistance,
        source_share(plant.left, state.left, inputs.left.duty, source),
        state.left.current,
        source_share(plant.right, state.right, inputs.right.duty, source),
        state.right.current,
    )
    winding_l, coast_l, switching_l = winding_of(
        plant.left, state.left, inputs.left, terminal, rise, step
    )
    winding_r, coast_r, switching_r = winding_of(
        plant.right, state.right, inputs.right, terminal, rise, step
    )
    response_l, response_r, phi_l, phi_r = solve_windings(
        winding_l,
        winding_r,
        state.left.current,
        state.right.current,
        state.left.speed,
        state.right.speed,
        load.supply_voltage,
        plant.source_resistance,
        step,
    )
    if plant.source_resistance > 0.0:  # else the modes are the windings
        phi_l = phi_functions(-winding_l.resistance / winding_l.inductance * step)
        phi_r = phi_functions(-winding_r.resistance / winding_r.inductance * step)
    return (
        electric_of(
            plant.left,
            state.left,
            state.right,
            winding_l,
            coast_l,
            switching_l,
            response_l,
            phi_l,
            step,
        ),
        electric_of(
            plant.right,
            state.right,
            state.left,
            winding_r,
            coast_r,
            switching_r,
            response_r,
            phi_r,
            step,
        ),
    )


@compilable
def path_of(
    electric: Electric, begin: float, end: float, own: float, other: float, step: float
) -> CurrentPath:
    """What a current that goes from one value [A] to another does meanwhile, for the final speeds [rev/s]."""
    mean = mean_current(electric.response, own, other)
    amplitude, decay = electric.transient.amplitude, electric.transient.decay
    if amplitude == 0.0 and (begin - end) * (mean - end) > 0.0:
        # It ended inside the step: shown as one that dies away, with the same start and the same charge.
        amplitude = begin - end
        decay = amplitude / ((mean - end) * step)
    return CurrentPath(begin, end, mean, amplitude, decay, electric.switching)


@compilable
def final_current(electric: Electric, coast: float, own: float, other: float) -> float:
    """Current [A] at the end of the step; a coasting motor's diodes let none pass backwards."""
    current = end_current(electric.response, own, other)
    return current if coast == 0.0 else bridge.blocked(current, -electric.diodes)
