"""Plausibility of a vehicle: notes on allowed values that no power lift gate has, e.g. due to a wrong unit.

The bounds are wide: the shipped vehicles, and those drawn from their spreads, are far from them. What is compared
follows from several values of the file, and a note names all of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from liftgate_plant import gate, spring
from liftgate_plant.vehicle import DriveTables, Vehicle

_LEAST_CONSTANT = 0.3  # of c1Φ to c2Φ/2π, which are equal in a motor without losses (2.1, 2.3)
_MOST_ELECTRICAL_S = 0.02  # L/R
_MOST_MECHANICAL_S = 0.5  # 2π J R/(c1Φ c2Φ)
_STALL_A = (1.0, 300.0)
_TRAVEL_S = (0.5, 60.0)  # for the whole travel, at the speed without load
_CARRIED = (0.05, 5.0)  # by the springs, of the weight's torque halfway
_MOST_PRESSED = 0.05  # of the travel, by which a stalled drive presses the gate beyond its end stop
_LEAST_CHANGE = 0.01  # of the spring's force over its travel, of the preload
_LEAST_PRELOAD = 0.01  # of that change
_LEAST_OPEN_DEG = 20.0
_MOST_PLAY = 0.2  # of a revolution of the spindle


def notes_on_vehicle(vehicle: Vehicle) -> list[str]:
    """Return a note for each implausible property of a vehicle, a line each; empty: there is none."""
    sides = (vehicle.left, vehicle.right)[: vehicle.drives]
    notes = [each for tables in sides for each in _notes_on_drive(vehicle, tables)]
    notes += _notes_on_gate(vehicle, sides)
    return list(dict.fromkeys(notes))


def _notes_on_drive(vehicle: Vehicle, tables: DriveTables) -> Iterator[str]:
    motor, volts = tables.motor, vehicle.supply.voltage
    ideal = motor.speed_constant / (2.0 * math.pi)
    if ideal > 0.0 and motor.torque_constant < _LEAST_CONSTANT * ideal:
        yield (
            f"motor.torque_constant is {100.0 * motor.torque_constant / ideal:.2g} % of motor.speed_constant/2π, "
            "to which it is equal in a motor without losses: are they in N m/A and V/rps?"
        )
    if motor.resistance > 0.0:
        if motor.inductance / motor.resistance > _MOST_ELECTRICAL_S:
            yield (
                f"motor.inductance/motor.resistance is {motor.inductance / motor.resistance:.2g} s, in motors of "
                "this size less than 0.01 s: are they in H and ohm?"
            )
        stalled = volts / motor.resistance
        if not _STALL_A[0] <= stalled <= _STALL_A[1] and volts >= 6.0:
            yield f"motor.resistance lets {stalled:.3g} A through a stalled motor: is it in ohm?"
    slowness = motor.torque_constant * ideal
    if slowness > 0.0 and motor.rotor_inertia * motor.resistance / slowness > _MOST_MECHANICAL_S:
        yield (
            f"the motor alone takes {motor.rotor_inertia * motor.resistance / slowness:.2g} s to reach its speed: "
            "is motor.rotor_inertia in kg m²?"
        )
    if tables.gear.backlash > _MOST_PLAY:
        yield f"gear.backlash is {tables.gear.backlash:.2g} of a revolution of the spindle: is it in rev?"
    yield from _notes_on_spring(vehicle, tables)
    yield from _notes_on_travel(vehicle, tables)


def _notes_on_spring(vehicle: Vehicle, tables: DriveTables) -> Iterator[str]:
    own, stroke = tables.spring, gate.linkage(vehicle.gate).stroke
    change = own.stiffness * stroke
    if 0.0 < change < _LEAST_CHANGE * own.preload:
        yield f"spring.stiffness changes the spring's force by {change:.2g} N over its travel: is it in N/m?"
    if 0.0 < own.preload < _LEAST_PRELOAD * change:
        yield f"spring.preload is {own.preload:.3g} N, and {change:.3g} N more when compressed: is it in N?"


def _notes_on_travel(vehicle: Vehicle, tables: DriveTables) -> Iterator[str]:
    motor, link, volts = tables.motor, gate.linkage(vehicle.gate), vehicle.supply.voltage
    per_turn = tables.spindle.lead / tables.gear.ratio
    if motor.speed_constant <= 0.0 or per_turn <= 0.0 or volts < 6.0:
        return
    seconds = link.stroke / (volts / motor.speed_constant * per_turn)
    if not _TRAVEL_S[0] <= seconds <= _TRAVEL_S[1]:
        yield (
            f"without load the gate would travel from end to end in {seconds:.2g} s at {volts:g} V: are "
            "motor.speed_constant (V/rps), gear.ratio and spindle.lead (m/rev) right?"
        )
    if motor.resistance > 0.0 and tables.spring.stop_stiffness > 0.0:
        force = motor.torque_constant * volts / motor.resistance * 2.0 * math.pi / per_turn
        pressed = force / tables.spring.stop_stiffness
        if pressed > _MOST_PRESSED * link.stroke:
            yield (
                f"a stalled drive presses the gate {1e3 * pressed:.3g} mm beyond its end stop, of a travel of "
                f"{1e3 * link.stroke:.3g} mm: is spring.stop_stiffness in N/m?"
            )


def _notes_on_gate(vehicle: Vehicle, sides: tuple[DriveTables, ...]) -> Iterator[str]:
    own, link = vehicle.gate, gate.linkage(vehicle.gate)
    if math.degrees(own.open_angle) < _LEAST_OPEN_DEG:
        yield f"gate.open_angle_deg is {math.degrees(own.open_angle):.3g}: is it in degrees?"
    if own.gravity_point[0] < own.hinge[0]:
        yield (
            "gate.gravity_point is in front of the hinge, so that its weight opens the closed gate: x points "
            "rearward"
        )
    half = 0.5 * own.open_angle
    weight = gate.weight_torque(own.mass * gate.GRAVITY * link.gravity_radius, link, half, 0.0)
    carried = sum(
        spring.force(each.spring, gate.extension(link, half), link.stroke, 20.0) * gate.lever(link, half)
        for each in sides
    )
    share = abs(carried / weight) if weight else 1.0
    if carried and not _CARRIED[0] <= share <= _CARRIED[1]:
        yield (
            f"halfway the springs carry {100.0 * share:.2g} % of the gate's weight: are spring.preload (N), "
            "spring.stiffness (N/m) and gate.mass (kg) right?"
        )
