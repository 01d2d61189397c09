"""A parameter sweep in a loop: rods of several spring rates, on the level and on two slopes."""

from pathlib import Path

import liftgate_hil as lh

RODS = (2_500, 10_000, 40_000)  # N/m
SLOPES = (-10, 0, 10)  # deg


def main() -> None:
    """Print the largest pinch force of each combination as a table."""
    scenario = Path(__file__).parent / "rod.toml"
    print("rod N/mm" + "".join(f"{slope:7d} deg" for slope in SLOPES))
    for rod in RODS:
        forces = []
        for slope in SLOPES:
            result = lh.run(scenario, parameters={"rod": rod}, settings=[f"environment.road_slope_deg={slope}"])
            assert result.verdict == "pass", result.reason
            forces.append(result.maxima["pinch_force_n"])
        print(f"{rod / 1000:8g}" + "".join(f"{force:9.0f} N" for force in forces))


if __name__ == "__main__":
    main()
