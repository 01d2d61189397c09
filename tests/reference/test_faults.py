"""Faults that begin in motion, against the event-located solution of a gate changed at that instant."""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from liftgate_hil.config.fault_kinds import DRIVE, FAULT_KINDS, GATE
from tests.plant.runs import tables
from tests.reference.event_solution import DriveInput, Phase, Solution, solve

OPENING, COASTING, BRAKING = DriveInput("open", 1.0), DriveInput("coast"), DriveInput("brake")
BEGIN, END = 1.0, 2.0  # s

CURRENT_BAR = 2.0  # mA rms
ANGLE_BAR = 0.002  # deg, at worst
TOLERANCE = 1e-7  # of the event solution: as in test_accuracy


class Case(NamedTuple):
    """A fault of the left drive or the gate, and the exact gate from then on."""

    kind: str
    values: dict[str, Any]
    changes: dict[str, Any]
    left: DriveInput = OPENING
    right: DriveInput = OPENING


def left(**more: Any) -> dict[str, Any]:
    return {"left": more}


SPRING = {"stiffness": 900.0, "preload": 330.0}
CASES = [
    # A line without any current, but for what 1 MOhm lets through.
    Case("motor_open", {}, left(motor={"resistance": 1e6})),
    Case("motor_short", {}, {}, left=BRAKING),
    Case("contact_resistance", {"ohm": 0.5}, left(motor={"resistance": 0.708 + 0.5})),
    Case("bridge_stuck", {"state": "brake"}, {}, left=BRAKING),
    Case("bridge_stuck", {"state": "close"}, {}, left=DriveInput("close", 1.0)),
    Case("supply_open", {}, {}, left=COASTING, right=COASTING),
    Case("spring_lost", {}, left(spring={"stiffness": 0.0, "preload": 0.0})),
    Case("spring_weak", {"factor": 0.6}, left(spring={"stiffness": 540.0, "preload": 198.0})),
    Case("spindle_jammed", {}, left(spindle={"friction_force": 1e8})),
    Case(
        "friction",
        {"factor": 2.0},
        left(gear={"friction_torque": 1.2}, spindle={"friction_force": 2000.0}, motor={"load_torque": 0.00248}),
    ),
    Case(  # stops it after a fifth of a tick
        "friction",
        {"factor": 5000.0},
        left(gear={"friction_torque": 3000.0}, spindle={"friction_force": 5e6}, motor={"load_torque": 6.2}),
    ),
    Case("parameter", {"key": "gate.mass", "value": 35.0}, {"gate": {"mass": 35.0}}),
    Case("parameter", {"key": "motor.resistance", "value": 1.0}, {"motor": {"resistance": 1.0}}),
]


def simulated(folder: Path, case: Case) -> dict[str, np.ndarray]:
    from liftgate_hil.cli.main import main

    where = '"left"' if FAULT_KINDS[case.kind].of == DRIVE else None
    keys = {name: f'"{each}"' if isinstance(each, str) else each for name, each in case.values.items()}
    if where:
        keys["where"] = where
    text = "".join(f"{name} = {value}\n" for name, value in keys.items())
    file, output = folder / "s.toml", folder / "out.csv"
    file.write_text(f'[[fault]]\nkind = "{case.kind}"\nstart = {BEGIN}\n{text}')
    (folder / "in.csv").write_text("time_s,left_duty,right_duty\n0,1,1\n")
    flags = ["--duration", str(END), "--scenario", str(file), "--ideal", "--output", str(output)]
    assert main(["simulate", "--input", str(folder / "in.csv"), *flags]) == 0
    table = np.genfromtxt(output, delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names or ()}


def exact(case: Case, times: np.ndarray) -> Solution:
    before = Phase(BEGIN, OPENING, OPENING)
    after = Phase(END, case.left, case.right, changes=case.changes)
    return solve(tables(), [before, after], times, tolerance=TOLERANCE)


@functools.cache
def sound(count: int) -> Solution:
    """Exact solution of a gate without a fault over this number of ticks of 1 ms."""
    nothing = Case("parameter", {}, {})
    return exact(nothing, np.minimum(1e-3 * np.arange(count), END))


def rms(error: np.ndarray) -> float:
    return 1e3 * math.sqrt(float(np.mean(error**2)))


@pytest.mark.parametrize(
    "case", CASES, ids=[f"{each.kind}-{'-'.join(map(str, each.values.values()))}" for each in CASES]
)
def test_a_fault_that_begins_in_motion_meets_the_accuracy_limits(tmp_path: Path, case: Case) -> None:
    rows = simulated(tmp_path, case)
    times = np.minimum(rows["time_s"], END)
    truth = exact(case, times)
    was = sound(len(times))
    later = times > BEGIN
    changed = rms(rows["left_current_a"][later] - was.left_current[later])
    assert changed > 10.0  # mA: it does something
    for side in ("left", "right"):
        error = rows[f"{side}_current_a"] - getattr(truth, f"{side}_current")
        assert rms(error) < CURRENT_BAR
    assert np.abs(rows["gate_angle_deg"] - np.degrees(truth.angle)).max() < ANGLE_BAR


def test_every_physical_kind_of_fault_has_a_case_or_another_test() -> None:
    # A drive that comes off is a clutch that slips at once: tests/plant/test_overload.py has its closed forms. The
    # latch's is one of a switch's position, tests/plant/test_latch.py.
    elsewhere = {"drive_disconnected", "latch_not_releasing"}
    sensors = {name for name in FAULT_KINDS if name.startswith(("hall_", "current_", "angle_"))}
    physics = {name for name, kind in FAULT_KINDS.items() if kind.of in (DRIVE, GATE)}
    assert physics - sensors - {"latch_stuck"} == {each.kind for each in CASES} | elsewhere
