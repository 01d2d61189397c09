"""Identification of a motor that others measured: nebisman/DCMotor.jl, a geared DC motor on a teaching rig.

The data are public (MIT licence, "Copyright (c) 2026 LB, HD") and are not copied here. To repeat what
docs/identification.md shows, take `datafiles/DCmotor_prbs_open_exp.csv` and `DCmotor_step_open_exp.csv` of
github.com/nebisman/DCMotor.jl at commit 19f60f4e6eb9f9bc695378752ab380bbbd202594 and give their folder to
`python -m tools.identification --dc-motor FOLDER`.

Columns: t [s], u [V] as commanded, y [deg/s] computed from the encoder's counts of the last 20 ms (2800 counts a
revolution).
"""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

VEHICLE = Path(__file__).with_name("dc_motor.toml")
FILES = {
    "DCmotor_prbs_open_exp.csv": "c5393258c655d0e54485ab1ff1363c1498e870b78cc79ad99e99b356d5bc6613",
    "DCmotor_step_open_exp.csv": "827e03815db7c1bcc4db6e5f73927bc422189aba154faa7c25e7c0f9df4b1925",
}
_COUNTS, _PERIOD = 2800, 0.02
_FLAGS = ("--initial", "0", "--speed-window", str(_PERIOD), "--input-delay", "estimate", "--quiet")
_ESTIMATE = "motor.speed_constant,motor.rotor_inertia,motor.load_torque"
_RESISTANCE, _TORQUE_CONSTANT = 1.0, 0.357  # Ω, N m/A, as in the vehicle's file


class Motor(NamedTuple):
    """Identified motor: values with their standard deviations, and the fits of the speed.

    Voltage and speed determine only: n = K (u − u_c) in the steady state, reached with the time constant τ.
    """

    gain: tuple[float, float]  # K, rev/s per V
    time_constant: tuple[float, float]  # τ, s
    dead_voltage: tuple[float, float]  # u_c, V
    delay: tuple[float, float]  # s
    fit: float  # %, on the PRBS run
    fit_other: float  # %, on the step run


def convert(source: Path, target: Path) -> None:
    """Convert a file of the source to columns for `identify`; the speed is restored to whole counts of 20 ms.

    Raises SystemExit if the file is another version of the data.
    """
    digest = hashlib.sha256(source.read_bytes()).hexdigest()
    if FILES[source.name] != digest:
        raise SystemExit(f"{source}: another version of the data: {digest}")
    rows = np.loadtxt(source, delimiter=",", skiprows=1)
    counts = np.round(rows[:, 2] / 360.0 * _COUNTS * _PERIOD)
    columns = np.column_stack([rows[:, 0], rows[:, 1], counts / _COUNTS / _PERIOD])
    np.savetxt(target, columns, delimiter=",", header="time_s,voltage_v,left_speed_rps", comments="", fmt="%.9g")


def measure(folder: Path, work: Path) -> Motor:
    """Return the motor as identified from the PRBS run and validated with the step run."""
    for name in FILES:
        convert(folder / name, work / name)
    prbs, step = (str(work / name) for name in FILES)
    found = _command(
        "identify", prbs, "--vehicle", str(VEHICLE), "--estimate", _ESTIMATE, *_FLAGS,
        "--save-vehicle", str(work / "found.toml"), "--result", str(work / "dc.json"),
    )  # fmt: skip
    other = _command(
        "validate", step, "--vehicle", str(work / "found.toml"), *_FLAGS, "--result", str(work / "dc.json")
    )
    speed, inertia, load = (found["parameters"][name] for name in _ESTIMATE.split(","))
    constant = 2.0 * math.pi * inertia["value"] * _RESISTANCE / (_TORQUE_CONSTANT * speed["value"])
    relative = math.hypot(inertia["std"] / inertia["value"], speed["std"] / speed["value"])
    dead = _RESISTANCE / _TORQUE_CONSTANT
    delay = found["initial_states"]["input_delay"]
    return Motor(
        (1.0 / speed["value"], speed["std"] / speed["value"] ** 2),
        (constant, constant * relative),
        (dead * load["value"], dead * load["std"]),
        (delay["value"], delay["std"]),
        found["fit_percent"]["left_speed_rps"],
        other["fit_percent"]["left_speed_rps"],
    )


def _command(*arguments: str) -> dict[str, Any]:
    subprocess.run([sys.executable, "-P", "-m", "liftgate_hil", *arguments], check=True, timeout=600)
    content: dict[str, Any] = json.loads(Path(arguments[-1]).read_text())
    return content


def table(motor: Motor) -> list[str]:
    """Return the lines of a Markdown table of the identified motor beside the source's values."""

    def shown(pair: tuple[float, float], scale: float = 1.0) -> str:
        return f"{scale * pair[0]:.4g} ± {scale * pair[1]:.2g}"

    return [
        "| | identified | the source says |",
        "|---|---|---|",
        f"| gain K, rev/s per V | **{shown(motor.gain)}** | 0.4441 (static curve) |",
        f"| dead voltage, V | **{shown(motor.dead_voltage)}** | 0.203 (static curve) |",
        f"| time constant, ms | **{shown(motor.time_constant, 1e3)}** | 67 (see below) |",
        f"| input delay, ms | **{shown(motor.delay, 1e3)}** | |",
        f"| fit of the speed, % | **{motor.fit:.1f}** | |",
        f"| fit on the step run, not used before, % | **{motor.fit_other:.1f}** | |",
    ]
