"""An ECU in C: built as a shared library, run in a process of its own. `ecu=` and `--ecu` take its path."""

import os
import subprocess
from pathlib import Path

import liftgate_hil as lh

HERE = Path(__file__).parent
HEADERS = Path(lh.__path__[0]) / "ecu"  # liftgate_ecu.h


def main() -> None:
    """Build my_ecu.c in the working folder, and have it close the gate onto a rod."""
    library = Path("c_ecu.so").resolve()
    command = [os.environ.get("CC", "cc"), "-shared", "-fPIC", "-fvisibility=hidden", "-O2"]
    command += [f"-I{HEADERS}", "-o", str(library), str(HERE / "my_ecu.c")]
    subprocess.run(command, check=True)

    result = lh.run(HERE / "rod.toml", ecu=library)
    force, lowest = result.maxima["pinch_force_n"], result.minima["gate_angle_deg"]
    print(f"{force:.0f} N on the rod: this ECU does not look at the current")
    print(f"the gate got down to {lowest:.1f} deg")
    assert result.verdict == "pass", result.reason
    assert force > 300.0
    assert result.summary.command_timeouts == 0


if __name__ == "__main__":
    main()
