"""The reference ECU with a detailed latch: slow release, half position, cinching."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hil_support import text_file

import liftgate_hil as lh

BUILT = ("latch.half=0.008",)


def told(vehicle: str, *settings: str, duration: float | None = None) -> list[str]:
    """Events of the demo, without their figures."""
    result = lh.run("demo", vehicle=vehicle, settings=settings, seed=3, duration=duration)
    return [re.sub("[0-9].*", "", each.text) for each in result.events]


@pytest.mark.parametrize("vehicle", ["suv", "heavy-suv", "compact"])
@pytest.mark.parametrize(
    "settings",
    [("latch.release_time=0.3",), ("latch.release_time=0.4", "latch.cinch='automatic'"), ("latch.hold_time=0",)],
    ids=["slow release", "cinching", "falls at once"],
)
def test_the_demo_passes_with_a_detailed_latch(vehicle: str, settings: tuple[str, ...]) -> None:
    events = told(vehicle, *BUILT, *settings)
    assert events == told(vehicle)
    assert events[-1] == "closed and latched"


def test_a_latch_that_does_not_release_is_reported_as_blocked() -> None:
    events = told("suv", *BUILT, "latch.release_time=3", duration=8.0)
    assert events == ["opening", "blocked while opening: stopped"]


def test_a_gate_stopped_in_the_half_position_opens_again(tmp_path: Path) -> None:
    """The driver stops the gate in its half position, and asks for opening."""
    scenario = text_file(tmp_path / "half.toml", 'duration = 30\n'
        '[[request]]\ntime = 0.5\naction = "open"\n'
        '[[request]]\ntime = 13\naction = "close"\n')  # fmt: skip
    whole = lh.run(scenario, settings=BUILT, trace=True)
    place = whole.trace["latch_position"]
    half = next(time for time, now in zip(whole.trace["time_s"], place, strict=True) if now == 1.0 and time > 14.0)
    scenario.write_text(
        scenario.read_text()
        + f'[[request]]\ntime = {half + 0.03}\naction = "stop"\n'
        + f'[[request]]\ntime = {half + 2.0}\naction = "open"\n'
    )
    result = lh.run(scenario, settings=BUILT, duration=half + 14.0, trace=True)
    texts = [each.text for each in result.events]
    assert texts[-3:] == ["stopped by the driver", "opening", "open"], texts
    assert result.trace["gate_angle_deg"][-1] > 70.0
