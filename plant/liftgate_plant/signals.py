"""Catalogue of the physical quantities: unit, range, meaning, and the rows that hold them.

A row is a NamedTuple whose fields are the columns of files: name and unit (`left_current_a`). Each field names its
`Signal`, so that everything that reads or writes rows (recordings, `simulate`, measured files, profiles, signals
on a bus) takes names, units and ranges from here. Code fills rows by keyword and never by position.

Positive opens: voltage, current, speed, position, force and torque alike.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, get_type_hints

from liftgate_compiler import compilable
from liftgate_plant.quantity import Quantity

# Suffix that a unit adds to a column's name.
SUFFIXES: Mapping[str, str] = {
    "s": "_s",
    "V": "_v",
    "A": "_a",
    "rev/s": "_rps",
    "rev": "_rev",
    "N": "_n",
    "N m": "_nm",
    "N s": "_ns",
    "deg": "_deg",
    "deg/s": "_degps",
    "°C": "_degc",
    "Pa": "_pa",
    "kg": "_kg",
    "m/s²": "_mps2",
    "m": "_m",
    "": "",
}


class Signal(NamedTuple):
    """Quantity over time; `low`, `high` are inclusive; `values` name 0, 1, … of an enumeration."""

    unit: str
    low: float
    high: float
    meaning: str
    values: tuple[str, ...] = ()
    bus_name: str = ""  # name in a rig file, if not the column's name without its unit
    is_whole: bool = False  # a count or a state: written without a decimal point

    @property
    def suffix(self) -> str:
        """Suffix of a column's name that states the unit."""
        return SUFFIXES[self.unit]

    def parameter(self, symbol: str) -> Quantity:
        """Return the signal as a Quantity, a key of the vehicle file that holds unless overridden in a run."""
        return Quantity(symbol, self.unit, self.low, self.high, self.meaning)


SIDES = ("left", "right")  # of the drives
LATCH_STATES = ("open", "latched")
LATCH_POSITIONS = ("open", "half", "full")
SWITCH = ("off", "on")

