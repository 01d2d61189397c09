"""Geometry of drawings, compared with independent rotation matrices and the plant's lengths."""

from __future__ import annotations

import math

import numpy as np
import pytest

from liftgate_hil.operate.attachment.drawing import geometry_of
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.gate import extension, linkage
from liftgate_plant.vehicle import Vehicle


@pytest.fixture(params=["suv", "compact", "heavy-suv"])
def vehicle(request: pytest.FixtureRequest) -> Vehicle:
    """A vehicle whose hinge is not at the origin, as a vehicle file may have it."""
    return vehicle_from(request.param, ["gate.hinge=[0.02, 0.01]"])


def test_the_gates_points_turn_about_the_hinge(vehicle: Vehicle) -> None:
    found, hinge = geometry_of(vehicle), np.array(vehicle.gate.hinge)
    closed = np.array(vehicle.gate.gate_point) - hinge
    for angle, point in zip(found["angles_deg"], found["drives"]["left"]["gate_point"], strict=True):
        turn = complex(*closed) * complex(math.cos(math.radians(angle)), math.sin(math.radians(angle)))
        assert point == pytest.approx([hinge[0] + turn.real, hinge[1] + turn.imag])
    edge = np.array(found["edge"]) - hinge
    assert np.hypot(*edge.T) == pytest.approx(np.full(len(edge), vehicle.gate.length))
    assert edge[-1][1] > edge[0][1]  # it opens upwards


def test_the_length_of_a_drawn_drive_equals_that_in_the_plant(vehicle: Vehicle) -> None:
    found, link = geometry_of(vehicle), linkage(vehicle.gate)
    lengths = [extension(link, math.radians(angle)) + link.closed_length for angle in found["angles_deg"]]
    assert found["drives"]["left"]["length_m"] == pytest.approx(lengths)
    assert found["stroke_m"] == pytest.approx(lengths[-1] - lengths[0])
    assert found["stops_deg"] == pytest.approx([0.0, math.degrees(vehicle.gate.open_angle)])
    assert found["angles_deg"][-1] == pytest.approx(found["open_angle_deg"])


def test_the_drawn_springs_force_equals_that_in_the_plant(vehicle: Vehicle) -> None:
    found, link = geometry_of(vehicle), linkage(vehicle.gate)
    for side, tables in (("left", vehicle.left), ("right", vehicle.right)):
        if side not in found["drives"]:
            continue
        spring = tables.spring
        compressed = found["stroke_m"] - (np.array(found["drives"][side]["length_m"]) - link.closed_length)
        if spring.gas_force == 0.0:
            expected = spring.preload + spring.stiffness * compressed
            assert found["drives"][side]["spring_n"] == pytest.approx(expected.tolist())
        assert found["drives"][side]["spring_n"][0] >= found["drives"][side]["spring_n"][-1] > 0.0


def test_a_gate_with_one_drive_is_drawn_with_one_drive() -> None:
    assert list(geometry_of(vehicle_from("suv", ["drives=1"]))["drives"]) == ["left"]
