"""A scenario run against an ECU, and what is expected of it: the same for the reference ECU, a C library
(`ecu="path/to/ecu.so"`), a Python class (`ecu="module:Class"`) or an object.
"""

from pathlib import Path

import liftgate_hil as lh

HERE = Path(__file__).parent


def main() -> None:
    """Run it, print what the ECU told, and judge."""
    result = lh.run(
        HERE / "rod.toml",
        ecu="reference",
        clock="free",  # in model time, as fast as it goes
        settings=["environment.road_slope_deg=5"],
        record=["run.csv", "run.log"],  # what was so and what was sensed; the frames
        trace=True,  # every row as arrays, too
    )
    for event in result.events:
        print(f"{event.time:6.2f} s  {event.text}")
    force, time = result.maxima["pinch_force_n"], result.pinch_time_s
    angle = result.trace["gate_angle_deg"]
    print(f"{force:.0f} N at {time:.2f} s; at the end the gate stands at {angle[-1]:.1f} deg")

    assert result.verdict == "pass", result.reason  # it came to its end
    assert 0.0 < force < 200.0
    assert angle[-1] > result.minima["gate_angle_deg"] + 5.0  # it reversed
    assert result.summary.command_timeouts == 0


if __name__ == "__main__":
    main()