TIME = Signal("s", 0.0, 1e9, "model time")
MOTOR_VOLTAGE = Signal("V", -1e3, 1e3, "voltage on the motor's terminals")
CURRENT = Signal("A", -1e4, 1e4, "motor current")
CURRENT_RMS = Signal("A", 0.0, 1e4, "root mean square of the motor current over the step")
CURRENT_PEAK = Signal("A", -1e4, 1e4, "motor current furthest from zero during the step, PWM ripple included")
SPEED = Signal("rev/s", -1e5, 1e5, "motor speed")
POSITION = Signal("rev", -1e9, 1e9, "motor position")
HALL_COUNT = Signal("", -1e12, 1e12, "signed count of the Hall edges", is_whole=True)
HALL_SPEED = Signal("", -1e6, 1e6, "counts in the last sample period", is_whole=True)
EDGE_COUNT = Signal("", 0.0, 1e12, "number of edges of Hall A and B so far", is_whole=True)
EDGE_AGE = Signal("s", 0.0, 1e9, "time since the last edge; before the first one, since the start")
PERIOD = Signal("s", 0.0, 1e9, "duration of the last full electrical turn, four edges; 0: none yet")
PERIOD_SPEED = Signal(
    "rev/s", -1e5, 1e5, "motor speed by the last period, or by the time since the last edge if longer"
)
HALL_A = Signal("", 0.0, 1.0, "square wave of Hall A; leads B while opening", is_whole=True)
HALL_B = Signal("", 0.0, 1.0, "square wave of Hall B", is_whole=True)
DRIVE_FORCE = Signal("N", -1e7, 1e7, "force of the drive on the gate")
DUTY = Signal("", -1.0, 1.0, "signed share of the terminal voltage")
COAST = Signal("", 0.0, 1.0, "1: all switches of the bridge are off", is_whole=True)
GATE_ANGLE = Signal("deg", -360.0, 360.0, "angle of the gate, 0 is closed")
GATE_RATE = Signal("deg/s", -1e6, 1e6, "angular velocity of the gate")
GATE_TWIST = Signal("deg", -90.0, 90.0, "twist of the gate's left side against its middle, positive opens")
GATE_ACCELERATION = Signal("m/s²", -1e6, 1e6, "accelerometer on the gate, gravity included")
PINCH_FORCE = Signal("N", 0.0, 1e7, "force on the obstacle")
PINCH_PEAK = Signal("N", 0.0, 1e7, "largest pinch force of the last contact so far")
PINCH_IMPULSE = Signal("N s", 0.0, 1e9, "impulse of the last contact so far")
PINCH_OVER_LIMIT = Signal("s", 0.0, 1e9, "time of the last contact above gate.pinch_limit")
PINCH_CONTACT = Signal(
    "s", 0.0, 1e9, "model time at which the last contact began; 0: none yet", (), "pinch_contact_time"
)
PINCH_CONTACT_ANGLE = Signal(
    "deg", -360.0, 360.0, "gate angle at which the last contact began", (), "pinch_contact_angle"
)
TERMINAL_VOLTAGE = Signal("V", -1e3, 1e3, "voltage at the bridges")
LATCHED = Signal("", 0.0, 1.0, "state of the latch", LATCH_STATES, "latch_state", is_whole=True)
LATCH_RELEASED = Signal("", 0.0, 1.0, "latch driven open", is_whole=True)
LATCH_CINCHED = Signal("", 0.0, 1.0, "cinching motor driven", is_whole=True)
LATCH_POSITION = Signal(
    "", 0.0, 2.0, "position in which the latch's pawl holds its claw", LATCH_POSITIONS, is_whole=True
)
LATCH_FORCE = Signal("N", 0.0, 1e7, "force of the latch's hook on the striker")
LATCH_PULL = Signal("m", 0.0, 1.0, "travel of the cinching motor from its home, at the striker")
LATCH_HALF = Signal("", 0.0, 1.0, "switch of the latch: half or fully closed", SWITCH, is_whole=True)
LATCH_HOME = Signal("", 0.0, 1.0, "switch of the cinching motor: at home", SWITCH, is_whole=True)
PINCH_STRIP = Signal("", 0.0, 1.0, "contact strip on this side of the gate", SWITCH, is_whole=True)
HANDLE = Signal("", 0.0, 1.0, "the gate's outer handle is pulled", SWITCH, is_whole=True)
BUTTON = Signal("", 0.0, 1.0, "the gate's button is pressed", SWITCH, is_whole=True)
# 60 V: no low-voltage supply of a road vehicle exceeds it (voltage class A of ISO 6469-3).
SUPPLY_VOLTAGE = Signal("V", 0.0, 60.0, "open-circuit voltage of the source")
ROAD_SLOPE = Signal("deg", -45.0, 45.0, "slope of the road, positive with the rear of the car raised")
AMBIENT_TEMPERATURE = Signal("°C", -55.0, 130.0, "temperature of the surroundings")
WINDING_TEMPERATURE = Signal("°C", -60.0, 2000.0, "temperature of the motor winding")
CUTOUT_TEMPERATURE = Signal("°C", -60.0, 2000.0, "temperature of the thermal cut-out in the motor's line")
CLUTCH_SLIP = Signal("m", -1e3, 1e3, "total slip of the slip clutch, along the spindle")
HOUSING_TEMPERATURE = Signal("°C", -60.0, 2000.0, "temperature of the motor housing")
WIND_PRESSURE = Signal("Pa", -5e3, 5e3, "dynamic pressure of the wind, positive opens")
SNOW_MASS = Signal("kg", 0.0, 500.0, "mass of the snow on the gate")
HAND_FORCE = Signal("N", -5e3, 5e3, "force of a hand on the gate, positive opens")
EXTERNAL_TORQUE = Signal("N m", -5e3, 5e3, "external torque on the gate, positive opens")


