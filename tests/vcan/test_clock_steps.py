"""Steps of the wall clock while the emulator runs have no effect."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from recordings import check_coasting, story_of, telling_commands
from vcan_support import Bus, emulator, sending, sent_by, standstills, summary_of

from liftgate_hil.config.rig import Rig

STEPS = (-6.0, 3600.0)  # s


@pytest.fixture
def wall_clock() -> Iterator[None]:
    """A wall clock that the test may set, of a machine of its own; it is corrected afterwards."""
    if "User Mode Linux" not in Path("/proc/cpuinfo").read_text():
        pytest.skip("the clock here is somebody's")
    offset = time.time() - time.monotonic()
    yield
    time.clock_settime(time.CLOCK_REALTIME, time.monotonic() + offset)


@pytest.mark.usefixtures("wall_clock")
def test_steps_of_the_wall_clock_have_no_effect(tmp_path: Path, bus: Bus, rig: Rig, link_cycles: int) -> None:
    record = tmp_path / "run.csv"
    with emulator(bus, "--json", "--record", str(record)) as gate:
        with sending(telling_commands(rig), 100.0) as ecu:
            bus.wait_for_more(0x120, 10)
            begun = time.monotonic()
            for _, step in zip(range(link_cycles), itertools.cycle(STEPS), strict=False):
                time.clock_settime(time.CLOCK_REALTIME, time.time() + step)
                time.sleep(0.05)
            elapsed = time.monotonic() - begun
            sent = sent_by(ecu)
        time.sleep(0.1)
        stopping = time.monotonic()
        summary = summary_of(gate)
        whole = time.monotonic() - stopping + elapsed
    assert (summary["received"]["accepted"], summary["received"]["lost"]) == (sent, 0)
    assert elapsed <= summary["model_time_s"] <= whole + 60.0
    story = story_of(record)
    ticks = [row.tick for row in story.rows]
    assert all(before < after for before, after in itertools.pairwise(ticks))
    assert ticks[-1] - ticks[0] < 1000.0 * summary["model_time_s"]
    check_coasting(story)
    assert summary["command_timeouts"] == len(story.stale) <= standstills(link_cycles)
    assert not any(summary["link"].values())
    # A command waits no longer than for the loop and for the next feedback.
    limit = summary["lateness_max_us"] + summary["execution_max_us"] + 30_000.0
    assert summary["command_delay_max_us"] <= limit
    assert summary["command_delay_p50_us"] <= 30_000.0
