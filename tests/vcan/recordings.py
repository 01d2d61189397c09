"""Motors and their commands in a recording, tick by tick."""

from __future__ import annotations

import csv
import itertools
from pathlib import Path
from typing import NamedTuple

from hil_support import OPEN, both, command_frame

from liftgate_hil.config.rig import Rig

TIMEOUT = 30  # ticks


def telling_commands(rig: Rig) -> list[tuple[int, bytes]]:
    """Commands whose duty differs from that of the previous one, so that a recording shows each."""
    return [command_frame(rig, turn, **both(10.0 + 0.5 * (turn % 16), OPEN)) for turn in range(16)]


class Row(NamedTuple):
    tick: int
    duty: float
    coasts: bool


class Story(NamedTuple):
    """Recorded course of a run of `telling_commands`."""

    rows: list[Row]
    accepted: list[int]  # ticks before those in which a command was taken in
    stale: list[tuple[int, int]]  # (last of these, last tick in which the motors were driven by it)


def story_of(path: Path) -> Story:
    with path.open() as stream:
        rows = [
            Row(round(1000.0 * float(row["time_s"])), float(row["left_duty"]), row["left_coast"] == "1")
            for row in csv.DictReader(stream)
        ]  # fmt: skip
    assert all(row.coasts == (row.duty == 0.0) for row in rows)
    accepted: list[int] = []
    stale = []
    for before, row in itertools.pairwise(rows):
        if not row.coasts and row.duty != before.duty:
            accepted.append(before.tick)
        if row.coasts and not before.coasts:
            stale.append((accepted[-1], before.tick))
    return Story(rows, accepted, stale)


def check_coasting(story: Story) -> None:
    """Assert that motors coast at the latest in the tick after the command time-out."""
    late = [(accepted, driven) for accepted, driven in story.stale if driven - accepted > TIMEOUT]
    assert late == []
