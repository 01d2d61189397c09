"""Notes on vehicle values that are allowed but implausible for a power lift gate, such as a wrong unit."""

from __future__ import annotations

from pathlib import Path

import pytest
from hil_support import text_file

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.config.plausibility import notes_on_vehicle
from liftgate_hil.plan.setup import vehicle_from

SHIPPED = ("suv", "compact", "heavy-suv")


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_vehicles_and_their_drawn_cars_are_plausible(name: str) -> None:
    assert notes_on_vehicle(vehicle_from(name, ideal=True)) == []
    assert [notes_on_vehicle(vehicle_from(name, draw=draw)) for draw in range(10)] == [[]] * 10


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("motor.torque_constant=3.4e-5", "motor.torque_constant is 0.28 % of motor.speed_constant/2π"),
        ("motor.speed_constant=3.6", "would travel from end to end in"),
        ("motor.inductance=0.25", "are they in H and ohm?"),
        ("motor.resistance=545", "motor.resistance lets 0.022 A through a stalled motor"),
        ("motor.rotor_inertia=0.28", "is motor.rotor_inertia in kg m²?"),
        ("gear.backlash=0.9", "gear.backlash is 0.9 of a revolution"),
        ("spindle.lead=0.12", "spindle.lead (m/rev) right?"),
        ("spring.stiffness=1.1", "spring.stiffness changes the spring's force by 0.28 N over its travel"),
        ("spring.stiffness=1.1e5", "the springs carry 4.1e+03 % of the gate's weight"),
        ("spring.preload=0.3", "spring.preload is 0.3 N"),
        ("spring.stop_stiffness=2e3", "is spring.stop_stiffness in N/m?"),
        ("gate.open_angle_deg=1.466", "gate.open_angle_deg is 1.47: is it in degrees?"),
        ("gate.gravity_point=[-0.25, -0.45]", "gate.gravity_point is in front of the hinge"),
    ],
)
def test_a_value_in_a_wrong_unit_is_noted(setting: str, said: str) -> None:
    notes = notes_on_vehicle(vehicle_from("suv", [setting], ideal=True))
    assert any(said in each for each in notes), notes


def test_optional_properties_of_a_vehicle_are_not_noted_when_absent() -> None:
    bare = ["spring.stiffness=0", "spring.preload=0", "gear.backlash=0", "drives=1"]
    assert notes_on_vehicle(vehicle_from("suv", bare, ideal=True)) == []


def test_commands_note_an_implausible_vehicle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = text_file(tmp_path / "s.toml", 'duration = 0.2\n[set]\n"motor.inductance" = 0.25\n')
    said = "motor.inductance/motor.resistance is 0.35 s"
    assert said in lh.run(scenario, ecu="reference").notes[0]
    output = str(tmp_path / "out.csv")
    settings = ["--set", "motor.inductance=0.25", "--output", output]
    assert main(["simulate", "--voltage", "12", "--duration", "0.1", *settings]) == 0
    assert f"suv: {said}" in capsys.readouterr().err
    assert main(["rig", "check", "liftgate", *settings[:2]]) == 0
    assert said in "".join(capsys.readouterr())
