"""The interface goes and comes back while the emulator runs: its feedback must come back by itself.

`make test-vcan VCAN_TESTS="tests/vcan/test_link_faults.py --link-cycles 100"` does it a hundred times.
"""

from __future__ import annotations

import time

import pytest
from hil_support import OPEN, both, command_frame
from vcan_support import Bus, emulator, run, summary_of, texts_of

from hil.config.rig import Rig

UP = [("ip", "link", "set", "vcan0", "up")]
FAULTS = {
    "down and up": ([("ip", "link", "set", "vcan0", "down")], UP),
    "gone and back": (
        [("ip", "link", "del", "vcan0")],
        [("ip", "link", "add", "dev", "vcan0", "mtu", "72", "type", "vcan"), *UP],
    ),
}
Steps = list[tuple[str, ...]]


def feedback_within(milliseconds: int) -> bool:
    """Whether a candump that starts now sees a Gate frame in time."""
    return bool(run("candump", "-n", "1", "-T", str(milliseconds), "vcan0,220:7FF"))


@pytest.mark.parametrize(("breaks", "mends"), FAULTS.values(), ids=FAULTS)
def test_feedback_returns_with_the_link(
    bus: Bus, rig: Rig, breaks: Steps, mends: Steps, link_cycles: int
) -> None:
    with emulator(bus, "--json") as gate:
        for cycle in range(link_cycles):
            for step in breaks:
                run(*step)
            time.sleep(0.3)
            assert gate.poll() is None, gate.stderr.read()
            for step in mends:
                run(*step)
            assert feedback_within(1000), f"no feedback in cycle {cycle}"
        summary = summary_of(gate)
    assert any(summary["link"].values())


@pytest.mark.parametrize(("breaks", "mends"), FAULTS.values(), ids=FAULTS)
def test_commands_are_heard_again(
    bus: Bus, rig: Rig, breaks: Steps, mends: Steps, link_cycles: int
) -> None:
    with emulator(bus, "--json") as gate:
        for cycle in range(link_cycles):
            for step in (*breaks, *mends):
                run(*step)
            assert feedback_within(1000), f"no feedback in cycle {cycle}"
            run("cansend", "vcan0", *texts_of([command_frame(rig, cycle, **both(10.0, OPEN))]))
            feedback_within(1000)
            time.sleep(0.1)  # the command goes stale, so that its counter is forgotten
        summary = summary_of(gate)
    assert summary["received"]["accepted"] == link_cycles
