"""Tests of an ECU against the emulated gate; `pytest` runs them, and test_reverses.toml beside them.

The other files here are copies, free to be changed: what the gate is (vehicle.toml), how it is wired (rig.toml,
liftgate.dbc), what happens to it (scenario.toml). No bus and no hardware is needed. What closes the loop is the
reference ECU, or what `--liftgate-ecu` names: the path of a C library, or "module:Class" of a Python object.
"""

from pathlib import Path

HERE = Path(__file__).parent
CAR = {"vehicle": HERE / "vehicle.toml", "rig": HERE / "rig.toml"}


def test_the_ecu_opens_the_gate_and_reverses_on_a_rod(liftgate):
    """The rod has 10 N/mm: a force of 200 N is a way of 20 mm."""
    result = liftgate.run(HERE / "scenario.toml", **CAR)
    assert result.verdict == "pass", result.reason  # nothing crashed, and all that the scenario expects came
    assert result.maxima["gate_angle_deg"] > 78.0
    assert 0.0 < result.maxima["pinch_force_n"] < 200.0


def test_a_gate_without_its_springs_is_heavier(liftgate):
    """Without an ECU: the test itself commands the motors, breaks something, and looks at what that does."""
    gate = liftgate.gate(initial=40, **CAR)
    gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
    gate.step(0.5)
    with_springs = gate.sensed["left_current_a"]
    gate.fault("spring_lost", where="both")
    gate.step(0.5)
    assert gate.sensed["left_current_a"] > with_springs + 1.0
