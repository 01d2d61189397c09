"""What a rig can wire to a bus: names, units and what values are allowed.

The unit is that of our own DBC; a rig's `scale` and `offset` bring another database's value to it.
"""

from __future__ import annotations

from typing import NamedTuple


class BusQuantity(NamedTuple):
    """One quantity on the bus: its unit, and the values that the emulator accepts for an input."""

    unit: str
    low: float
    high: float
    meaning: str
    names: tuple[str, ...] = ()  # of the values 0, 1, 2 … where it is an enumeration


DIRECTIONS = ("coast", "open", "close", "brake")
LATCH_COMMANDS = ("hold", "release")
LATCH_STATES = ("open", "latched")
EMULATOR_STATES = ("waiting", "running", "timeout", "stopped")

_ANY = 1e300

INPUTS: dict[str, BusQuantity] = {
    "left_duty": BusQuantity("%", -100.0, 100.0, "PWM duty; signed where no direction is mapped"),
    "right_duty": BusQuantity("%", -100.0, 100.0, "PWM duty; signed where no direction is mapped"),
    "left_direction": BusQuantity("", 0.0, 3.0, "bridge state", DIRECTIONS),
    "right_direction": BusQuantity("", 0.0, 3.0, "bridge state", DIRECTIONS),
    "latch_release": BusQuantity("", 0.0, 1.0, "drives the latch open", LATCH_COMMANDS),
    "obstacle_angle": BusQuantity(
        "deg", -10.0, 180.0, "where the gate meets the obstacle, closing"
    ),
    "obstacle_rate": BusQuantity("N/mm", 0.0, 1e4, "the obstacle's spring rate; 0 is no obstacle"),
    "road_slope": BusQuantity("deg", -45.0, 45.0, "positive with the rear raised"),
    "supply_voltage": BusQuantity("V", 0.0, 60.0, "of the source, open-circuit"),
    "hand_force": BusQuantity("N", -5e3, 5e3, "positive opens"),
}

# The inputs that a test bench's panel moves, not the ECU.
PANEL = ("obstacle_angle", "obstacle_rate", "road_slope", "supply_voltage", "hand_force")

OUTPUTS: dict[str, BusQuantity] = {
    "left_current": BusQuantity("A", -_ANY, _ANY, "motor current"),
    "right_current": BusQuantity("A", -_ANY, _ANY, "motor current"),
    "left_hall_count": BusQuantity("", -_ANY, _ANY, "signed count"),
    "right_hall_count": BusQuantity("", -_ANY, _ANY, "signed count"),
    "left_hall_speed": BusQuantity("", -_ANY, _ANY, "counts in one sample period"),
    "right_hall_speed": BusQuantity("", -_ANY, _ANY, "counts in one sample period"),
    "gate_angle": BusQuantity("deg", -_ANY, _ANY, "potentiometer on the hinge"),
    "latch_state": BusQuantity("", 0.0, 1.0, "latch switch", LATCH_STATES),
    "terminal_voltage": BusQuantity("V", -_ANY, _ANY, "at the bridges"),
    "ambient_temperature": BusQuantity("°C", -_ANY, _ANY, "thermometer"),
    "left_motor_temperature": BusQuantity("°C", -_ANY, _ANY, "winding"),
    "right_motor_temperature": BusQuantity("°C", -_ANY, _ANY, "winding"),
    "road_slope": BusQuantity("deg", -_ANY, _ANY, "accelerometer in the body"),
    "gate_acceleration": BusQuantity("m/s²", -_ANY, _ANY, "accelerometer on the gate"),
    "pinch_force": BusQuantity("N", -_ANY, _ANY, "on the obstacle"),
    "tick_overruns": BusQuantity("", -_ANY, _ANY, "periods skipped"),
    "command_timeouts": BusQuantity("", -_ANY, _ANY, "times the command went stale"),
    "rejected_frames": BusQuantity("", -_ANY, _ANY, "frames of ours that were refused"),
    "emulator_state": BusQuantity("", 0.0, 3.0, "of this program", EMULATOR_STATES),
    "lateness_p50": BusQuantity("µs", -_ANY, _ANY, "median lateness of a tick"),
    "lateness_p99": BusQuantity("µs", -_ANY, _ANY, "99 % of the ticks are not later"),
    "lateness_p999": BusQuantity("µs", -_ANY, _ANY, "99.9 % of the ticks are not later"),
    "lateness_max": BusQuantity("µs", -_ANY, _ANY, "of the latest tick"),
    "execution_p50": BusQuantity("µs", -_ANY, _ANY, "median time that a tick takes"),
    "execution_max": BusQuantity("µs", -_ANY, _ANY, "of the longest tick"),
    "command_delay_p50": BusQuantity("µs", -_ANY, _ANY, "from command to feedback, median"),
    "command_delay_max": BusQuantity("µs", -_ANY, _ANY, "from command to feedback, longest"),
    "command_delay_force": BusQuantity("N", -_ANY, _ANY, "what that is on the 10 N/mm rod"),
    "left_hall_a": BusQuantity("", 0.0, 1.0, "square wave; leads B while opening"),
    "left_hall_b": BusQuantity("", 0.0, 1.0, "square wave"),
    "right_hall_a": BusQuantity("", 0.0, 1.0, "square wave; leads B while opening"),
    "right_hall_b": BusQuantity("", 0.0, 1.0, "square wave"),
}

# The outputs that tell how well the loop keeps time; not there (NaN) on a clock that is not real time.
TIMING = tuple(
    name for name in OUTPUTS if name.startswith(("lateness_", "execution_", "command_delay_"))
)

INPUT_INDEX = {name: index for index, name in enumerate(INPUTS)}
OUTPUT_INDEX = {name: index for index, name in enumerate(OUTPUTS)}
