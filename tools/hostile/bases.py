"""Valid files that are then mangled: shipped ones, and measurements that the program itself writes."""

from __future__ import annotations

import math
import re
import tomllib
from functools import cached_property
from pathlib import Path
from typing import Any

from liftgate_hil.config.shipped import data_root
from liftgate_hil.formats.suffixes import RECORDED

FOREIGN = Path(__file__).parents[2] / "tests/system/foreign"
_INPUT = "in.csv"
_BESIDE_THE_DEMOS = tuple(suffix for suffix in RECORDED if suffix not in (".csv", ".log"))


class Bases:
    """Texts of valid shipped files, and a folder with valid measurements."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        configs = data_root() / "configs"
        self.vehicles = _texts(sorted((configs / "vehicles").glob("*.toml")))
        self.judged = configs / "scenarios/pack/falling.toml"
        self.scenarios = [*_texts([configs / "scenarios/demo.toml"]), _SCENARIO]
        # The database of each rig has the same index in `databases`.
        self.rigs = _texts([configs / "rigs/liftgate.toml", FOREIGN / "foreign.toml"])
        paths = (data_root() / "dbc/liftgate.dbc", FOREIGN / "foreign.dbc")
        self.databases = [(path.name, path.read_bytes().decode("cp1252")) for path in paths]

    @cached_property
    def words(self) -> list[str]:
        """Words that occur in the texts, sorted."""
        texts = [*self.vehicles, *self.scenarios, *self.rigs, *(text for _, text in self.databases)]
        return sorted(set(re.findall(r"\w+", " ".join(texts))))

    def trees(self, texts: list[str]) -> list[dict[str, Any]]:
        """Return TOML texts as parsed trees of values."""
        return [tomllib.loads(text) for text in texts]

    def make_measurements(self) -> None:
        """Write the measurements with calls of the command line.

        The calls also compile what the program needs, and warm this process up before it forks. Raises SystemExit
        if one of them fails.
        """
        from liftgate_hil.cli.main import main

        self.folder.mkdir(parents=True, exist_ok=True)
        table = self.folder / _INPUT
        table.write_text(_input(), encoding="utf-8")
        simulated = ["simulate", "--input", str(table)]
        kept = self.folder / "m.csv"
        demo = ["demo", "--clock", "free", "--duration", "1.5", "--quiet", "--output", str(self.folder)]
        for suffix in _BESIDE_THE_DEMOS:
            demo += ["--record", str(self.folder / f"bus{suffix}")]
        own = str(self.folder / "demo.csv")
        calls = [
            [*simulated, "--step", "0.001", "--every", "5", "--output", str(kept)],
            [*simulated, "--step", "0.001", "--every", "5", "--output", str(self.folder / "m.mf4")],
            demo,
            ["validate", str(kept), "--quiet"],
            ["identify", str(kept), "--estimate", "motor.resistance", "--quiet"],
            ["compare", own, own, "--output", str(self.folder / "warm.png"), "--quiet"],
            ["replay", str(self.folder / "demo.log"), "--bus", "virtual:warm", "--to", "0.1", "--quiet"],
            ["run", "--bus", "virtual:warm", "--clock", "free", "--duration", "0.05", "--quiet"],
            ["demo", "--duration", "0.05", "--no-record", "--quiet"],
        ]
        for call in calls:
            code = main(call)
            if code:
                raise SystemExit(f"{call}: exit code {code}, which is to be 0")

    @property
    def tables(self) -> list[Path]:
        """Paths of the measurements that are tables (CSV)."""
        return [self.folder / name for name in ("m.csv", _INPUT, "demo.csv")]

    @property
    def logs(self) -> list[Path]:
        """Paths of the bus logs that are text."""
        return [self.folder / name for name in ("demo.log", "bus.asc", "bus.trc")]

    @property
    def recordings(self) -> list[Path]:
        """Paths of the recordings that `convert` and similar commands read: tables, logs, and binary formats."""
        names = ("demo.csv", "m.csv", "demo.log", *(f"bus{suffix}" for suffix in _BESIDE_THE_DEMOS))
        return [self.folder / name for name in names]

    @property
    def binaries(self) -> list[Path]:
        """Paths of the measurements in binary formats."""
        return [self.folder / name for name in ("bus.blf", "m.mf4")]


def _texts(paths: list[Path]) -> list[str]:
    return [path.read_text(encoding="utf-8") for path in paths]


def _input() -> str:
    """Return a CSV table of 3 s of motor voltage [V] for an opening, with steps that make the motion vary."""
    rows = ["time_s,voltage_v"]
    for k in range(600):
        time = 0.005 * k
        wobble = 1.2 if math.sin(8.0 * time) > 0.0 else 0.8
        rows.append(f"{time:.3f},{8.0 * min(time / 0.3, 1.0) * wobble * (time < 2.7)!r}")
    return "\n".join([*rows, ""])


_SCENARIO = """
description = "all that a scenario may hold"
requirement = ["LG-1"]
duration = 0.2
vehicle = "compact"
rig = "liftgate"
seed = 3
initial = 20.0
[parameters]
rod = 10_000
volts = 11.5
[set]
"environment.road_slope_deg" = 5
motor = { resistance = 0.9 }
[[profile]]
quantity = "supply_voltage_v"
points = [[0, "$volts"], [0.1, 12.0], [0.15, 9]]
[[profile]]
quantity = "hand_force_n"
interpolation = "hold"
points = [[0.05, 10]]
[[obstacle]]
start = 0.02
end = 0.1
angle_deg = 25
distance = 0.9
stiffness = "$rod"
damping = 10
gap = 0.001
meets = "opening"
[[request]]
time = 0.01
action = "open"
[[request]]
time = 0.15
action = "stop"
[[signal]]
signal = "Body.Ignition"
value = "on"
[[signal]]
time = "gate_angle_deg > 5"
delay_s = 0.01
signal = "Body.VehicleSpeed"
value = 12.5
[[fault]]
kind = "current_offset"
where = "left"
start = 0.05
end = "left_current_a > 3"
period_s = 0.01
share = 0.5
value = 2.5
[[fault]]
kind = "frame_lost"
where = "LeftDrive"
direction = "sent"
probability = 0.5
seed = 3
[[expect]]
name = "opens"
eventually = "gate_angle_deg > 20.001 and not Gate.LatchState == 1"
after = "sensed.left_current_a > 0.5"
within_s = 0.1
for_s = 0.01
[[expect]]
name = "stays"
always = "abs(gate_rate_degps) < $rod"
"""