class Drives(NamedTuple):
    """Motor inputs of runs without an ECU: of `simulate`, measured, or of identification."""

    left_voltage_v: Annotated[float, MOTOR_VOLTAGE]
    right_voltage_v: Annotated[float, MOTOR_VOLTAGE]
    left_duty: Annotated[float, DUTY]
    right_duty: Annotated[float, DUTY]
    left_coast: Annotated[float, COAST]
    right_coast: Annotated[float, COAST]


class Surroundings(NamedTuple):
    """Effects of the surroundings on the gate; NaN: not specified.

    Each may come from a profile, a panel or an input file.
    """

    supply_voltage_v: Annotated[float, SUPPLY_VOLTAGE]
    road_slope_deg: Annotated[float, ROAD_SLOPE]
    ambient_temperature_degc: Annotated[float, AMBIENT_TEMPERATURE]
    wind_pressure_pa: Annotated[float, WIND_PRESSURE]
    snow_mass_kg: Annotated[float, SNOW_MASS]
    hand_force_n: Annotated[float, HAND_FORCE]
    external_torque_nm: Annotated[float, EXTERNAL_TORQUE]
    handle_pulled: Annotated[float, HANDLE]
    button_pressed: Annotated[float, BUTTON]


@compilable
def switched(is_on: bool) -> float:
    """Return a switch's value in a row: 1.0 on, 0.0 off."""
    return 1.0 if is_on else 0.0


NO_PROFILE_VALUES = Surroundings(**dict.fromkeys(Surroundings._fields, math.nan))


class Truth(NamedTuple):
    """True values at the end of a step, with the inputs that led to them."""

    time_s: Annotated[float, TIME]
    left_voltage_v: Annotated[float, MOTOR_VOLTAGE]
    left_current_a: Annotated[float, CURRENT]
    left_speed_rps: Annotated[float, SPEED]
    left_position_rev: Annotated[float, POSITION]
    left_hall_count: Annotated[float, HALL_COUNT]
    left_force_n: Annotated[float, DRIVE_FORCE]
    right_voltage_v: Annotated[float, MOTOR_VOLTAGE]
    right_current_a: Annotated[float, CURRENT]
    right_speed_rps: Annotated[float, SPEED]
    right_position_rev: Annotated[float, POSITION]
    right_hall_count: Annotated[float, HALL_COUNT]
    right_force_n: Annotated[float, DRIVE_FORCE]
    gate_angle_deg: Annotated[float, GATE_ANGLE]
    gate_rate_degps: Annotated[float, GATE_RATE]
    pinch_force_n: Annotated[float, PINCH_FORCE]
    terminal_voltage_v: Annotated[float, TERMINAL_VOLTAGE]
    left_duty: Annotated[float, DUTY]
    right_duty: Annotated[float, DUTY]
    left_coast: Annotated[float, COAST]
    right_coast: Annotated[float, COAST]
    latched: Annotated[float, LATCHED]
    supply_voltage_v: Annotated[float, SUPPLY_VOLTAGE]
    road_slope_deg: Annotated[float, ROAD_SLOPE]
    ambient_temperature_degc: Annotated[float, AMBIENT_TEMPERATURE]
    wind_pressure_pa: Annotated[float, WIND_PRESSURE]
    snow_mass_kg: Annotated[float, SNOW_MASS]
    hand_force_n: Annotated[float, HAND_FORCE]
    external_torque_nm: Annotated[float, EXTERNAL_TORQUE]
    handle_pulled: Annotated[float, HANDLE]
    button_pressed: Annotated[float, BUTTON]
    left_winding_temperature_degc: Annotated[float, WINDING_TEMPERATURE]
    right_winding_temperature_degc: Annotated[float, WINDING_TEMPERATURE]
    left_housing_temperature_degc: Annotated[float, HOUSING_TEMPERATURE]
    right_housing_temperature_degc: Annotated[float, HOUSING_TEMPERATURE]
    pinch_force_peak_n: Annotated[float, PINCH_PEAK]
    pinch_impulse_ns: Annotated[float, PINCH_IMPULSE]
    pinch_over_limit_s: Annotated[float, PINCH_OVER_LIMIT]
    pinch_contact_s: Annotated[float, PINCH_CONTACT]
    pinch_contact_deg: Annotated[float, PINCH_CONTACT_ANGLE]
    gate_twist_deg: Annotated[float, GATE_TWIST]
    left_current_rms_a: Annotated[float, CURRENT_RMS]
    right_current_rms_a: Annotated[float, CURRENT_RMS]
    left_current_peak_a: Annotated[float, CURRENT_PEAK]
    right_current_peak_a: Annotated[float, CURRENT_PEAK]
    left_cutout_temperature_degc: Annotated[float, CUTOUT_TEMPERATURE]
    right_cutout_temperature_degc: Annotated[float, CUTOUT_TEMPERATURE]
    left_clutch_slip_m: Annotated[float, CLUTCH_SLIP]
    right_clutch_slip_m: Annotated[float, CLUTCH_SLIP]
    latch_position: Annotated[float, LATCH_POSITION]
    latch_force_n: Annotated[float, LATCH_FORCE]
    latch_pull_m: Annotated[float, LATCH_PULL]


