"""Accuracy of switching bridges at random points, against a solution that follows every switch and diode.

The bridges are on one source with an internal resistance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from liftgate_compiler import compiled
from liftgate_hil import load_vehicle
from liftgate_plant import current, dynamics, integrate
from liftgate_plant.bridge import DriveInput
from liftgate_plant.initial import initial_state
from liftgate_plant.pwm import FREEWHEELING
from liftgate_plant.vehicle import Vehicle, plant_of
from tests.plant.runs import inputs
from tests.reference.switched_bridges import Bridge, periodic

BAR = 0.01  # relative error allowed of mean, effective value and drawn current
FLOOR = 0.1  # A; the error of a smaller current is taken relative to this one
SETTLING = 3e-3  # s, many time constants L/R; then the currents are compared
STEPS = (1e-3, 1e-4)  # s; the points use them in turn


class Point(NamedTuple):
    """Bridges of one or two drives on a source [V] behind a resistance [Ω]."""

    bridges: list[Bridge]
    source: float
    resistance: float


class Apart(NamedTuple):
    """Largest relative errors of either motor's current at one point, and error of the terminal voltage [V]."""

    number: int
    mean: float
    rms: float
    drawn: float
    terminal: float

    @property
    def is_met(self) -> bool:
        """Whether all errors of the currents are below BAR."""
        return max(self.mean, self.rms, self.drawn) < BAR


def point(number: int) -> Point:
    """Return the random point of this number; the same number gives the same point."""
    rng = np.random.default_rng([2027, number])
    frequency = 1e3 * 20.0 ** rng.uniform()
    source, resistance = float(rng.uniform(9.0, 16.0)), float(rng.uniform(0.0, 0.2))
    kind = rng.choice(["one", "alike", "two duties", "unlike"])
    first = bridge_at(rng, frequency, source)
    if kind == "one":
        return Point([first], source, resistance)
    second = first
    if kind == "two duties":
        duty = math.copysign(rng.uniform(0.05, 1.0), first.duty)
        second = first._replace(duty=float(duty))
    elif kind == "unlike":
        second = bridge_at(rng, frequency, source)
    return Point([first, second], source, resistance)


def bridge_at(rng: np.random.Generator, frequency: float, source: float) -> Bridge:
    """Return a random bridge with a motor near the SUV's.

    The back-EMF is −0.3 to 1.1 of the source along the duty: the motor may be driven a little beyond the source,
    or against its duty.
    """
    along = float(rng.choice([-1.0, 1.0]))
    return Bridge(
        mode=str(rng.choice(FREEWHEELING)),
        duty=along * float(rng.choice([1.0, *rng.uniform(0.05, 1.0, 9)])),
        frequency=frequency,
        emf=along * source * float(rng.uniform(-0.3, 1.1)),
        resistance=0.708 * float(2.0 ** rng.uniform(-1.0, 1.0)),
        inductance=4.37e-5 * float(3.0 ** rng.uniform(-1.0, 1.0)),
    )


def vehicle_at(what: Point) -> Vehicle:
    """Return a vehicle with these bridges, and with rotors so heavy that their speed stays constant."""
    settings = [f"supply.voltage={what.source}", f"supply.internal_resistance={what.resistance}"]
    settings += ["motor.rotor_inertia=1.0", f"drives={len(what.bridges)}"]
    vehicle = load_vehicle("suv", settings, ideal=True)
    sides = []
    for each in what.bridges:
        own = vehicle.left
        motor = own.motor._replace(resistance=each.resistance, inductance=each.inductance)
        switching = own.bridge._replace(diode_drop=each.drop, pwm_frequency=each.frequency, freewheeling=each.mode)
        sides.append(own._replace(motor=motor, bridge=switching))
    return vehicle._replace(left=sides[0], right=sides[-1])


def apart(number: int) -> Apart:
    """Return the errors at the point of this number; successive points use the steps of STEPS in turn."""
    return compared(number, point(number), STEPS[number % len(STEPS)])


def compared(number: int, what: Point, step: float, repeats: float = 0.0) -> Apart:
    """Return the errors at a point: of the currents after they have settled, and of the terminal voltage then.

    `repeats` [s] is the period that bridges of two frequencies have in common.
    """
    vehicle = vehicle_at(what)
    plant, state = plant_of(vehicle), initial_state(plant_of(vehicle), 0.5)
    constant = vehicle.left.motor.speed_constant
    left, right = what.bridges[0], what.bridges[-1]
    state = state._replace(
        left=state.left._replace(speed=left.emf / constant), right=state.right._replace(speed=right.emf / constant)
    )
    given = inputs(vehicle, DriveInput(left.duty, 0.0, 0.0), DriveInput(right.duty, 0.0, 0.0))
    advance = compiled(integrate.advance)
    state, flow = advance(plant, state, given, step)
    for _ in range(round(SETTLING / step)):
        state, flow = advance(plant, state, given, step)
    exact = periodic(what.bridges, what.source, what.resistance, repeats)
    shown = dynamics.outputs(plant, state, given)
    worst = [0.0, 0.0, 0.0]
    for own, drive, path in zip(exact.currents, (state.left, state.right), (flow.left, flow.right), strict=False):
        drawn = path.switching.drawn * path.mean + path.switching.drawn_beside
        found = (off(drive.current, own.mean), off(current.effective(path, step), own.rms), off(drawn, own.drawn))
        worst = [max(both) for both in zip(worst, found, strict=True)]
    return Apart(number, *worst, abs(shown.terminal_voltage - exact.terminal))


def off(value: float, exact: float) -> float:
    """Return the relative error of a current [A]; an exact value smaller than FLOOR counts as FLOOR."""
    return abs(value - exact) / max(abs(exact), FLOOR)
