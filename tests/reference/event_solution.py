"""Independent reference solution of the lift gate: every change of regime is a located event.

The plant is smooth between changes of regime (a shaft sticks or slips, a flank, stop, seal or
obstacle touches or lets go, a freewheeling current starts or ends). Each smooth piece is
integrated at a tight tolerance with the regime held fixed; the end of the piece is found by root
finding on the dense output and the integration starts afresh there. Numbers in parentheses are
the equation numbers of the thesis. SI units, motor speed in rev/s and motor position in rev.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import Radau, solve_ivp
from scipy.linalg.lapack import dgetrf, dgetrs, zgetrf, zgetrs

from tests import last_bits

GRAVITY = 9.81
# Events show at the ends of steps only: a grazing touch within one step goes unnoticed (measured
# effect on the current: about 1e-5 A). The tolerance keeps steps short in motion, this at rest [s].
MAX_STEP = 5e-3
MAX_EVENTS = 20_000
LOOK_AHEAD = 1e-11  # s: events closer together than this are taken as simultaneous
NO_PROGRESS = 1e-13  # s
# A change of regime must exceed rounding, or an element just at its boundary would chatter.
ROUNDING = 1e-13  # m, rev/s, rad/s, A, and relative to a torque


class SmallRadau(Radau):
    """scipy's Radau with LAPACK's own functions, as scipy's checks around them take longer than the solution."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.lu, self.solve_lu = self._factors, self._solution

    def _factors(self, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.nlu += 1
        factors, pivots, _ = (zgetrf if np.iscomplexobj(matrix) else dgetrf)(matrix)
        return factors, pivots

    @staticmethod
    def _solution(factors: tuple[np.ndarray, np.ndarray], right: np.ndarray) -> np.ndarray:
        return (zgetrs if np.iscomplexobj(factors[0]) else dgetrs)(*factors, right)[0]


@dataclass(frozen=True)
class DriveInput:
    """Bridge command: open, close, brake, coast (value = duty 0..1) or voltage (value = V)."""

    mode: str
    value: float = 0.0


@dataclass(frozen=True)
class Obstacle:
    """Compliant obstacle hit at `angle` [rad], `distance` [m] from the hinge, after `gap` [m]."""

    angle: float
    distance: float
    stiffness: float
    damping: float = 0.0
    gap: float = 0.0
    closing: bool = True
    lateral: float = 0.0  # m, positive to the left


@dataclass(frozen=True)
class Phase:
    """Constant inputs until time `end` [s]; None means the vehicle's own value. With `supply_end` the source's
    voltage goes there on a straight line.
    """

    end: float
    left: DriveInput
    right: DriveInput
    supply_voltage: float | None = None
    supply_end: float | None = None
    slope_deg: float | None = None
    external_torque: float = 0.0
    obstacle: Obstacle | None = None
    ambient: float | None = None  # °C
    wind_pressure: float = 0.0  # Pa
    snow_mass: float = 0.0  # kg
    hand_force: float = 0.0  # N
    released: bool = True  # the latch; else it catches a gate that comes to 0 rad
    changes: Mapping[str, Any] = field(default_factory=dict)  # tables laid over the vehicle's


@dataclass(frozen=True)
class Solution:
    """Values at the sample times; at the begin of a phase they are those of that phase."""

    time: np.ndarray
    left_current: np.ndarray
    left_speed: np.ndarray
    left_position: np.ndarray
    left_force: np.ndarray
    right_current: np.ndarray
    right_speed: np.ndarray
    right_position: np.ndarray
    right_force: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    twist: np.ndarray
    twist_rate: np.ndarray
    pinch_force: np.ndarray
    terminal_voltage: np.ndarray
    left_winding_temperature: np.ndarray
    left_housing_temperature: np.ndarray
    right_winding_temperature: np.ndarray
    right_housing_temperature: np.ndarray
    events: int


class Link(NamedTuple):
    """Linkage at one angle: travel l_S, its rate and the lever arm r_AP."""

    travel: float
    travel_rate: float
    arm: float


class View(NamedTuple):
    """Time and state, with their kinematics in the gate's middle, on its left and on its right."""

    time: float
    state: Sequence[float]
    middle: Link
    sides: tuple[Link, Link]


Law = Callable[[View], float]


class Contact:
    """One-sided spring and damper: F = max(0, k d + c d') while the depth d > 0, else 0."""

    def __init__(self, k: float, c: float, depth: Callable[[View], tuple[float, float]]) -> None:
        self.k, self.c, self.depth = k, c, depth
        self.active = False

    def reach(self, view: View) -> float:
        """Return a value [m] that is positive exactly where the law gives a force."""
        depth, rate = self.depth(view)
        return min(depth, depth + self.c / self.k * rate)

    def force(self, view: View) -> float:
        if not self.active:
            return 0.0
        depth, rate = self.depth(view)
        return self.k * depth + self.c * rate

    def alarm(self, view: View) -> float:
        return (-self.reach(view) if self.active else self.reach(view)) - ROUNDING

    def switch(self, view: View, progress: bool) -> None:
        self.active = not self.active


class MomentumEquation:
    """State v with inertia v' = load − limit·Sgn(v), Sgn set-valued at 0; limit None: none. What holds it at
    0 may be more than what brakes it.

    The same law holds for dry friction (v a speed) and for freewheeling diodes (v the current).
    """

    def __init__(self, index: int, inertia: float, load: Law, limit: Law | None, hold: Law | None = None) -> None:
        self.index, self.inertia, self.load, self.limit = index, inertia, load, limit
        self.hold = hold or limit
        self.sign = 0

    @property
    def is_held(self) -> bool:
        """Whether the state stays 0."""
        return self.limit is not None and self.sign == 0

    def derivative(self, view: View) -> float:
        if self.limit is None:
            return self.load(view) / self.inertia
        if self.is_held:
            return 0.0
        return (self.load(view) - self.sign * self.limit(view)) / self.inertia

    def alarm(self, view: View) -> float:
        if self.limit is None:
            return -1.0
        if self.sign == 0:
            assert self.hold is not None
            return abs(self.load(view)) - self.hold(view) * (1 + ROUNDING)
        return -self.sign * view.state[self.index] - ROUNDING

    def switch(self, view: View, progress: bool) -> None:
        """If stuck, break away; if moving, stop, and go on only if the load exceeds the limit."""
        assert self.hold is not None
        load = self.load(view)
        if self.sign == 0 or (progress and abs(load) > self.hold(view)):
            self.sign = 1 if load > 0 else -1
        else:  # without progress it would only come back here: hold it until it breaks away
            self.sign = 0


class Latch:
    """Latch that catches the gate at 0 rad unless released, and holds it there."""

    def __init__(self, released: bool) -> None:
        self.released = released
        self.holds = False

    def alarm(self, view: View) -> float:
        return -1.0 if self.released or self.holds else -view.state[0] - ROUNDING

    def switch(self, view: View, progress: bool) -> None:
        self.holds = True


Element = Contact | MomentumEquation | Latch


class Twist:
    """The gate's torsion mode; its states, twist and twist rate, are the last two of the solution's."""

    def __init__(self, gate: Mapping[str, Any], inertia: float) -> None:
        self.stiffness: float = gate["torsional_stiffness"]
        self.damping: float = gate.get("torsional_damping", 0.0)
        self.inertia: float = gate.get("torsional_inertia") or inertia / 3.0
        self.half_width: float = gate.get("half_width", 0.5)


class Geometry:
    """Kinematics (3.19–3.20, 3.35–3.40), inertia (3.18) and weight (3.26) of the gate."""

    def __init__(self, gate: Mapping[str, Any]) -> None:
        hinge = complex(*gate["hinge"])
        body, arm, gravity = (complex(*gate[key]) - hinge for key in ("body_point", "gate_point", "gravity_point"))
        self.square_sum = abs(body) ** 2 + abs(arm) ** 2
        self.product = abs(body) * abs(arm)
        self.theta = math.atan2(arm.imag, arm.real) - math.atan2(body.imag, body.real)
        self.closed_length = self.length(0.0)
        self.open_travel = self.length(math.radians(gate["open_angle_deg"])) - self.closed_length
        self.weight_moment: float = gate["mass"] * GRAVITY * abs(gravity)
        self.weight_angle = math.atan2(gravity.imag, gravity.real)  # β − α_0
        plate = gate["mass"] * (gate["length"] ** 2 + gate["thickness"] ** 2) / 12
        self.inertia: float = gate.get("inertia", plate + gate["mass"] * abs(gravity) ** 2)
        self.twist = Twist(gate, self.inertia) if gate.get("torsional_stiffness") else None

    def length(self, angle: float) -> float:
        return math.sqrt(self.square_sum - 2 * self.product * math.cos(angle + self.theta))

    def view(self, time: float, state: Sequence[float]) -> View:
        middle = self.link(state[0], state[1])
        if self.twist is None:
            return View(time, state, middle, (middle, middle))
        psi, rate = state[-2:]
        left, right = (self.link(state[0] + side * psi, state[1] + side * rate) for side in (1.0, -1.0))
        return View(time, state, middle, (left, right))

    def link(self, angle: float, rate: float) -> Link:
        length = self.length(angle)
        arm = self.product * math.sin(angle + self.theta) / length
        return Link(length - self.closed_length, arm * rate, arm)

    def share(self, lateral: float) -> float:
        """Lateral position as a fraction y/w; 0 if the gate does not twist."""
        return 0.0 if self.twist is None else lateral / self.twist.half_width


class Thermal:
    """Thermal model of winding and housing as two bodies; off unless the vehicle file enables it."""

    def __init__(self, table: Mapping[str, Any]) -> None:
        self.enabled = table.get("enabled", 0.0) == 1.0
        self.to_housing: float = table.get("winding_resistance", 4.0)
        self.to_ambient: float = table.get("housing_resistance", 14.0)
        self.winding: float = table.get("winding_capacity", 4.0)
        self.housing: float = table.get("housing_capacity", 50.0)
        self.copper: float = table.get("copper_coefficient", 0.00393)
        self.magnet: float = table.get("magnet_coefficient", -0.001)

    def rates(self, warm: Sequence[float], loss: float, ambient: float) -> list[float]:
        """Rates [K/s] of the temperatures of winding and housing at a loss [W]."""
        inner = (warm[0] - warm[1]) / self.to_housing
        outer = (warm[1] - ambient) / self.to_ambient
        return [(loss - inner) / self.winding, (inner - outer) / self.housing]


class Drive:
    """One drive under one phase: winding, shaft, play and the spring with its stops.

    Its states are those from `first` on: current, speed, position, and both temperatures where it warms up.
    """

    def __init__(
        self,
        vehicle: Mapping[str, Any],
        first: int,
        open_travel: float,
        command: DriveInput,
        terminal: Law,
        side: int,
        ambient: float,
    ) -> None:
        motor, gear, spindle = vehicle["motor"], vehicle["gear"], vehicle["spindle"]
        spring, mechanism = vehicle["spring"], vehicle["mechanism"]
        self.first, self.side = first, side
        self.advance = advance(vehicle)
        self.lever = self.advance / (2 * math.pi)
        self.half_play: float = gear["backlash"] * spindle["lead"] / 2
        self.resistance: float = motor["resistance"]
        self.torque_constant: float = motor["torque_constant"]
        self.speed_constant: float = motor["speed_constant"]
        self.share, self.terminal = source_share(command), terminal
        self.volts = command.value if command.mode == "voltage" else 0.0
        self.thermal, self.ambient = Thermal(vehicle.get("thermal", {})), ambient
        self.stiffness: float = spring["stiffness"]
        self.closed_preload: float = spring["preload"] + self.stiffness * open_travel
        self.health: float = spring.get("health", 1.0)
        self.gas: float = spring.get("gas_force", 0.0) * (ambient + 273.15) / 293.15
        self.progression: float = spring.get("gas_progression", 1.3)
        self.stroke = open_travel

        flank = mechanism["stiffness"], mechanism["damping"]
        stop = spring["stop_stiffness"], spring["stop_damping"]
        self.upper = Contact(*flank, depth=lambda v: self._flank_depth(v, 1))
        self.lower = Contact(*flank, depth=lambda v: self._flank_depth(v, -1))
        self.open_stop = Contact(*stop, depth=lambda v: self._beyond(v, 1, open_travel))
        self.closed_stop = Contact(*stop, depth=lambda v: self._beyond(v, -1, 0.0))
        diodes = 2 * vehicle.get("bridge", {}).get("diode_drop", 0.7)
        decay = (lambda v: terminal(v) + diodes) if command.mode == "coast" else None
        self.coil = MomentumEquation(first, motor["inductance"], self._coil_load, decay)
        inertia = 2 * math.pi * (motor["rotor_inertia"] + gear["inertia"] / gear["ratio"] ** 2)
        losses = (  # τ_C (3.3, 3.8, 3.11)
            (1 - motor["efficiency"]) * motor["load_torque"]
            + (1 - gear["efficiency"]) * gear["friction_torque"] / gear["ratio"]
            + (1 - spindle["efficiency"]) * spindle["friction_force"] * self.lever
        )
        law = vehicle.get("friction", {})
        self.nominal = max(0.1, 1.0 + law.get("temperature_coefficient", 0.0) * (20.0 - ambient))
        self.table: Sequence[Sequence[float]] = law.get("position_table", [])
        self.losses = losses
        self.more_at_rest: float = law.get("static_ratio", 1.0) - 1.0
        self.stribeck_speed: float = law.get("stribeck_speed", 0.0)
        self.viscous: float = law.get("viscous", 0.0)
        self.by_load: float = spindle.get("load_friction", 0.0)
        none = losses == 0.0 and self.by_load == 0.0
        self.shaft = MomentumEquation(
            first + 1, inertia, self._shaft_load, None if none else self._kinetic, None if none else self._static
        )

    def _friction(self, v: View, more: float) -> float:
        """Dry friction of the shaft: its losses times 1 + `more`, plus the share of the load."""
        force = self.lever * abs(self.force(v)) if self.by_load else 0.0
        return self._here(v) * self.losses * (1.0 + more) + self.by_load * force

    def _here(self, v: View) -> float:
        """Factor of friction at this temperature and position, relative to the law at 20 °C."""
        if not self.table:
            return self.nominal
        shares, factors = zip(*self.table, strict=True)
        place = v.state[self.first + 2] * self.advance / self.stroke
        return self.nominal * float(np.interp(place, shares, factors))

    def _static(self, v: View) -> float:
        return self._friction(v, self.more_at_rest)

    def _kinetic(self, v: View) -> float:
        if not self.stribeck_speed:
            return self._friction(v, 0.0)
        ratio = v.state[self.first + 1] / self.stribeck_speed
        return self._friction(v, self.more_at_rest * math.exp(-ratio * ratio))

    def warm(self, v: View) -> Sequence[float]:
        """Temperatures of winding and housing, if the drive warms up."""
        return v.state[self.first + 3 : self.first + 5]

    def resistance_at(self, v: View) -> float:
        """Resistance of the winding at its temperature."""
        if not self.thermal.enabled:
            return self.resistance
        return self.resistance * (1.0 + self.thermal.copper * (self.warm(v)[0] - 20.0))

    def flux(self, v: View) -> float:
        """Flux relative to that at 20 °C."""
        if not self.thermal.enabled:
            return 1.0
        return 1.0 + self.thermal.magnet * (self.warm(v)[1] - 20.0)

    def warming(self, v: View) -> list[float]:
        """Rates [K/s] of the temperatures of winding and housing; [] without a thermal model."""
        if not self.thermal.enabled:
            return []
        loss = self.resistance_at(v) * v.state[self.first] ** 2
        return self.thermal.rates(self.warm(v), loss, self.ambient)

    def _flank_depth(self, v: View, side: int) -> tuple[float, float]:
        """How far x_d (3.5) is beyond the upper (1) or lower (−1) end of the play; its rate."""
        n, p, link = v.state[self.first + 1], v.state[self.first + 2], v.sides[self.side]
        x, rate = p * self.advance - link.travel, n * self.advance - link.travel_rate
        return side * x - self.half_play, side * rate

    def _beyond(self, v: View, way: int, end: float) -> tuple[float, float]:
        """Depth of the spindle beyond one end of its stroke, and its rate."""
        link = v.sides[self.side]
        return way * (link.travel - end), way * link.travel_rate

    def force(self, v: View) -> float:
        """F_d, the force of the drive on the gate (3.5)."""
        return self.upper.force(v) - self.lower.force(v)

    def spring_force(self, v: View) -> float:
        """F_F with the stops (3.12–3.14)."""
        travel = v.sides[self.side].travel
        spring = self.closed_preload - self.stiffness * travel
        if self.gas:  # a gas volume that the rod makes smaller, by 1/X over the stroke
            pressed = (self.stroke - travel) / self.stroke
            spring += self.gas / (1.0 - (1.0 - 1.0 / self.progression) * pressed)
        return self.health * spring - self.open_stop.force(v) + self.closed_stop.force(v)

    def moment(self, v: View) -> float:
        """Moment of drive, spring and stops about the hinge."""
        return v.sides[self.side].arm * (self.force(v) + self.spring_force(v))

    def _coil_load(self, v: View) -> float:
        """u − R i − c2Φ n (3.1)."""
        u = self.volts + (self.share * self.terminal(v) if self.share else 0.0)
        i, n = v.state[self.first], v.state[self.first + 1]
        return u - self.resistance_at(v) * i - self.speed_constant * self.flux(v) * n

    def _shaft_load(self, v: View) -> float:
        """Motor torque less the load of the gate (3.2)."""
        motor = self.torque_constant * self.flux(v) * v.state[self.first]
        viscous = self._here(v) * self.viscous * v.state[self.first + 1] if self.viscous else 0.0
        return motor - self.lever * self.force(v) - viscous


def advance(vehicle: Mapping[str, Any]) -> float:
    """Spindle travel per motor revolution [m/rev]."""
    return float(vehicle["spindle"]["lead"] / vehicle["gear"]["ratio"])


def source_share(command: DriveInput) -> float:
    """Share, with sign, of the terminal voltage and current that this bridge state passes on."""
    if command.mode not in ("open", "close", "brake", "coast", "voltage"):
        raise ValueError(f"unknown drive mode {command.mode!r}")
    return {"open": 1.0, "close": -1.0}.get(command.mode, 0.0) * command.value


def width_of(vehicle: Mapping[str, Any]) -> int:
    """Number of states of a drive."""
    return 5 if Thermal(vehicle.get("thermal", {})).enabled else 3


class StimulusPlan:
    """The whole plant under the inputs of one phase. State: φ, ω, then each drive's, then the twist's."""

    def __init__(
        self,
        common: Mapping[str, Any],
        sides: Sequence[Mapping[str, Any]],
        geometry: Geometry,
        phase: Phase,
        begin: float,
    ) -> None:
        seal, supply, slope = common["seal"], common["supply"], phase.slope_deg
        if slope is None:
            slope = common["environment"]["road_slope_deg"]
        self.geometry, self.phase = geometry, phase
        self.weight_angle = geometry.weight_angle + math.radians(slope)
        given = phase.supply_voltage
        self.source: float = supply["voltage"] if given is None else given
        self.begin = begin
        rise = 0.0 if phase.supply_end is None else phase.supply_end - self.source
        self.ramp: float = rise / (phase.end - begin)  # V/s
        around = common["environment"]
        ambient = phase.ambient
        if ambient is None:
            ambient = around.get("ambient_temperature_degc", 20.0)
        firsts = (2, 2 + width_of(sides[0]))
        drives = list(zip(firsts, sides, (phase.left, phase.right), strict=False))
        self.drops: list[tuple[float, int]] = [
            (supply["internal_resistance"] * source_share(command), first) for first, _, command in drives
        ]
        self.drives = [
            Drive(vehicle, first, geometry.open_travel, command, self.terminal, side, ambient)
            for side, (first, vehicle, command) in enumerate(drives)
        ]
        self.seal_arm: float = seal["arm"]
        thickness = seal["force"] / seal["stiffness"]
        self.seal = Contact(seal["stiffness"], 0.0, lambda v: (thickness - v.middle.travel, 0.0))
        friction: float = common["gate"].get("hinge_friction", 0.0)
        self.snow_distance: float = around.get("snow_distance", 0.5)
        self.snow_share = geometry.share(around.get("snow_lateral", 0.0))
        self.hand_share = geometry.share(around.get("hand_lateral", 0.0))
        self.hand_moment = phase.hand_force * around.get("hand_distance", 0.9)
        wind = around.get("wind_area", 1.0) * around.get("wind_lever", 0.5)
        self.steady = phase.external_torque + phase.wind_pressure * wind + self.hand_moment
        inertia = geometry.inertia + phase.snow_mass * self.snow_distance**2
        self.hinge = MomentumEquation(
            1, inertia, self._gate_moment, (lambda v: friction) if friction > 0 else None
        )
        self.latch = Latch(phase.released)
        rod = phase.obstacle
        self.obstacle = Contact(rod.stiffness, rod.damping, self._intrusion) if rod else None

        self.contacts = [self.seal] + ([self.obstacle] if self.obstacle else [])
        self.balances = [self.hinge]
        for drive in self.drives:
            self.contacts += [drive.upper, drive.lower, drive.open_stop, drive.closed_stop]
            self.balances += [drive.coil, drive.shaft]
        # contacts first: what a shaft does next depends on the forces they add
        self.elements: list[Element] = [self.latch, *self.contacts, *self.balances]

    def terminal(self, v: View) -> float:
        """U_terminal behind the source resistance; the currents are states, so it is exact."""
        source = self.source + self.ramp * (v.time - self.begin)
        return source - sum(share * v.state[first] for share, first in self.drops)

    def _intrusion(self, v: View) -> tuple[float, float]:
        o = self.phase.obstacle
        assert o is not None
        sign, share = -1.0 if o.closing else 1.0, self.geometry.share(o.lateral)
        angle, rate = v.state[0], v.state[1]
        if share:
            angle, rate = angle + share * v.state[-2], rate + share * v.state[-1]
        depth = sign * (angle - o.angle) * o.distance - o.gap
        return depth, sign * rate * o.distance

    def pinch(self, v: View) -> float:
        return self.obstacle.force(v) if self.obstacle else 0.0

    def _gate_moment(self, v: View) -> float:
        """All moments on the gate but the hinge friction (3.15–3.17)."""
        moment = self.steady + self.seal_arm * self.seal.force(v) - self._snow_moment(v)
        moment -= self.geometry.weight_moment * math.cos(v.state[0] + self.weight_angle)
        return moment + sum(drive.moment(v) for drive in self.drives) + self._pinch_moment(v)

    def _snow_moment(self, v: View) -> float:
        """Moment of the snow's weight, which lies on the line from the hinge to the centre of gravity."""
        if not self.phase.snow_mass:
            return 0.0
        angle = v.state[0] + (self.snow_share * v.state[-2] if self.snow_share else 0.0)
        weight = self.phase.snow_mass * GRAVITY
        return weight * self.snow_distance * math.cos(angle + self.weight_angle)

    def _pinch_moment(self, v: View) -> float:
        if not self.phase.obstacle:
            return 0.0
        lever = self.phase.obstacle.distance
        return self.pinch(v) * (lever if self.phase.obstacle.closing else -lever)

    def _twist_rates(self, v: View) -> list[float]:
        """Rates of the twist and of its rate."""
        twist = self.geometry.twist
        if twist is None:
            return []
        psi, rate = v.state[-2:]
        moment = -twist.stiffness * psi - twist.damping * rate
        for drive in self.drives:
            moment += drive.moment(v) if drive.side == 0 else -drive.moment(v)
        if self.phase.obstacle:
            share = self.geometry.share(self.phase.obstacle.lateral)
            moment += share * self._pinch_moment(v)
        moment += self.hand_share * self.hand_moment - self.snow_share * self._snow_moment(v)
        return [rate, moment / twist.inertia]

    def derivative(self, time: float, state: Sequence[float]) -> list[float]:
        v = self.geometry.view(time, state)
        rates = [0.0, 0.0] if self.latch.holds else [state[1], self.hinge.derivative(v)]
        for drive in self.drives:
            rates += [drive.coil.derivative(v), drive.shaft.derivative(v), state[drive.first + 1]]
            rates += drive.warming(v)
        return rates + self._twist_rates(v)

    def slope(self, time: float, y: np.ndarray) -> list[float]:
        """Right-hand side of the differential equation in the form that solve_ivp needs."""
        return self.derivative(time, y.tolist())

    def jacobian(self, time: float, y: np.ndarray) -> np.ndarray:
        """Jacobian by difference quotients; solve_ivp's own overflows where a frozen state has no influence."""
        state = y.tolist()
        base = np.array(self.derivative(time, state))
        result = np.empty((base.size, base.size))
        for k, value in enumerate(state):
            step = 1e-7 * (1 + abs(value))
            shifted = [*state[:k], value + step, *state[k + 1 :]]
            result[:, k] = (np.array(self.derivative(time, shifted)) - base) / step
        return result

    def start(self, state: list[float], latched: bool) -> None:
        """Determine the regime from the state alone, then settle what the state leaves open."""
        self.latch.holds = latched and not self.latch.released
        v = self.geometry.view(self.begin, state)
        for contact in self.contacts:
            contact.active = contact.reach(v) > 0
        for balance in self.balances:
            value = state[balance.index]
            balance.sign = (value > 0) - (value < 0)
        self.settle(self.begin, state, [], True)

    def settle(self, time: float, state: list[float], fired: list[Element], progress: bool) -> None:
        """Switch the element whose event occurred, then those that it affects, each at most once (so it ends).

        The others are judged a moment ahead: just at a boundary their sign now is rounding noise.
        """
        self._switch(time, state, fired, progress)
        done = list(fired)
        while more := self._due(time, state, done):
            self._switch(time, state, more, True)
            done += more

    def _due(self, time: float, state: list[float], done: list[Element]) -> list[Element]:
        rates = self.derivative(time, state)
        ahead = [y + LOOK_AHEAD * rate for y, rate in zip(state, rates, strict=True)]
        v = self.geometry.view(time + LOOK_AHEAD, ahead)
        return [e for e in self.elements if e not in done and e.alarm(v) > 0]

    def _switch(self, time: float, state: list[float], elements: list[Element], progress: bool) -> None:
        for element in elements:
            if isinstance(element, MomentumEquation):
                state[element.index] = 0.0
            elif isinstance(element, Latch):
                state[:2] = [0.0, 0.0]
        v = self.geometry.view(time, state)
        for element in elements:
            element.switch(v, progress)

    def alarms(self, start: float) -> list[Callable[[float, np.ndarray], float]]:
        """Terminal events for solve_ivp, which asks all of them about one array; none has risen at the start."""
        last: tuple[float, np.ndarray | None, View | None] = (math.nan, None, None)

        def view(t: float, y: np.ndarray) -> View:
            nonlocal last
            if last[0] != t or last[1] is not y or last[2] is None:
                last = (t, y, self.geometry.view(t, y.tolist()))
            assert last[2] is not None
            return last[2]

        def alarm_of(element: Element) -> Callable[[float, np.ndarray], float]:
            def event(t: float, y: np.ndarray) -> float:
                value = element.alarm(view(t, y))
                return value if t > start else min(value, -1e-300)

            event.terminal, event.direction = True, 1.0  # type: ignore[attr-defined]
            return event

        return [alarm_of(element) for element in self.elements]

    def held(self, state: Sequence[float]) -> list[int]:
        """Indices of states that stay constant until the regime changes; the solver's rounding would move them."""
        found = [1] if self.latch.holds or self.hinge.is_held else []
        for drive in self.drives:
            found += [each.index for each in (drive.coil, drive.shaft) if each.is_held]
        at_rest = [rate for rate in found if state[rate] == 0.0]
        integrals = {1: 0, **{drive.first + 1: drive.first + 2 for drive in self.drives}}
        return found + [integrals[rate] for rate in at_rest if rate in integrals]

    def outputs(self, time: float, state: Sequence[float]) -> list[float]:
        """Forces of both drives, pinch force and terminal voltage."""
        v = self.geometry.view(time, state)
        forces = [drive.force(v) for drive in self.drives] + [0.0]
        return [*forces[:2], max(0.0, self.pinch(v)), self.terminal(v)]


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with the tables of `over` laid over it, key by key."""
    result = dict(base)
    for key, value in over.items():
        result[key] = merged(base.get(key, {}), value) if isinstance(value, Mapping) else value
    return result


def _vehicle_off(vehicle: Mapping[str, Any]) -> Mapping[str, Any]:
    """Vehicle with disturbed last bits if LAST_BITS is set: of integers too, but for counts."""

    def numbers(table: Mapping[str, Any]) -> dict[str, Any]:
        return {
            key: numbers(each)
            if isinstance(each, Mapping)
            else float(each)
            if type(each) is int and key != "drives"
            else each
            for key, each in table.items()
        }

    return last_bits.off(numbers(vehicle), "file")


def _phases_off(phases: Sequence[Phase]) -> list[Phase]:
    """Phases with disturbed last bits if LAST_BITS is set; end times and equal values stay equal."""
    return [
        replace(
            last_bits.off(each, "phase"),
            end=each.end,
            left=last_bits.off(each.left, "command"),
            right=last_bits.off(each.right, "command"),
        )
        for each in phases
    ]


def solve(
    vehicle: Mapping[str, Any],
    phases: Sequence[Phase],
    sample_times: np.ndarray,
    initial_angle: float = 0.0,
    tolerance: float = 1e-10,
    latched: bool = False,
) -> Solution:
    """Solve the plant through the phases from rest at `initial_angle`, drives amid their play, all as warm as the
    surroundings.

    `vehicle` has the tables of a vehicle file; `left` and `right` in it may hold tables of one
    drive (motor, gear, spindle, spring, mechanism, friction, bridge, thermal) that differ from the common ones.
    With one drive it is the left one and the right columns stay zero.
    """
    vehicle, phases = _vehicle_off(vehicle), _phases_off(phases)
    initial_angle = last_bits.off(initial_angle, "angle")
    times = np.asarray(sample_times, dtype=float)
    if times.size and (np.any(np.diff(times) < 0) or times[0] < 0 or times[-1] > phases[-1].end):
        raise ValueError("sample times must ascend from 0 to the end of the last phase")
    ends = [phase.end for phase in phases]
    if ends != sorted(ends):
        raise ValueError("the phases must end one after the other")
    names = ("left", "right")[: vehicle.get("drives", 2)]
    sides = [merged(vehicle, vehicle.get(name, {})) for name in names]
    geometry = Geometry(vehicle["gate"])
    travel = geometry.length(initial_angle) - geometry.closed_length
    state = [initial_angle, 0.0]
    ambient = vehicle["environment"].get("ambient_temperature_degc", 20.0)
    widths = [width_of(side) for side in sides]
    for side, width in zip(sides, widths, strict=True):
        state += [0.0, 0.0, travel / advance(side), ambient, ambient][:width]
    state += [0.0, 0.0] if geometry.twist else []
    # Where each of them stands among φ, ω, both drives' five, ψ and its rate.
    places = [0, 1]
    for side, width in enumerate(widths):
        places += range(2 + 5 * side, 2 + 5 * side + width)
    places += [12, 13] if geometry.twist else []

    states = np.zeros((times.size, 14))
    states[:, [5, 6, 10, 11]] = ambient
    outputs = np.zeros((times.size, 4))
    now, events = 0.0, 0
    for phase in phases:
        changed = merged(vehicle, phase.changes)
        sides = [merged(changed, changed.get(name, {})) for name in names]
        stimuli = StimulusPlan(changed, sides, Geometry(changed["gate"]), phase, now)
        stimuli.start(state, latched)
        while now < phase.end:
            piece = solve_ivp(
                stimuli.slope,
                (now, phase.end),
                np.array(state),
                method=SmallRadau,
                jac=stimuli.jacobian,
                dense_output=True,
                events=stimuli.alarms(now),
                rtol=tolerance,
                atol=tolerance,
                max_step=MAX_STEP,
            )
            if not (piece.success and np.isfinite(piece.y).all()):
                raise RuntimeError(f"integration failed at {piece.t[-1]} s: {piece.message}")
            reached, held = float(piece.t[-1]), stimuli.held(state)
            last = phase is phases[-1] and reached >= phase.end
            chosen = (times >= now) & ((times <= reached) if last else (times < reached))
            if chosen.any():
                rows = piece.sol(times[chosen]).T
                rows[:, held] = [state[k] for k in held]
                states[np.ix_(chosen, places)] = rows
                outputs[chosen] = [
                    stimuli.outputs(time, row)
                    for time, row in zip(times[chosen].tolist(), rows.tolist(), strict=True)
                ]
            kept = {k: state[k] for k in held}
            state = [kept.get(k, value) for k, value in enumerate(piece.y[:, -1].tolist())]
            if piece.status == 1:
                events += 1
                if events > MAX_EVENTS:
                    raise RuntimeError(f"more than {MAX_EVENTS} events, the last at {reached} s")
                due = [e for e, t in zip(stimuli.elements, piece.t_events, strict=True) if t.size]
                stimuli.settle(reached, state, due, reached - now > NO_PROGRESS)
            now = reached
        latched = stimuli.latch.holds
    names = ("current", "speed", "position", "winding_temperature", "housing_temperature")
    columns = ("angle", "rate", *(f"{side}_{name}" for side in ("left", "right") for name in names))
    found = zip((*columns, "twist", "twist_rate"), states.T, strict=True)
    forces = zip(("left_force", "right_force", "pinch_force", "terminal_voltage"), outputs.T, strict=True)
    return Solution(time=times, events=events, **dict(found), **dict(forces))