class Sensed(NamedTuple):
    """Sensor readings of the true values: all that the ECU can know."""

    left_current_a: Annotated[float, CURRENT]
    right_current_a: Annotated[float, CURRENT]
    left_hall_a: Annotated[float, HALL_A]
    left_hall_b: Annotated[float, HALL_B]
    right_hall_a: Annotated[float, HALL_A]
    right_hall_b: Annotated[float, HALL_B]
    left_hall_count: Annotated[float, HALL_COUNT]
    right_hall_count: Annotated[float, HALL_COUNT]
    left_hall_speed: Annotated[float, HALL_SPEED]
    right_hall_speed: Annotated[float, HALL_SPEED]
    left_edge_count: Annotated[float, EDGE_COUNT]
    right_edge_count: Annotated[float, EDGE_COUNT]
    left_edge_age_s: Annotated[float, EDGE_AGE]
    right_edge_age_s: Annotated[float, EDGE_AGE]
    left_period_s: Annotated[float, PERIOD]
    right_period_s: Annotated[float, PERIOD]
    left_period_speed_rps: Annotated[float, PERIOD_SPEED]
    right_period_speed_rps: Annotated[float, PERIOD_SPEED]
    gate_angle_deg: Annotated[float, GATE_ANGLE]
    latched: Annotated[float, LATCHED]
    terminal_voltage_v: Annotated[float, TERMINAL_VOLTAGE]
    ambient_temperature_degc: Annotated[float, AMBIENT_TEMPERATURE]
    left_winding_temperature_degc: Annotated[
        float, WINDING_TEMPERATURE._replace(bus_name="left_motor_temperature")
    ]
    right_winding_temperature_degc: Annotated[
        float, WINDING_TEMPERATURE._replace(bus_name="right_motor_temperature")
    ]
    left_housing_temperature_degc: Annotated[float, HOUSING_TEMPERATURE]
    right_housing_temperature_degc: Annotated[float, HOUSING_TEMPERATURE]
    road_slope_deg: Annotated[float, ROAD_SLOPE]
    gate_acceleration_mps2: Annotated[float, GATE_ACCELERATION]
    latch_half: Annotated[float, LATCH_HALF]
    latch_home: Annotated[float, LATCH_HOME]
    left_pinch_strip: Annotated[float, PINCH_STRIP]
    right_pinch_strip: Annotated[float, PINCH_STRIP]
    handle_pulled: Annotated[float, HANDLE]
    button_pressed: Annotated[float, BUTTON]


def signals_of(row: type[Any]) -> dict[str, Signal]:
    """Return the signals of a row's type by column, in order."""
    hints = get_type_hints(row, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items()}


def bus_name(column: str, signal: Signal) -> str:
    """Return a column's name as quantity of a rig file: without its unit, or the signal's own bus name."""
    return signal.bus_name or column.removesuffix(signal.suffix)
