"""Tests of an ECU against the emulated gate; `pytest` runs them.

The files beside this one are copies, free to be changed: what the gate is (vehicle.toml), how it is wired
(rig.toml, liftgate.dbc) and what happens to it (scenario.toml). No bus and no hardware is needed.
"""

from pathlib import Path

import pytest

import liftgate_hil as lh

HERE = Path(__file__).parent
VEHICLE = HERE / "vehicle.toml"
RIG = HERE / "rig.toml"

# What closes the loop: the reference ECU, the path of a C library, "module:Class" of a Python object, or one.
ECU = "reference"


@pytest.fixture(scope="module")
def result():
    """The scenario, gone through once: open, close onto a rod, reverse, open, close."""
    return lh.run(HERE / "scenario.toml", ecu=ECU, clock="free", vehicle=VEHICLE, rig=RIG)


def test_the_gate_opens_fully(result):
    """Driven by the ECU, from closed and latched."""
    assert result.maxima["gate_angle_deg"] > 78.0


def test_the_ecu_reverses_before_the_rod_is_pressed_hard(result):
    """The rod has 10 N/mm: a force of 200 N is a way of 20 mm."""
    assert 0.0 < result.maxima["pinch_force_n"] < 200.0


def test_the_gate_opens_while_it_is_driven():
    """Without an ECU: the test itself commands the motors and looks at what they do."""
    with lh.Gate(vehicle=VEHICLE, rig=RIG, initial="closed", seed=1) as gate:
        gate.step(0.1)
        assert gate.truth["gate_angle_deg"] == pytest.approx(0.0, abs=0.1)

        gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
        gate.step(2.0)
        assert gate.truth["gate_angle_deg"] > 10.0
        assert gate.sensed["left_current_a"] > 0.0
        assert gate.truth["gate_rate_degps"] > 0.0
