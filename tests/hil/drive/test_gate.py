"""A gate stepped from Python: effects of commands, frames and settings, and the returned values."""

from __future__ import annotations

import itertools
import threading
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hil_support import BENCH_CONTROL, GATE, OF_DRIVES, SWITCHES, panel_frame, shipped_rig

import liftgate_hil as lh
from liftgate_hil.errors import ConfigError

FOREIGN = Path(__file__).parents[2] / "system" / "foreign" / "foreign.toml"
OPENING: dict[str, Any] = {
    "left_duty": 60, "right_duty": 60, "direction": "open", "latch_release": True,
}  # fmt: skip


def test_a_command_is_sent_every_cycle_with_counter_and_checksum() -> None:
    with lh.Gate() as gate:
        gate.command(**OPENING)
        gate.step(2.0)
        received = gate.summary.received
        assert received == received._replace(accepted=200, checksum=0, counter=0, lost=0)
        assert gate.truth["gate_angle_deg"] > 10.0
        assert gate.truth["latched"] == 0.0
        assert gate.truth["left_duty"] == pytest.approx(0.6)


def test_step_returns_the_frames_sent_during_the_step() -> None:
    with lh.Gate() as gate:
        frames = gate.step(0.010)
        assert [frame.arbitration_id for frame in frames] == [*OF_DRIVES, *OF_DRIVES, GATE, SWITCHES]
        assert [frame.timestamp for frame in frames] == [0.005] * 6 + [0.010] * 8
        assert gate.step(0.001) == []
        decoded = shipped_rig().messages["Gate"].decode(frames[-2].data, decode_choices=False)
        assert decoded["LatchState"] == 1


@pytest.mark.parametrize(("seconds", "ticks"), [(0.0001, 1), (0.001, 1), (0.0014, 1), (0.0016, 2), (3.0, 3000)])
def test_a_step_is_rounded_to_whole_ticks_and_at_least_one(seconds: float, ticks: int) -> None:
    with lh.Gate() as gate:
        gate.step(seconds)
        assert gate.time == pytest.approx(ticks * 0.001)
        assert gate.truth["time_s"] == gate.time


def test_the_gate_coasts_after_three_cycles_without_a_command_until_the_next_one() -> None:
    with lh.Gate() as gate:
        gate.command(**OPENING)
        gate.step(0.5)
        gate.command(None)
        gate.step(0.020)
        assert gate.truth["left_coast"] == 0.0
        gate.step(0.011)
        assert gate.truth["left_coast"] == 1.0
        assert gate.summary.command_timeouts == 1
        gate.command(**OPENING)
        gate.step(0.011)
        assert gate.truth["left_coast"] == 0.0


def test_results_do_not_depend_on_the_length_of_steps() -> None:
    ends = []
    for step in (0.003, 0.1, 1.5):
        with lh.Gate(seed=3, settings=["sensors.current_noise=0.1"]) as gate:
            gate.command(**OPENING)
            while gate.time < 1.5 - 1e-9:
                gate.step(step)
            ends.append((gate.truth, gate.sensed))
    assert ends[0] == ends[1] == ends[2]


def test_truth_and_sensed_have_the_column_names_of_recordings_without_the_prefix() -> None:
    with lh.Gate() as gate:
        assert gate.truth == gate.sensed == {}
        gate.step(0.001)
        assert {"left_current_a", "gate_rate_degps", "pinch_force_n"} <= set(gate.truth)
        assert {"left_current_a", "left_hall_count", "left_hall_a"} <= set(gate.sensed)
        assert not any(name.startswith("sensed_") for name in (*gate.truth, *gate.sensed))
        with pytest.raises(KeyError, match="gate_angel_deg: no such column; allowed: gate_angle_deg, "):
            gate.truth["gate_angel_deg"]
    with lh.Gate(vehicle="compact") as gate:
        gate.step(0.001)
        assert not any(name.startswith("right_") for name in (*gate.truth, *gate.sensed))


def test_set_quantities_override_the_panel_until_they_are_cleared() -> None:
    identifier, payload = panel_frame(shipped_rig(), SupplyVoltage=9.0, HandForce=20.0)
    assert identifier == BENCH_CONTROL
    with lh.Gate() as gate:
        gate.set(supply_voltage_v=14.0, road_slope_deg=8)
        gate.send(can.Message(arbitration_id=identifier, data=payload, is_extended_id=False))
        gate.step(0.002)
        assert gate.truth["supply_voltage_v"] == 14.0
        assert gate.truth["road_slope_deg"] == pytest.approx(8.0)
        assert gate.truth["hand_force_n"] == pytest.approx(20.0)
        gate.set(supply_voltage_v=None, road_slope_deg=None)
        gate.step(0.001)
        assert gate.truth["supply_voltage_v"] == pytest.approx(9.0)
        assert gate.truth["road_slope_deg"] == pytest.approx(0.0)  # the panel's


