"""The H-bridge, averaged over one PWM period (`pwm` adds the effects of switching).

| state | voltage on the motor |
|---|---|
| open, close | ± duty · U_terminal |
| brake | 0, both low sides on |
| coast | all off: the diodes carry the current against U_terminal + 2 U_diode until it is zero |

A coasting winding is set-valued like dry friction: L di/dt = −R i − c2Φ n − V sgn(i) with V = U_terminal + 2
U_diode, and at i = 0 the diodes hold any voltage within ±V.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from liftgate_compiler import compilable
from liftgate_plant.pwm import FREEWHEELING
from liftgate_plant.quantity import Quantity, choice

COAST, OPEN, CLOSE, BRAKE = 0, 1, 2, 3

CUT = 2.0  # value of `DriveInput.coast`: not even the diodes have a circuit


class Bridge(NamedTuple):
    """Table `[bridge]` of the vehicle file: diodes, PWM frequency and freewheeling of the H-bridges."""

    diode_drop: Annotated[float, Quantity("U_diode", "V", 0.0, 5.0, "forward drop of one freewheeling diode")] = (
        0.7
    )
    pwm_frequency: Annotated[
        float,
        Quantity(
            "f",
            "Hz",
            0.0,
            1e6,
            "PWM frequency, high relative to the motor; 0: only the mean of the PWM",
            least=1e3,
        ),
    ] = 0.0
    freewheeling: Annotated[str, choice(FREEWHEELING, "path of the current while the PWM is off")] = "slow"


class DriveInput(NamedTuple):
    """Electrical input of one motor during a step: duty, voltage, coasting.

    `duty` is signed (−1…1, positive opens) and takes its current from the source; `voltage` [V] is applied to the
    motor directly, beside the source (a measured motor voltage); `coast` is 1.0 for all switches off, CUT for a
    motor without any circuit.
    """

    duty: float
    voltage: float
    coast: float


@compilable
def drive_input(state: int, duty: float) -> DriveInput:
    """Return the motor input for a bridge state (COAST, OPEN, CLOSE, BRAKE) and a duty of 0…1."""
    if state == OPEN:
        return DriveInput(duty, 0.0, 0.0)
    if state == CLOSE:
        return DriveInput(-duty, 0.0, 0.0)
    return DriveInput(0.0, 0.0, 1.0 if state == COAST else 0.0)


class Coasting(NamedTuple):
    """Current of a coasting motor through the diodes in a step: whether it lasts, otherwise its mean and restart.

    Where `conducts` is 1.0 the diodes hold `voltage` on the motor all the time. Otherwise the current ends inside
    the step and has contributed the mean `mean`; from `restart` [s] on the diodes hold `voltage`, against a
    back-EMF beyond their limit. A restart at the end of the step means none.
    """

    conducts: float
    voltage: float
    mean: float
    restart: float


@compilable
def coasting(
    current: float, emf: float, resistance: float, inductance: float, limit: float, growth: float, step: float
) -> Coasting:
    """Return how the diodes conduct in a step with all switches off, for a motor's current [A] and back-EMF [V].

    `emf` is the back-EMF [V], `limit` is V at the step's start, and `growth` [V] is how much the EMF's magnitude
    gains on that limit until its end, as long as there is no current.
    """
    excess = abs(emf) - limit
    beyond = math.copysign(limit, emf) if max(excess, excess + growth) > 0.0 else 0.0
    if current == 0.0:
        if excess > 0.0:
            return Coasting(1.0, beyond, 0.0, step)
        return Coasting(0.0, beyond, 0.0, restart(excess, growth, 0.0, step))
    voltage = -math.copysign(limit, current)
    final = (voltage - emf) / resistance
    if final * current >= 0.0:
        return Coasting(1.0, voltage, 0.0, step)
    # i(t) = final + (i0 − final) exp(−t R/L) is zero at:
    time = inductance / resistance * math.log(1.0 - current / final)
    if time >= step:
        return Coasting(1.0, voltage, 0.0, step)
    charge = final * time + (current - final) * inductance / resistance * (
        1.0 - math.exp(-time * resistance / inductance)
    )
    return Coasting(0.0, beyond, charge / step, restart(excess, growth, time, step))


@compilable
def restart(excess: float, growth: float, earliest: float, step: float) -> float:
    """Return the time [s] in a step from which on a back-EMF drives current through the diodes; `step`: never.

    The EMF is `excess` [V] over its limit at the step's start, and grows by `growth` [V] over the step.
    """
    if excess + growth * earliest / step > 0.0:
        return earliest
    return step * -excess / growth if excess + growth > 0.0 else step


@compilable
def blocked(current: float, direction: float) -> float:
    """Return the current limited by diodes: 0 if it flows against `direction` (sign of the driving voltage)."""
    return current if current * direction > 0.0 else 0.0
