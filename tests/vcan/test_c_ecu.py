"""The example ECU in C over SocketCAN."""

from __future__ import annotations

from pathlib import Path

import pytest
from c_ecu import build_ecu, needs_compiler
from vcan_support import PATIENCE, Bus, emulator, running, summary_of

OBSTACLE = "[[obstacle]]\nangle_deg = 35\ndistance = 1.0\nstiffness = 10_000\n"


@pytest.fixture(scope="module")
def ecu_can(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_ecu(tmp_path_factory.mktemp("ecu"))[0]


@needs_compiler
def test_an_ecu_in_c_drives_the_gate_over_socketcan(tmp_path: Path, bus: Bus, ecu_can: Path) -> None:
    """The gate opens, closes and reverses in real time."""
    surroundings = tmp_path / "surroundings.toml"
    surroundings.write_text(OBSTACLE)
    with (
        emulator(bus, "--json", "--scenario", str(surroundings)) as gate,
        running(str(ecu_can), "vcan0", str(0.9 * PATIENCE)) as ecu,
    ):
        _, told = ecu.communicate(timeout=PATIENCE)
        summary = summary_of(gate)
    assert ecu.returncode == 0, told
    states = [line.split()[2] for line in told.splitlines()]
    assert states == ["opening", "open", "closing", "reversing", "done"]
    assert summary["received"]["accepted"] > 500
    assert summary["received"]["foreign"] == summary["rejected_frames"] == 0
    assert not any(summary["link"].values())
