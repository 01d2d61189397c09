"""The reference ECU at different cycles of the rig moves the gate alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hil_support import text_file

import liftgate_hil as lh
from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.config.shipped import find_config


def rig_of_cycle(folder: Path, cycle_ms: float) -> Path:
    """Write the shipped rig with another cycle of the command message; return its path."""
    shipped = find_config("rigs", "liftgate").read_text()
    head = "[messages.DriveCommand]\n"
    assert head in shipped
    return text_file(
        folder / f"cycle-{cycle_ms:g}.toml", shipped.replace(head, f"{head}cycle_ms = {cycle_ms:g}\n")
    )


def demo(rig: Path) -> lh.Result:
    result = lh.run("demo", rig=rig, trace=True)
    assert result.verdict == "pass", result.reason
    return result


def travel_times(result: lh.Result) -> list[float]:
    """Return the durations [s] of learning the travel, of opening and of closing, each from its request on."""
    starts = {
        "open, travel learned": 0.5, "open": 22.5, "closed and latched": 29.0
    }  # fmt: skip
    at = {event.text.split(":")[0]: event.time for event in result.events}
    return [at[text] - start for text, start in starts.items()]


@pytest.mark.parametrize("cycle_ms", [5, 10, 20, 50])
def test_the_gate_opens_reverses_closes_and_latches_at_any_cycle(tmp_path: Path, cycle_ms: int) -> None:
    result = demo(rig_of_cycle(tmp_path, cycle_ms))
    assert [event.text.split(" (")[0].split(",")[0] for event in result.events] == [
        "opening", "open", "closing", "trapped while closing", "reversal done", "opening", "open",
        "closing", "closed and latched",
    ]  # fmt: skip
    assert result.maxima["gate_angle_deg"] > 79.0
    assert result.trace["latched"][-1] == 1.0
    assert 20.0 < result.maxima["pinch_force_n"] < 200.0
    freed = result.trace["time_s"] > result.pinch_time_s
    pinched = np.interp(result.pinch_time_s, result.trace["time_s"], result.trace["gate_angle_deg"])
    assert result.trace["gate_angle_deg"][freed].max() > pinched + 15.0
    # A command at time 0 and then one every cycle; the last one comes after the last tick. Where the drives stop
    # or turn back there may be one between: open, trapped, reversed, open, closed.
    accepted = result.summary.received.accepted
    assert result.summary.received == NO_COUNTS._replace(accepted=accepted)
    assert 0 <= accepted - 42_000 // cycle_ms <= 5
    assert result.summary.command_timeouts == 0


@pytest.mark.parametrize("cycle_ms", [5, 20, 50])
def test_motions_take_equally_long_at_any_command_cycle(tmp_path: Path, cycle_ms: int) -> None:
    slow, usual = (demo(rig_of_cycle(tmp_path, cycle)) for cycle in (cycle_ms, 10))
    assert travel_times(slow) == pytest.approx(travel_times(usual), rel=0.02)


def test_a_command_cycle_of_no_whole_number_of_ticks_is_kept_on_average(tmp_path: Path) -> None:
    result = lh.run("demo", rig=rig_of_cycle(tmp_path, 7.5), duration=9.0)
    assert result.summary.received.accepted == 9.0 / 0.0075
    assert result.summary.command_timeouts == 0
    assert result.maxima["gate_angle_deg"] > 60.0
