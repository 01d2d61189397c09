"""Coding of the reference ECU for a car: its closing speed and its anti-trap limits."""

from __future__ import annotations

import pytest

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.ecu.calibration import CALIBRATED, coded
from liftgate_plant.coding import UNCODED, Coding

_LIMITS = ("inertia_error", "excess_learned", "excess_unlearned", "excess_share", "excess_per_slope")


def test_a_coding_scales_only_closing_speeds_and_anti_trap_limits() -> None:
    assert coded(CALIBRATED, UNCODED) == CALIBRATED
    own = coded(CALIBRATED, Coding(closing_speed=0.5, anti_trap_limits=2.0))
    assert own.closing_speed == tuple(0.5 * speed for speed in CALIBRATED.closing_speed)
    assert own.closing_start == 0.5 * CALIBRATED.closing_start
    for name in _LIMITS:
        assert getattr(own, name) == 2.0 * getattr(CALIBRATED, name)
    changed = {*_LIMITS, "closing_speed", "closing_start"}
    for name in {*CALIBRATED._fields} - changed:
        assert getattr(own, name) == getattr(CALIBRATED, name)


def test_a_coding_with_a_lower_closing_speed_closes_the_gate_later() -> None:
    times = []
    for share in ("1", "0.7"):
        events = lh.run("demo", settings=(f"coding.closing_speed={share}",)).events
        assert events[-1].text == "closed and latched"
        times.append(events[-1].time)
    assert times[0] + 2.0 < times[1] < times[0] + 4.0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("1", "--coding 1: allowed: SPEED,LIMITS"),
        ("0.1,1", "'0.1'; allowed: 0.2 to 2"),
        ("1,x", "'x'; allowed: 0.2 to 5"),
    ],
)
def test_an_invalid_coding_is_reported(given: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ecu", "--bus", "virtual:coding", "--coding", given]) == 2
    assert said in capsys.readouterr().err
