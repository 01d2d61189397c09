"""The ring of Hall edges on the bus: frames alone give each edge's time to the microsecond."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import can
import pytest
from hil_support import LEFT_EDGES, RIGHT_EDGES, shipped_rig

import liftgate_hil as lh

_AGES = ("Age1", "Age2", "Age3", "Age4")
_LONGEST = 8191e-6  # s


def captured(frames: Sequence[can.Message], message: Any) -> list[float]:
    """Return the edges' times as an ECU computes them from a drive's frames."""
    times: list[float] = []
    number = 0
    for frame in frames:
        if frame.arbitration_id != message.frame_id:
            continue
        said = message.decode(frame.data)
        new = (said["Number"] - number) % 256
        number = said["Number"]
        assert new <= 4, "edges are lost"
        ages = [1e-6 * said[name] for name in _AGES[:new]]
        assert all(age < 0.005 + 1e-6 for age in ages)
        times += [frame.timestamp - age for age in reversed(ages)]
    return times


@pytest.mark.parametrize(("drive", "identifier"), [("left", LEFT_EDGES), ("right", RIGHT_EDGES)])
def test_every_hall_edge_of_a_run_is_on_the_bus_with_its_time(drive: str, identifier: int) -> None:
    messages = shipped_rig().messages
    (message,) = [each for each in messages.values() if each.frame_id == identifier]
    frames, edges = [], []
    with lh.Gate() as gate:
        for way, seconds in (("open", 2.5), ("close", 1.5)):
            gate.command(left_duty=90, right_duty=80, direction=way, latch_release=True)
            for _ in range(round(seconds / 0.005)):
                frames += gate.step(0.005)
                edges += [edge.time_s for edge in gate.edges(drive)]
        assert abs(gate.truth[f"{drive}_speed_rps"]) > 60.0
    found = captured(frames, message)
    assert len(found) == len(edges) > 500
    assert found == pytest.approx(edges, abs=0.51e-6)


def test_ages_of_edges_saturate_at_their_largest_value() -> None:
    message = shipped_rig().messages["LeftEdges"]
    with lh.Gate() as gate:
        last = [each for each in gate.step(0.1) if each.arbitration_id == LEFT_EDGES][-1]
    said = message.decode(last.data)
    assert said["Number"] == 0
    assert [1e-6 * said[name] for name in _AGES] == pytest.approx([_LONGEST] * 4)


def test_a_cinching_latch_can_be_opened_and_cinched_over_the_bus() -> None:
    """With cinching commands, the latch switches, handle and button as bus signals."""
    messages = [shipped_rig().messages[name] for name in ("Gate", "Switches")]

    def told(frames: Sequence[can.Message]) -> dict[str, Any]:
        said: dict[str, Any] = {}
        for message in messages:
            last = [each for each in frames if each.arbitration_id == message.frame_id][-1]
            said |= message.decode(last.data, decode_choices=False)
        return said

    settings = ("latch.half=0.008", "latch.cinch='commanded'", "latch.cinch_force=4000")
    with lh.Gate(settings=settings) as gate:
        said = told(gate.step(0.1))
        assert (said["LatchState"], said["LatchHalf"], said["CinchHome"]) == (1, 1, 1)
        gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
        said = told(gate.step(1.0))
        assert (said["LatchState"], said["LatchHalf"], said["CinchHome"]) == (0, 0, 1)
        gate.command(left_duty=40, right_duty=40, direction="close")
        while gate.truth["latch_position"] == 0.0 and gate.time < 10.0:
            gate.step(0.01)
        assert gate.truth["latch_position"] == 1.0
        gate.command(left_duty=0, right_duty=0, direction="coast")
        said = told(gate.step(0.5))
        assert (said["LatchState"], said["LatchHalf"], said["CinchHome"]) == (0, 1, 1)
        gate.command(left_duty=40, right_duty=40, direction="close", latch_cinch=True)
        said = told(gate.step(0.1))
        assert (said["LatchState"], said["LatchHalf"], said["CinchHome"]) == (0, 1, 0)
        assert 0.0 < gate.truth["latch_pull_m"] < 0.008
        said = told(gate.step(3.0))
        assert (said["LatchState"], said["LatchHalf"], said["CinchHome"]) == (1, 1, 1)
        assert gate.truth["latch_position"] == 2.0
        gate.set(handle_pulled=True, button_pressed=False)
        said = told(gate.step(0.05))
        assert (said["Handle"], said["Button"]) == (1, 0)
        gate.set(handle_pulled=None, button_pressed=1)
        said = told(gate.step(0.05))
        assert (said["Handle"], said["Button"]) == (0, 1)


def test_a_pressed_pinch_strip_is_reported_on_the_bus() -> None:
    message = shipped_rig().messages["Switches"]
    settings = ("sensors.strip_force=15",)
    with lh.Gate(initial=40.0, settings=settings) as gate:
        gate.obstacle(angle_deg=35, stiffness=10_000, lateral=-0.5)
        gate.command(left_duty=60, right_duty=60, direction="close")
        seen = set()
        for _ in range(300):
            for frame in gate.step(0.01):
                if frame.arbitration_id == message.frame_id:
                    said = message.decode(frame.data, decode_choices=False)
                    seen.add((said["LeftStrip"], said["RightStrip"]))
        assert gate.truth["pinch_force_n"] > 15.0
    assert seen == {(0, 0), (0, 1)}
