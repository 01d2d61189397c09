"""What is shown of a tick: the row of a recording, of a plot, of a page. All fields are floats, so that a row
of an array holds them.
"""

from __future__ import annotations

from typing import NamedTuple


class Snapshot(NamedTuple):
    """The names are the columns of a recording, with their units."""

    time_s: float
    left_voltage_v: float
    left_current_a: float
    left_speed_rps: float
    left_position_rev: float
    left_hall_count: float
    left_force_n: float
    right_voltage_v: float
    right_current_a: float
    right_speed_rps: float
    right_position_rev: float
    right_hall_count: float
    right_force_n: float
    gate_angle_deg: float
    gate_rate_degps: float
    pinch_force_n: float
    terminal_voltage_v: float
    left_duty: float
    right_duty: float
    left_coast: float
    right_coast: float
    latched: float
    supply_voltage_v: float
    road_slope_deg: float
    hand_force_n: float
    left_winding_temperature_degc: float
    right_winding_temperature_degc: float


# Columns that hold whole numbers, written as such.
WHOLE = ("left_hall_count", "right_hall_count", "left_coast", "right_coast", "latched")