def test_an_obstacle_exerts_a_force_until_it_is_cleared() -> None:
    with lh.Gate(initial=40.0) as gate:
        gate.obstacle(angle_deg=38, stiffness=10_000)
        gate.command(left_duty=60, right_duty=60, direction="close")
        gate.step(1.0)
        force, angle = gate.truth["pinch_force_n"], gate.truth["gate_angle_deg"]
        assert force > 50.0
        assert force == pytest.approx(10_000.0 * np.radians(38.0 - angle), rel=0.02)
        gate.clear_obstacle()
        gate.step(0.001)
        assert gate.truth["pinch_force_n"] == 0.0


def test_a_gate_with_a_foreign_rig_is_commanded_by_the_same_quantities() -> None:
    with lh.Gate(rig=FOREIGN) as gate:
        gate.command(left_duty=50, right_duty=50, direction="open", latch_release=True)
        gate.step(1.0)
        assert gate.truth["gate_angle_deg"] > 1.0
        assert gate.summary.received.accepted > 0


def test_gates_in_several_threads_give_the_same_results() -> None:
    angles: dict[int, float] = {}

    def open_one(number: int) -> None:
        with lh.Gate() as gate:
            gate.command(**OPENING)
            for _ in range(30):
                gate.step(0.05)
            angles[number] = gate.truth["gate_angle_deg"]

    threads = [threading.Thread(target=open_one, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    open_one(2)
    for thread in threads:
        thread.join()
    assert angles[0] == angles[1] == angles[2] > 5.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda gate: gate.command(duty=1), "duty: allowed: left_duty"),
        (lambda gate: gate.command(left_duty=101), "`left_duty` 101: allowed: -100 to 100"),
        (lambda gate: gate.command(left_duty=float("nan")), "`left_duty` nan"),
        (lambda gate: gate.command(direction="up"), "'up': allowed: coast, open, close, brake"),
        (lambda gate: gate.set(slope=1), "slope: no such quantity; allowed: supply_voltage_v"),
        (lambda gate: gate.set(road_slope_deg=99), "`road_slope_deg` 99: allowed: -45 to 45"),
        (lambda gate: gate.obstacle(angle_deg=400), "`angle_deg` 400: allowed: -10 to 180"),
        (lambda gate: gate.obstacle(10, meets="both"), "'both': allowed: closing, opening"),
        (lambda gate: gate.step(0.0), "0.0: allowed: above 0"),
        (lambda gate: gate.step(float("nan")), "nan: allowed: above 0"),
    ],
)
def test_invalid_calls_are_refused_and_no_time_passes(call: Any, message: str) -> None:
    with lh.Gate() as gate:
        with pytest.raises(ConfigError, match=message.replace("(", r"\(")):
            call(gate)
        assert gate.time == 0.0


def test_a_force_peak_between_two_frames_is_in_the_maximum_of_bench_status() -> None:
    with lh.Gate(initial=40.0) as gate:
        gate.command(left_duty=100, right_duty=100, direction="close")
        gate.step(0.5)
        gate.obstacle(angle_deg=gate.truth["gate_angle_deg"] - 1.0)
        status = shipped_rig().messages["BenchStatus"]
        told, forces, highest = [], [], []
        for tick in range(1200):
            if gate.truth["pinch_force_n"] > 30.0:
                gate.command(left_duty=100, right_duty=100, direction="open")
            frames = gate.step(0.001)
            forces.append(gate.truth["pinch_force_n"])
            highest.append(gate.truth["pinch_force_peak_n"])
            for frame in frames:
                if frame.arbitration_id == status.frame_id:
                    told.append((tick, float(status.decode(frame.data)["PinchForce"])))
    ends = [0, *(tick for tick, _ in told)]
    assert len(told) == 12
    for (begin, end), (_, force) in zip(itertools.pairwise(ends), told, strict=True):
        assert force == pytest.approx(max(forces[begin : end + 1]), abs=0.051)
    assert max(force for _, force in told) == pytest.approx(max(forces), abs=0.051)
    assert max(forces) > 40.0
    assert highest[-1] == max(forces)
    # Contact, place and impulse stay told after the gate has gone.
    assert forces[-1] == 0.0
    assert gate.truth["pinch_impulse_ns"] == pytest.approx(sum(forces) * 1e-3, rel=2e-3)


def test_edges_returns_the_hall_edges_of_the_last_step() -> None:
    with lh.Gate(initial=30.0) as gate:
        gate.command(**OPENING)
        gate.step(1.0)
        count = gate.sensed["left_edge_count"]
        gate.step(0.004)
        second = gate.edges("left")
        gate.step(0.020)
        edges = gate.edges("left")
        assert len(edges) + len(second) == gate.sensed["left_edge_count"] - count
        assert all(edge.drive == "left" for edge in edges)
        assert all(1.004 < edge.time_s <= 1.024 for edge in edges)
        levels = [(edge.channel, edge.level) for edge in edges]
        turn = [("a", 1), ("b", 1), ("a", 0), ("b", 0)]
        start = turn.index(levels[0])
        assert levels == [turn[(start + k) % 4] for k in range(len(levels))]
        assert len(gate.edges("right")) > 0
        gate.step(2.0)
        # However many they are.
        assert len(gate.edges("left")) > 500
        with pytest.raises(ConfigError, match="allowed: left, right"):
            gate.edges("middle")
    with lh.Gate("compact") as gate, pytest.raises(ConfigError, match=r"allowed: left$"):
        gate.edges("right")
