"""A gate stepped by hand: commands and surroundings in, frames and values out, at no pace but the script's."""

import liftgate_hil as lh


def main() -> None:
    """Open the gate halfway, then close it onto a rod on a slope."""
    with lh.Gate(vehicle="suv", rig="liftgate", initial="closed", seed=1) as gate:
        gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
        frames = gate.step(2.5)
        print(f"{len(frames)} frames, the last one: {frames[-1]}")

        gate.command(left_duty=0, right_duty=0, direction="brake")
        gate.step(0.5)
        stood = gate.truth["gate_angle_deg"]
        print(f"{gate.time:.1f} s: stands at {stood:.1f} deg")

        gate.set(road_slope_deg=8)  # until it is set to something else, or to None
        gate.obstacle(angle_deg=15, stiffness=10_000)  # N/m; at the gate's edge
        gate.command(left_duty=40, right_duty=40, direction="close")
        while gate.truth["pinch_force_n"] < 100.0 and gate.time < 10.0:
            gate.step(0.001)
        force, angle = gate.truth["pinch_force_n"], gate.truth["gate_angle_deg"]
        print(f"{gate.time:.2f} s: {force:.0f} N on the rod at {angle:.1f} deg,")
        print(f"        the left motor draws {-gate.sensed['left_current_a']:.2f} A")

        gate.command(None)  # the ECU is silent: after three cycles the motors coast
        gate.step(0.1)
        assert gate.truth["left_coast"] == 1
        assert 10.0 < stood < 40.0
        assert force >= 100.0


if __name__ == "__main__":
    main()
